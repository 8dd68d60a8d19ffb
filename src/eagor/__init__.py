"""In which direction is the thing I asked for, and how sure are we, while the camera turns and moves?

    tracker = eagor.DirectionTracker()
    tracker.add_pose(stamp, world_R_body)                       # odometry, at any rate
    tracker.observe(perception(panorama, "red chair", stamp=t0))   # evidence, possibly late
    estimate = tracker.estimate(now)                          # direction, cone, modes, presence, status

The frames are on one page, `eagor.sphere`. A look goes through `eagor.evidence`, `eagor.belief` and `eagor.tracking`;
the docstring of each is an overview of its modules. The baselines are in `eagor.baselines`.

Each name is loaded when it is first used (PEP 562): `eagor --help` answers without NumPy, and the command line sets the
number of threads before NumPy is loaded.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from eagor._version import __version__

if TYPE_CHECKING:
    from eagor import baselines as baselines
    from eagor import belief as belief
    from eagor import cameras as cameras
    from eagor import conventions as conventions
    from eagor import drawing as drawing
    from eagor import errors as errors
    from eagor import evidence as evidence
    from eagor import grids as grids
    from eagor import harmonics as harmonics
    from eagor import lab as lab
    from eagor import live as live
    from eagor import metrics as metrics
    from eagor import perception as perception
    from eagor import plugins as plugins
    from eagor import queries as queries
    from eagor import sources as sources
    from eagor import sphere as sphere
    from eagor import statistics as statistics
    from eagor import tracking as tracking
    from eagor.belief import Belief, RangedBelief, log_ranges
    from eagor.errors import EagorError
    from eagor.evidence import Calibration, DetectorModel, Evidence
    from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
    from eagor.harmonics import RealHarmonics
    from eagor.live.loop import Loop
    from eagor.perception import load
    from eagor.perception.views import Detector
    from eagor.sources.camera_sources import open_source
    from eagor.sources.odometry import open_poses
    from eagor.sphere import angular_distance, azimuth_elevation, direction
    from eagor.tracking import DirectionTracker, Estimate, Mode, MotionModel, TrackerConfig

__all__ = [
    "Belief",
    "Calibration",
    "Detector",
    "DetectorModel",
    "DirectionTracker",
    "EagorError",
    "ErpGrid",
    "Estimate",
    "Evidence",
    "FisheyeGrid",
    "Loop",
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
    "load",
    "log_ranges",
    "open_poses",
    "open_source",
]

_HOME = {
    "belief": ("Belief", "RangedBelief", "log_ranges"),
    "errors": ("EagorError",),
    "evidence": ("Calibration", "DetectorModel", "Evidence"),
    "grids": ("ErpGrid", "FisheyeGrid", "PatchGrid", "PerspectiveGrid"),
    "harmonics": ("RealHarmonics",),
    "live.loop": ("Loop",),
    "sources.camera_sources": ("open_source",),
    "sources.odometry": ("open_poses",),
    "perception": ("load",),
    "perception.views": ("Detector",),
    "sphere": ("angular_distance", "azimuth_elevation", "direction"),
    "tracking": ("DirectionTracker", "Estimate", "Mode", "MotionModel", "TrackerConfig"),
}

# The modules that `dir(eagor)` shows; the others are parts of these.
_MODULES = (
    "baselines", "belief", "cameras", "conventions", "drawing", "errors", "evidence", "grids", "harmonics",
    "lab", "live", "metrics", "perception", "plugins", "queries", "robots", "sources", "sphere", "statistics",
    "tracking",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"eagor.{name}")
    for module, names in _HOME.items():
        if name in names:
            value = getattr(import_module(f"eagor.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'eagor' has no attribute {name!r}{_near(name)}")


def _near(name: str) -> str:
    """The names that `name` may have meant, as the end of a sentence."""
    if name.startswith("_"):
        return ""
    from difflib import get_close_matches

    known = {each.lower(): each for each in __dir__()}
    low = name.lower()
    found = [known[each] for each in known if len(low) > 3 and low in each]
    found += [known[each] for each in get_close_matches(low, known, 1, 0.7) if known[each] not in found]
    return f"; did you mean {' or '.join(found[:3])}?" if found else ""


def __dir__() -> list[str]:
    return sorted([*__all__, *_MODULES])
