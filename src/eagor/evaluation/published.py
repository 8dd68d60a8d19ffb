"""The figures that the paper printed, by task, method and column, and the order of the methods in tables.

Source: the EAGOR paper's tables of Waypoint Following and Map-Free Navigation, digit by digit. They were measured in
the paper's own setting (its worlds, its perception, its rules), so they are no yardstick for single figures of ours;
what can be compared is which method is better than which, and by roughly how much.
"""

from __future__ import annotations

from collections.abc import Iterable

from eagor.tasks.methods import EVERY, ORACLE

OURS, PAPERS = "eagor", "eagor_paper"  # our default, and the method as published
RIVALS = ("centroid", "cent_circ", "grid")  # what the paper compares itself with
ORDER = (*EVERY, ORACLE)

# Published rows, by our names. The paper's Delta is near L4 - L1 but not equal to it: it is given as printed.
_WAYPOINT = ("L1", "L2", "L3", "L4", "delta", "occ", "seam", "tc")
_NAVIGATION = ("sr", "spl", "steps", "mae", "seam_success")
FIGURES: dict[str, dict[str, dict[str, float]]] = {
    "waypoint": {
        "centroid": dict(zip(_WAYPOINT, (25.5, 49.4, 90.9, 66.7, 40.3, 31.1, 59.1, 11.6), strict=True)),
        "cent_circ": dict(zip(_WAYPOINT, (25.5, 49.3, 66.3, 72.8, 46.4, 31.1, 51.0, 7.3), strict=True)),
        "grid": dict(zip(_WAYPOINT, (23.2, 138.9, 37.3, 75.9, 52.3, 135.2, 42.4, 19.2), strict=True)),
        "eagor_paper": dict(zip(_WAYPOINT, (21.1, 31.1, 40.9, 47.1, 25.4, 15.5, 22.9, 2.6), strict=True)),
    },
    "navigation": {
        "centroid": dict(zip(_NAVIGATION, (82.0, 54.4, 61.0, 45.9, 19.6), strict=True)),
        "cent_circ": dict(zip(_NAVIGATION, (62.0, 41.5, 77.8, 46.5, 33.5), strict=True)),
        "grid": dict(zip(_NAVIGATION, (82.0, 41.4, 63.6, 54.2, 15.8), strict=True)),
        "eagor_paper": dict(zip(_NAVIGATION, (94.0, 56.8, 50.2, 33.8, 70.6), strict=True)),
    },
    "tracking": {},
}
RESOLUTION_DEG = {7: 25.0}  # "about 25 degrees of angular resolution", by degree


# Benchmarks with published data, per cent: EAGOR's Table 1 (H*Bench HOS, and OSR-Bench's relative directions, here
# "overall" of osr) and H*Bench's own baselines (overall only). Measured with the models named, under the papers'
# prompts, on the whole published data: a row of ours compares only where model, data and scoring are the same.
_HOS = ("overall", "easy", "medium", "hard")
_TABLE = {
    "Gemma-3-4B": (20.60, 29.50, 19.20, 17.50),
    "Gemma-3-4B + EAGOR": (24.80, 40.20, 24.45, 18.90),
    "Gemma-3-12B": (25.67, 35.10, 24.00, 22.40),
    "Gemma-3-12B + EAGOR": (36.55, 56.70, 38.30, 31.65),
    "Qwen2.5-VL-3B": (20.71, 32.00, 22.10, 16.40),
    "Qwen2.5-VL-3B + EAGOR": (26.40, 45.10, 21.70, 20.80),
    "Qwen2.5-VL-7B": (27.24, 37.60, 27.80, 23.10),
    "Qwen2.5-VL-7B + EAGOR": (40.10, 54.20, 39.40, 34.60),
    "LLaVA-v1.5": (13.60, 39.20, 10.60, 11.20),
}
_OSR = {
    "Gemma-3-4B": 12.1, "Gemma-3-4B + EAGOR": 17.2, "Gemma-3-12B": 15.6, "Gemma-3-12B + EAGOR": 20.2,
    "Qwen2.5-VL-3B": 12.7, "Qwen2.5-VL-3B + EAGOR": 20.4, "Qwen2.5-VL-7B": 16.8, "Qwen2.5-VL-7B + EAGOR": 25.2,
    "LLaVA-v1.5": 16.9, "Janus-Pro": 15.9, "Qwen2.5-VL-72B": 18.1,
}  # fmt: skip
# Overall HOS and HPS, from H*Bench's paper.
_BASELINES = {
    "Qwen2.5-VL-3B (H*Bench's paper)": (14.83, 6.44),
    "Qwen2.5-VL-3B + SFT (H*Bench's paper)": (40.83, 23.00),
    "HVS-3B": (47.38, 24.94),
    "HVS-4B": (54.71, 31.00),
    "HVS-8B": (60.29, 32.87),
    "MiMo-Embodied-7B + SFT": (23.71, 31.56),
    "GPT-4o": (19.75, 23.69),
    "Gemini-2.5-Pro": (31.96, 33.00),
}
PUBLISHED: dict[str, dict[str, dict[str, float]]] = {
    "hstar-hos": {
        **{name: dict(zip(_HOS, row, strict=True)) for name, row in _TABLE.items()},
        **{name: {"overall": hos} for name, (hos, _) in _BASELINES.items()},
    },
    "hstar-hps": {name: {"overall": hps} for name, (_, hps) in _BASELINES.items()},
    "osr": {name: {"overall": value} for name, value in _OSR.items()},
}
# The paper's failure table on HOS: share of the episodes and success, by our tags where one corresponds.
FAILURE_TAGS: dict[str, dict[str, tuple[float, float]]] = {
    "hstar-hos": {"ocr_fine": (18.5, 13.2), "rare": (16.9, 3.6), "multi_instance": (12.5, 33.3)}
}


def ordered(names: Iterable[str]) -> list[str]:
    """Method names in the order of the tables: plain, the paper's, the further rivals, ours, the oracle, ablations."""
    place = {name: index for index, name in enumerate(ORDER)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), *_natural(name)))


def is_ablation(name: str) -> bool:
    """Whether the method is a variation of another one: "eagor:degree=7"."""
    return ":" in name


def is_rival(name: str) -> bool:
    """Whether the method competes: neither a variation nor one that is told the truth."""
    return not is_ablation(name) and name != ORACLE


def compared_with(name: str, reference: str) -> str:
    """What a method is measured against: an ablation against the method that it varies, all others against one."""
    return name.partition(":")[0] if is_ablation(name) else reference


def _natural(name: str) -> tuple[str, float, str]:
    """A sort key that puts degree=7 before degree=15."""
    head, _, value = name.rpartition("=")
    try:
        return head, float(value), ""
    except ValueError:
        return (head or name), 0.0, value
