"""What the papers printed for the benchmarks with published data, digit by digit, per cent.

EAGOR's Table 1 (H*Bench HOS, and OSR-Bench's relative directions, here "overall" of osr) and H*Bench's own baselines
(overall only). Measured with the models named, under the papers' prompts, on the whole published data: a row of ours
compares only where model, data and scoring are the same.
"""

from __future__ import annotations

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
    "hstar-hos": {"ocr_fine": (18.5, 13.2), "rare": (16.9, 3.6), "multi_instance": (12.5, 33.3)},
}
