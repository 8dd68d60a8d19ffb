"""The live loop: answers at a steady rate from a camera, odometry and a perception that each have their own.

`loop` runs it; `core` turns `events` into answers without threads and devices. `threads` read cameras and poses, and
look at the newest picture; `inference` runs the perception, in its own process where that matters. `recording` keeps a
run and plays it again; `rerun` logs it for a viewer.
"""

from __future__ import annotations

from eagor.live.events import Answer, Fault
from eagor.live.loop import Loop

__all__ = ["Answer", "Fault", "Loop"]
