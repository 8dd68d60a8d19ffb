"""What one look says about each direction.

A perception looks at one picture for one thing, and says what it found in one of two ways:

- a **response map** ``(H, W)`` in [0, 1] on a grid that a `Calibration` turns into log-likelihood
  ratios (`calibration`, `averaging`);
- **detections**, which are boxes, points or masks (`shapes`), as one set (`detections`), which a `DetectorModel` reads
  (`detector`).

`Evidence` is either of them, with the time of capture, what was looked at (`coverage`) and what is never seen
(`masking`). Its values are log-likelihood ratios against "the thing is not here": positive where the look speaks for
the thing, negative and bounded where it was looked for and not seen, 0 where nobody looked. `Evidence.coefficients`
gives them in spherical harmonics, in the body frame at capture. `Habits` says why looks at a place are not independent.
"""

from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import Detections, View
from eagor.evidence.detector import ClutterRate, DetectorModel, Habits, Spread, model_as_json, parse_model
from eagor.evidence.evidence import Evidence
from eagor.evidence.masking import BodyMask

__all__ = [
    "BodyMask",
    "Calibration",
    "ClutterRate",
    "Detections",
    "DetectorModel",
    "Evidence",
    "Habits",
    "Spread",
    "View",
    "model_as_json",
    "parse_model",
]
