"""In which direction is the thing I asked for, and how sure are we, while the camera turns and moves?

    tracker = eagor.DirectionTracker()
    tracker.rotate(stamp, world_R_body)                       # odometry, at any rate
    tracker.observe(perception(panorama, "red chair", stamp=t0))   # evidence, possibly late
    estimate = tracker.estimate(now)                          # direction, cone, modes, presence, status

The frames are on one page, `eagor.sphere`; the mathematics is in `eagor.belief` and the modules below it.
"""

from eagor._version import __version__
from eagor.belief import Belief
from eagor.errors import EagorError
from eagor.evidence import Calibration, Evidence
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.ranged import RangedBelief, log_ranges
from eagor.sphere import angular_distance, azimuth_elevation, direction
from eagor.tracker import DirectionTracker, Estimate, Mode, TrackerConfig

__all__ = [
    "Belief",
    "Calibration",
    "DirectionTracker",
    "EagorError",
    "ErpGrid",
    "Estimate",
    "Evidence",
    "FisheyeGrid",
    "Mode",
    "PatchGrid",
    "PerspectiveGrid",
    "RangedBelief",
    "RealHarmonics",
    "TrackerConfig",
    "__version__",
    "angular_distance",
    "azimuth_elevation",
    "direction",
    "log_ranges",
]
