"""Every method on the same evidence: our tracker's rivals, each driven through `predict` and `update`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from eagor.baselines import (
    Centroid,
    CircularCentroid,
    DirectionFilter,
    GridFilter,
    HistogramFilter,
    ParticleFilter,
    Published,
    VonMisesFisherFilter,
)
from eagor.evidence import Evidence

PARTICLES = 2000
NAMES = ("centroid", "cent_circ", "grid", "eagor_paper", "vmf", "grid_filter", "particle_filter")


class Rivals:
    """The baselines, moved and fed together."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        made = (
            Centroid(),
            CircularCentroid(),
            GridFilter(),
            Published(),
            VonMisesFisherFilter(),
            HistogramFilter(),
            ParticleFilter.uniform(PARTICLES, rng),
        )
        self.filters: dict[str, DirectionFilter] = dict(zip(NAMES, made, strict=True))
        self._pose: tuple[np.ndarray, np.ndarray | None] | None = None

    def move(self, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """Tell them where the body stands now."""
        if self._pose is not None:
            before, place = self._pose
            new_R_old = world_R_body.T @ before
            step = None if position is None or place is None else world_R_body.T @ (position - place)
            self.filters = {name: f.predict(new_R_old, step) for name, f in self.filters.items()}
        self._pose = world_R_body, position

    def see(self, looks: Iterable[Evidence]) -> None:
        """Tell them what was seen."""
        for evidence in looks:
            self.filters = {name: f.update(evidence) for name, f in self.filters.items()}

    def directions(self) -> dict[str, np.ndarray]:
        """Their answers ``(3,)``, body frame."""
        return {name: np.asarray(f.direction()) for name, f in self.filters.items()}
