"""In which direction is the thing I asked for, and how sure are we, while the camera turns and moves?

    tracker = eagor.DirectionTracker()
    tracker.rotate(stamp, world_R_body)                       # odometry, at any rate
    tracker.observe(perception(panorama, "red chair", stamp=t0))   # evidence, possibly late
    estimate = tracker.estimate(now)                          # direction, cone, modes, presence, status

The frames are on one page, `eagor.sphere`; the mathematics is in `eagor.belief` and the modules below it.

Each name is loaded when it is first used (PEP 562): `eagor --help` answers without NumPy, and the command line chooses
the number of threads before NumPy is loaded. The methods to compare with are in `eagor.baselines`.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from eagor._version import __version__

if TYPE_CHECKING:
    from eagor import baselines as baselines
    from eagor import belief as belief
    from eagor import conventions as conventions
    from eagor import drawing as drawing
    from eagor import errors as errors
    from eagor import evaluation as evaluation
    from eagor import evidence as evidence
    from eagor import grids as grids
    from eagor import harmonics as harmonics
    from eagor import metrics as metrics
    from eagor import perception as perception
    from eagor import plugins as plugins
    from eagor import poses as poses
    from eagor import queries as queries
    from eagor import sphere as sphere
    from eagor import statistics as statistics
    from eagor import tasks as tasks
    from eagor import tracker as tracker
    from eagor import worlds as worlds
    from eagor.belief import Belief
    from eagor.calibration import Calibration
    from eagor.detector import DetectorModel
    from eagor.errors import EagorError
    from eagor.estimate import Estimate, Mode, TrackerConfig
    from eagor.evidence import Evidence
    from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
    from eagor.harmonics import RealHarmonics
    from eagor.motion import MotionModel
    from eagor.ranged import RangedBelief, log_ranges
    from eagor.sphere import angular_distance, azimuth_elevation, direction
    from eagor.tracker import DirectionTracker

__all__ = [
    "Belief",
    "Calibration",
    "DetectorModel",
    "DirectionTracker",
    "EagorError",
    "ErpGrid",
    "Estimate",
    "Evidence",
    "FisheyeGrid",
    "Mode",
    "MotionModel",
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

_HOME = {
    "belief": ("Belief",),
    "calibration": ("Calibration",),
    "detector": ("DetectorModel",),
    "errors": ("EagorError",),
    "estimate": ("Estimate", "Mode", "TrackerConfig"),
    "evidence": ("Evidence",),
    "grids": ("ErpGrid", "FisheyeGrid", "PatchGrid", "PerspectiveGrid"),
    "harmonics": ("RealHarmonics",),
    "motion": ("MotionModel",),
    "ranged": ("RangedBelief", "log_ranges"),
    "sphere": ("angular_distance", "azimuth_elevation", "direction"),
    "tracker": ("DirectionTracker",),
}

# The modules that `dir(eagor)` shows; the others are parts of these.
_MODULES = (
    "baselines", "belief", "conventions", "drawing", "errors", "evaluation", "evidence", "grids", "harmonics",
    "metrics", "perception", "plugins", "poses", "queries", "sphere", "statistics", "tasks", "tracker", "worlds",
)  # fmt: skip
_MOVED = (  # to `eagor.baselines`
    "Centroid", "CircularCentroid", "GridFilter", "HistogramFilter", "ParticleFilter", "Published",
    "VonMisesFisherFilter",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MODULES or name in _HOME:
        return import_module(f"eagor.{name}")
    if name in _MOVED:
        warnings.warn(f"eagor.{name} is now eagor.baselines.{name}", DeprecationWarning, stacklevel=2)
        return getattr(import_module("eagor.baselines"), name)
    for module, names in _HOME.items():
        if name in names:
            value = getattr(import_module(f"eagor.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'eagor' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_MODULES])
