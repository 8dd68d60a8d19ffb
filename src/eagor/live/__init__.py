"""The live loop: answers at a steady rate from a camera, odometry and a perception that each have their own.

`loop` has the threads and devices; `core` turns events into answers without them; `worker`, `keeper` and `looker` run
the perception in its own process; `recorder` and `replay` keep a run and play it again.
"""

from __future__ import annotations

from eagor.live.answers import Answer, Fault
from eagor.live.loop import LiveLoop

__all__ = ["Answer", "Fault", "LiveLoop"]
