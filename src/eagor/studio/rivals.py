"""Other methods in a session, by choice: each gets the same looks, and its answer turns with the camera in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.studio.steps import error_deg
from eagor.studio.wire import rounded
from eagor.tasks.methods import DESCRIPTIONS, NAMES, Method, make_method

__all__ = ["OFFERED", "Rivals"]

OURS = "eagor"
OFFERED = tuple({"name": name, "words": DESCRIPTIONS[name]} for name in NAMES if name != OURS)


@dataclass
class Rivals:
    """The chosen methods, with settings for `perception`. A method that is chosen late begins with the next look."""

    perception: str
    _methods: dict[str, Method] = field(default_factory=dict)
    _answers: dict[str, np.ndarray] = field(default_factory=dict)  # world frame
    _last: float = -np.inf

    def choose(self, names: Sequence[str]) -> None:
        """Keep those that are chosen still, begin the others. Unknown names are left out."""
        wanted = [name for name in NAMES if name in names and name != OURS]
        made = {}
        for name in wanted:
            made[name] = self._methods.get(name) or make_method(name, np.random.default_rng(0), self.perception)
        self._methods = made
        self._answers = {name: each for name, each in self._answers.items() if name in made}

    def look(
        self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None, looks: Sequence[Evidence]
    ) -> None:
        """A look from a pose; looks come in order of time."""
        if stamp <= self._last:
            return
        self._last = stamp
        for name, method in self._methods.items():
            try:
                method.move(stamp, world_R_body, position)
                for evidence in looks:
                    method.see(replace(evidence, stamp=stamp))
                self._answers[name] = world_R_body @ method.direction()
            except EagorError:  # it cannot read such evidence: it has no answer
                self._answers.pop(name, None)

    def answers(self, world_R_body: np.ndarray, truth: np.ndarray | None) -> dict[str, Any]:
        """Each one's direction in the body frame now, and its error, if the truth is known."""
        found = {name: world_R_body.T @ direction for name, direction in self._answers.items()}
        return {
            name: {"direction": rounded(direction), "error_deg": error_deg(direction, truth)}
            for name, direction in found.items()
        }
