"""Following targets over time: poses and looks by their stamps, answers at any time.

One look of one target takes this way:

1. `tracker`: `DirectionTracker.observe` files the evidence under its target, `tracks` puts it where its time of capture
   belongs, and `poses` says where the camera was then.
2. `scan`: all evidence of one moment, turned into world axes.
3. `imm`: is the target absent, does it stand (`stationary`), or wander or turn (`moving`)? Each hypothesis
   predicts the look, and is weighed by how well it did.
4. `tracks`: `State` is what is believed after the look; it carries itself to another time and place.
5. `estimate`: the answer in the body frame of now, with its candidates, cone, presence and status.
6. `next_view`: where a camera that sees only a part of the sphere should look next.

`config` has the settings, among them the rates at which targets begin and cease to move.
"""

from eagor.tracking.config import AnswerSettings, MotionModel, TrackerConfig
from eagor.tracking.estimate import Estimate, Mode, Status
from eagor.tracking.next_view import Heights, NextLook, TurningCamera, TurningRig
from eagor.tracking.poses import PoseHistory
from eagor.tracking.tracker import DirectionTracker

__all__ = [
    "AnswerSettings",
    "DirectionTracker",
    "Estimate",
    "Heights",
    "Mode",
    "MotionModel",
    "NextLook",
    "PoseHistory",
    "Status",
    "TrackerConfig",
    "TurningCamera",
    "TurningRig",
]
