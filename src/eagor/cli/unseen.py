"""What the camera never sees: looks say nothing there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eagor.cli import terminal
from eagor.evidence import BodyMask, Evidence
from eagor.media.defects import NeverSeen
from eagor.media.panorama import PanoramaFile

SAID = 0.002  # share of the sphere from which on a black region is worth a sentence


class Unseen:
    """The mask of ``--mask``, what a file says that its picture lacks, and black around a pole in all frames so far."""

    def __init__(self, path: Path | None) -> None:
        from eagor.perception.partial import read_mask

        self._given = None if path is None else read_mask(path)
        self._black, self._said = NeverSeen(), False

    def covered(self, looks: tuple[Evidence, ...], frame: PanoramaFile) -> tuple[Evidence, ...]:
        """The looks at `frame`, without what is not seen."""
        black = self._black.add(frame.panorama)
        hidden = black if frame.unseen is None else black | frame.unseen
        masks = [] if self._given is None else [self._given]
        if hidden.any():
            mask = BodyMask(~hidden)
            self._say(mask, black)
            masks.append(mask)
        for mask in masks:
            looks = tuple(look.covered(mask) for look in looks)
        return looks

    def _say(self, mask: BodyMask, black: np.ndarray) -> None:
        share = 1 - float(np.sum(mask.seen * mask.grid.weights)) / (4 * np.pi)
        if not self._said and share > SAID and black.any():
            self._said = True
            terminal.log(f"{100 * share:.1f} % of the sphere is black around a pole, or missing: taken as not seen")
