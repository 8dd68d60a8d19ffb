"""Writes `vectors.json`: values of eagor.RealHarmonics that the page's own harmonics are tested against.

python studio/tests/vectors.py
"""

import json
from pathlib import Path

import numpy as np

from eagor import Belief, RealHarmonics
from eagor.grids import ErpGrid

DEGREES = (1, 2, 7, 15, 31)
rng = np.random.default_rng(0)
directions = rng.normal(size=(6, 3))
directions = np.concatenate([directions / np.linalg.norm(directions, axis=1, keepdims=True), [[0, 0, 1], [0, 0, -1]]])


def case(degree: int) -> dict[str, object]:
    """The basis at some directions, and a random belief: its field on a grid, its density, its mode, its region."""
    basis = RealHarmonics(degree)
    width = np.repeat(2.0 / (1 + np.arange(degree + 1)), 2 * np.arange(degree + 1) + 1)
    coefficients = rng.normal(size=basis.size) * width
    coefficients = coefficients.astype(np.float32).astype(np.float64)
    belief = Belief(coefficients)
    region = belief.credible_region(0.9)
    return {
        "degree": degree,
        "basis": basis.evaluate(directions).round(7).tolist() if degree <= 7 else None,
        "coefficients": coefficients.round(9).tolist(),
        "values": basis.synthesise(coefficients, directions).round(6).tolist(),
        "grid": basis.synthesise(coefficients, ErpGrid(8, 16)).round(6).tolist(),
        "log_density": belief.log_density(directions).round(6).tolist(),
        "mode": belief.mode().round(7).tolist(),
        "level": float(np.exp(region.threshold)),
    }


text = json.dumps({"directions": directions.round(12).tolist(), "cases": [case(degree) for degree in DEGREES]})
Path(__file__).with_suffix(".json").write_text(text + "\n", encoding="utf-8")
