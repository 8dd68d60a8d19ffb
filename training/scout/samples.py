"""What the network is asked and should answer: queries, targets and augmentation from the files of `data.py`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from balls import with_balls
from data import classes

from eagor._values import lazy
from eagor.grids import PatchGrid
from eagor.lab.envs.places import UNTARGETED
from eagor.queries import COLOURS

CLASSES = classes()
WORDS = CLASSES[:-3]  # categories that can be asked for: all but walls, floors and ceilings
NO_COLOUR = len(COLOURS)
VISIBLE = 2  # pixels of a 64 x 128 id panorama from which on a thing counts as visible, as in the tasks
UNSURE = 255  # a cell whose tint nobody is asked about
SHRINK = 0.4  # of the second moments of what is visible: the target is a peak at its middle, not its outline
# How often a class is asked for: less where nobody walks to it.
_INTEREST = np.array([0.25 if name in UNTARGETED else 1.0 for name in CLASSES])
WIDTH = 0.6  # cells: standard deviation of the target of the smallest thing


@dataclass(eq=False)
class Apartment:
    """The views of one file, as arrays; see `data.py`."""

    seed: int
    rgb: np.ndarray
    category: np.ndarray
    colour: np.ndarray
    nameable: np.ndarray
    pixels: np.ndarray
    area: np.ndarray
    mean: np.ndarray
    moment: np.ndarray
    shown: np.ndarray  # (V, h, W) uint8: class in the middle row of each row of cells
    tint: np.ndarray  # (V, h, W) uint8: colour, or UNSURE

    @classmethod
    def read(cls, file: Path, stride: int = 4, balls: float = 0.0) -> Apartment:
        """The apartment in `file`, with the middle rows of cells of `stride` pixels and `balls` in a share of views."""
        with np.load(file) as stored:
            given = {key: stored[key] for key in stored.files}
        if balls > 0:
            with_balls(given, CLASSES, int(file.stem.split("-")[1]), balls)
        ids = given.pop("ids")[:, stride // 2 :: stride]
        kind = np.append(given["category"], CLASSES.index("wall")).astype(np.uint8)  # -1, the view outside, is wall
        hue = np.where(given["colour"] < 0, UNSURE, given["colour"])
        hue = np.append(np.where(given["category"] < len(WORDS), hue, UNSURE), UNSURE).astype(np.uint8)
        return cls(int(file.stem.split("-")[1]), **given, shown=kind[ids], tint=hue[ids])


def read_split(folder: Path, most: int | None = None, balls: float = 0.0) -> list[Apartment]:
    """All apartments of a split, in the order of their seeds, with `balls` in a share of the views."""
    return [Apartment.read(file, balls=balls) for file in sorted(folder.glob("apartment-*.npz"))[:most]]


@dataclass(frozen=True)
class Asked:
    """Queries about one view: `words` ``(Q, 2)``, which things match ``(Q, I)`` bool, and `present` ``(Q,)`` 0 or 1."""

    words: np.ndarray
    match: np.ndarray
    present: np.ndarray


def ask(apartment: Apartment, view: int, count: int, rng: np.random.Generator) -> Asked:
    """`count` queries: half of them for what is visible, the rest for what is not, mostly with a colour.

    Things too small to count as visible are asked for by nobody: neither yes nor no is right.
    """
    category, colour = apartment.category, apartment.colour
    visible = apartment.pixels[view] >= VISIBLE
    there = apartment.area[view] > 0
    candidates = np.flatnonzero(visible & (category < len(WORDS)))
    weight = np.where(apartment.nameable[candidates] > 0, 3.0, _INTEREST[category[candidates]])
    words: list[tuple[int, int]] = []
    taken: set[tuple[int, int]] = set()

    def add(word: tuple[int, int]) -> None:
        if word not in taken:
            taken.add(word)
            words.append(word)

    def matches(word: tuple[int, int]) -> np.ndarray:
        return (category == word[0]) & ((colour == word[1]) | (word[1] == NO_COLOUR))

    for _ in range(count):
        if len(candidates) and len(words) < count // 2:
            thing = int(rng.choice(candidates, p=weight / weight.sum()))
            plain = colour[thing] < 0 or rng.random() < (0.6 if apartment.nameable[thing] == 1 else 0.25)
            add((int(category[thing]), NO_COLOUR if plain else int(colour[thing])))
    seen_colours = np.unique(colour[candidates][colour[candidates] >= 0])
    for _ in range(20 * count):
        if len(words) >= count:
            break
        kind = rng.random()
        if kind < 0.5 and len(candidates):  # of a category that is there, in another colour
            word = (int(category[rng.choice(candidates, p=weight / weight.sum())]), int(rng.integers(len(COLOURS))))
            if rng.random() < 0.5 and len(seen_colours):
                word = (word[0], int(rng.choice(seen_colours)))
        elif kind < 0.75 and len(seen_colours):  # another thing, in a colour that is there
            word = (int(rng.integers(len(WORDS))), int(rng.choice(seen_colours)))
        else:
            word = (int(rng.integers(len(WORDS))), NO_COLOUR)
        if not (matches(word) & there).any():
            add(word)
    while len(words) < count:  # a view that shows almost everything
        words.append(words[len(words) % max(len(taken), 1)])
    match = np.stack([matches(word) & there for word in words])
    return Asked(np.array(words), match, (match & visible).any(axis=1).astype(np.float32))


@dataclass(frozen=True)
class Targets:
    """Draws what the heat map should be, on `rows` x 2 `rows` cells."""

    rows: int

    @lazy
    def grid(self) -> PatchGrid:
        """The cells."""
        return PatchGrid(self.rows, 2 * self.rows)

    @lazy
    def _cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` and their outer products ``(n, 9)``."""
        cells = self.grid.directions.reshape(-1, 3).astype(np.float32)
        return cells, (cells[:, :, None] * cells[:, None, :]).reshape(-1, 9)

    def bumps(self, mean: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """A Gaussian of height 1 ``(n, h, w)`` for each thing, at its mean direction ``(n, 3)``."""
        mean, moment = mean.astype(np.float64), moment.astype(np.float64)
        along = mean[:, :, None] * mean[:, None, :]
        width = (WIDTH * math.pi / self.rows) ** 2
        precision = np.linalg.inv(SHRINK * moment + width * (np.eye(3) - along) + along) - along
        cells, products = self._cells
        cosine = cells @ mean.T.astype(np.float32)
        squared = products @ precision.reshape(-1, 9).T.astype(np.float32)
        # From squared chords in the tangent plane to squared angles; the far half sees nothing.
        stretch = np.arccos(np.clip(cosine, 0, 1)) ** 2 / np.maximum(1 - cosine**2, 1e-6)
        bump = np.where(cosine > 0.05, np.exp(-0.5 * squared * np.maximum(stretch, 1)), 0)
        return bump.T.reshape(-1, *self.grid.shape).astype(np.float32)


@dataclass(frozen=True)
class Batch:
    """Images ``(B, 3, H, W)`` in [0, 1], words ``(B, Q, 2)``, heat ``(B, Q, h, w)``, present, classes and tints."""

    image: np.ndarray
    words: np.ndarray
    heat: np.ndarray
    present: np.ndarray
    shown: np.ndarray
    tint: np.ndarray


def draw(apartments: list[Apartment], size: int, queries: int, rng: np.random.Generator) -> Batch:
    """A random batch, augmented: rolled and mirrored, a little brighter or darker, tinted, noisy."""
    parts: list[tuple[np.ndarray, ...]] = []
    for _ in range(size):
        apartment = apartments[int(rng.integers(len(apartments)))]
        view = int(rng.integers(len(apartment.rgb)))
        width = apartment.rgb.shape[2]
        roll, mirror = int(rng.integers(width)), bool(rng.random() < 0.5)
        asked = ask(apartment, view, queries, rng)
        involved = np.flatnonzero(asked.match.any(axis=0))
        # A picture rolled to the right by k columns shows the world turned by -2 pi k / W about the vertical.
        angle = -2 * math.pi * roll / width
        turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
        if mirror:
            turn = np.diag([1.0, -1.0, 1.0]) @ turn
        turn = turn.astype(np.float32)
        targets = _targets(apartment.shown.shape[1])
        heat = np.zeros((queries, *targets.grid.shape), dtype=np.float32)
        if len(involved):
            mean = apartment.mean[view, involved] @ turn.T
            bumps = targets.bumps(mean, turn @ apartment.moment[view, involved] @ turn.T)
            for query in range(queries):
                mine = asked.match[query, involved]
                if mine.any():
                    heat[query] = bumps[mine].max(axis=0)
        image = _moved(apartment.rgb[view], roll, mirror).astype(np.float32) / 255
        shown, tint = (_moved(layer[view], roll, mirror)[:, 2::4] for layer in (apartment.shown, apartment.tint))
        image = image ** np.float32(rng.uniform(0.88, 1.14)) * rng.uniform(0.88, 1.12)
        image = image * rng.uniform(0.97, 1.03, size=3).astype(np.float32)
        image += rng.standard_normal(image.shape, dtype=np.float32) * np.float32(rng.uniform(0, 0.015))
        image = np.clip(image, 0, 1).transpose(2, 0, 1)
        parts.append((image, asked.words, heat, asked.present, shown, tint))
    return Batch(*(np.stack(column) for column in zip(*parts, strict=True)))


def _moved(layer: np.ndarray, roll: int, mirror: bool) -> np.ndarray:
    layer = np.roll(layer, roll, axis=1)
    return layer[:, ::-1] if mirror else layer


_TARGETS: dict[int, Targets] = {}


def _targets(rows: int) -> Targets:
    return _TARGETS.setdefault(rows, Targets(rows))
