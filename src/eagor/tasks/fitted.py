"""Settings of the baselines for each perception, the best on development episodes (``benchmarks/fit.py``)."""

from __future__ import annotations

FITTED: dict[str, dict[str, str]] = {
    "scout": {  # the von Mises-Fisher filter did best with its defaults, in 48 trials each
        "grid_filter": "floor=0.326,neutral=0.127,temperature=7.34,diffusion=6.54,mixing=0.00291",
        "particle_filter": "floor=0.326,neutral=0.127,temperature=7.34,roughening=4.4,reborn=0.032,kernel=4.21",
    },
    "truth": {
        "vmf": "floor=0.125,neutral=0.144,temperature=1.47,noise=11.6",
        "grid_filter": "floor=0.175,neutral=0.0153,temperature=1.74,diffusion=6.96,mixing=2.85e-05",
        "particle_filter": "floor=0.0543,neutral=0.0909,temperature=1.39,roughening=2.29,reborn=0.00461,kernel=7.83",
    },
}


def fitted(perception: str, base: str) -> str:
    """The fitted settings of a method for a perception, "" if there are none."""
    return FITTED.get(perception.partition(":")[0], {}).get(base, "")
