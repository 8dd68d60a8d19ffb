"""In which direction is the thing I asked for, and how sure are we, while the camera turns and moves?

    tracker = eagor.DirectionTracker()
    tracker.rotate(stamp, world_R_body)                       # odometry, at any rate
    tracker.observe(perception(panorama, "red chair", stamp=t0))   # evidence, possibly late
    estimate = tracker.estimate(now)                          # direction, cone, modes, presence, status

The frames are on one page, `eagor.sphere`; the mathematics is in `eagor.belief` and the modules below it.

The names below are loaded when they are first used (PEP 562), so that the command line can answer `--help` without
NumPy, and choose the number of threads before NumPy is there.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from eagor._version import __version__

if TYPE_CHECKING:
    from eagor.baselines import (
        Centroid,
        CircularCentroid,
        GridFilter,
        HistogramFilter,
        ParticleFilter,
        Published,
        VonMisesFisherFilter,
    )
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
    "Centroid",
    "CircularCentroid",
    "DetectorModel",
    "DirectionTracker",
    "EagorError",
    "ErpGrid",
    "Estimate",
    "Evidence",
    "FisheyeGrid",
    "GridFilter",
    "HistogramFilter",
    "Mode",
    "MotionModel",
    "ParticleFilter",
    "PatchGrid",
    "PerspectiveGrid",
    "Published",
    "RangedBelief",
    "RealHarmonics",
    "TrackerConfig",
    "VonMisesFisherFilter",
    "__version__",
    "angular_distance",
    "azimuth_elevation",
    "direction",
    "log_ranges",
]

_HOME = {
    "baselines": (
        "Centroid",
        "CircularCentroid",
        "GridFilter",
        "HistogramFilter",
        "ParticleFilter",
        "Published",
        "VonMisesFisherFilter",
    ),
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


# Modules that are there after ``import eagor``, each loaded when it is first used.
_MODULES = (
    *_HOME,
    "conventions",
    "drawing",
    "evaluation",
    "metrics",
    "perception",
    "plugins",
    "poses",
    "queries",
    "statistics",
    "tasks",
    "worlds",
)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"eagor.{name}")
    for module, names in _HOME.items():
        if name in names:
            value = getattr(import_module(f"eagor.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'eagor' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
