"""Held-out figures of a scout: how well it points, how well it knows that a thing is not there, what it costs.

    python evaluate.py FOLDER/held-out [--model ../../src/eagor/perception/scout/scout.onnx]

Asked for is what the tasks ask for: things that "category" or "colour category" singles out in their apartment
(`Place.nameable`). A target is visible if at least two pixels of a 64 x 128 id panorama show it, the tasks' own rule.
The peak is the cell with the highest response, drawn to the mean of its 3 x 3 neighbourhood; its error is the angle to
the mean direction of what is visible of the target. Presence is judged by the highest response, for visible targets
against queries that nothing in view answers (not by a single pixel of the full picture): a nameable thing that is
elsewhere in the apartment, a category in view in another colour, a category that is not in view; one of each per view.
Intervals are 95 % bootstrap intervals over apartments.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
from samples import NO_COLOUR, VISIBLE, WORDS, Apartment, read_split

from eagor.grids import PatchGrid
from eagor.queries import COLOURS

INSIDE = 11.25  # degrees
SIZES = (2, 4, 8, 16, 32, 64, 128, 1 << 20)  # pixels of the id panorama: borders of the table by size
KINDS = ("visible", "elsewhere", "other colour", "other category")
# uint8 (H, 2H, 3) and words (Q, 2) to responses (Q, h, w) in [0, 1]
Respond = Callable[[np.ndarray, np.ndarray], np.ndarray]
Row = dict[str, float]


def queries_of(apartment: Apartment, view: int, rng: np.random.Generator) -> list[tuple[str, tuple[int, int], int]]:
    """What is asked in one view: (kind, words, thing or -1)."""
    category, colour, nameable = apartment.category, apartment.colour, apartment.nameable
    visible, there = apartment.pixels[view] >= VISIBLE, apartment.area[view] > 0

    def name(thing: int) -> tuple[int, int]:
        return int(category[thing]), int(colour[thing]) if nameable[thing] == 2 else NO_COLOUR

    def answered(words: tuple[int, int]) -> bool:
        return bool(((category == words[0]) & ((colour == words[1]) | (words[1] == NO_COLOUR)) & there).any())

    shown = np.flatnonzero(visible & (nameable > 0))
    asked = [("visible", name(thing), int(thing)) for thing in shown]
    gone = [thing for thing in np.flatnonzero(nameable > 0) if not answered(name(thing))]
    if gone:
        asked.append(("elsewhere", name(int(rng.choice(gone))), -1))
    if len(shown):
        kind = int(category[rng.choice(shown)])
        others = [hue for hue in range(len(COLOURS)) if not answered((kind, hue))]
        asked.append(("other colour", (kind, int(rng.choice(others))), -1))
    targets = set(category[nameable > 0].tolist())
    absent = [kind for kind in sorted(targets) if not answered((kind, NO_COLOUR))]
    if absent:
        asked.append(("other category", (int(rng.choice(absent)), NO_COLOUR), -1))
    return asked


def peak_direction(response: np.ndarray, grid: PatchGrid) -> np.ndarray:
    """Where the response ``(h, w)`` is highest, by the mean of 3 x 3 cells."""
    row, column = np.unravel_index(int(response.argmax()), response.shape)
    rows = np.clip(np.arange(row - 1, row + 2), 0, response.shape[0] - 1)
    columns = np.arange(column - 1, column + 2) % response.shape[1]
    weight = response[np.ix_(rows, columns)]
    mean = (grid.directions[np.ix_(rows, columns)] * weight[..., None]).sum(axis=(0, 1))
    return mean / max(float(np.linalg.norm(mean)), 1e-12)


def rows_of(apartments: Iterable[Apartment], respond: Respond, views: int | None = None) -> list[Row]:
    """One row for every query about every view."""
    rows: list[Row] = []
    for apartment in apartments:
        rng = np.random.default_rng([apartment.seed, 11])
        for view in range(len(apartment.rgb))[:views]:
            asked = queries_of(apartment, view, rng)
            if not asked:
                continue
            responses = respond(apartment.rgb[view], np.array([words for _, words, _ in asked]))
            grid = PatchGrid(*responses.shape[1:])
            for (kind, words, thing), response in zip(asked, responses, strict=True):
                row = {"seed": apartment.seed, "kind": KINDS.index(kind), "score": float(response.max())}
                row |= {"category": words[0], "coloured": float(words[1] != NO_COLOUR)}
                if thing >= 0:
                    cosine = float(peak_direction(response, grid) @ apartment.mean[view, thing])
                    row["error"] = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
                    row["pixels"] = float(apartment.pixels[view, thing])
                rows.append(row)
    return rows


def auc(positive: np.ndarray, negative: np.ndarray) -> float:
    """Probability that a positive scores higher than a negative, ties counted half."""
    from scipy.stats import rankdata

    if not len(positive) or not len(negative):
        return float("nan")
    ranks = rankdata(np.concatenate([positive, negative]))[: len(positive)].sum()
    return float((ranks - len(positive) * (len(positive) + 1) / 2) / (len(positive) * len(negative)))


def figures(rows: list[Row]) -> dict[str, float]:
    """The figures of these rows."""
    score, kind = np.array([row["score"] for row in rows]), np.array([row["kind"] for row in rows])
    error = np.array([row["error"] for row in rows if "error" in row])
    found = {"inside": float((error < INSIDE).mean()), "median": float(np.median(error)), "mean": float(error.mean())}
    found["auc"] = auc(score[kind == 0], score[kind > 0])
    for place, name in enumerate(KINDS[1:], 1):
        found[f"auc {name}"] = auc(score[kind == 0], score[kind == place])
    return found


def intervals(rows: list[Row], repeats: int = 400) -> dict[str, tuple[float, float]]:
    """95 % bootstrap intervals of `figures`, drawn over apartments."""
    rng = np.random.default_rng(5)
    by_seed: dict[float, list[Row]] = {}
    for row in rows:
        by_seed.setdefault(row["seed"], []).append(row)
    groups = list(by_seed.values())
    drawn = []
    for _ in range(repeats):
        sample = [row for place in rng.integers(len(groups), size=len(groups)) for row in groups[place]]
        drawn.append(figures(sample))
    return {key: tuple(np.nanpercentile([one[key] for one in drawn], [2.5, 97.5])) for key in drawn[0]}  # type: ignore


def tables(rows: list[Row]) -> dict[str, dict[str, list[float]]]:
    """Number, share inside and median error by size, by category and by kind of query."""
    found: dict[str, dict[str, list[float]]] = {"pixels": {}, "category": {}, "query": {}}
    shown = [row for row in rows if "error" in row]

    def line(mine: list[Row]) -> list[float]:
        error = np.array([row["error"] for row in mine])
        return [len(mine), round(float((error < INSIDE).mean()), 4), round(float(np.median(error)), 2)]

    for low, high in pairwise(SIZES):
        if mine := [row for row in shown if low <= row["pixels"] < high]:
            found["pixels"][f"{low}-{high - 1}" if high < SIZES[-1] else f"{low} and more"] = line(mine)
    for place, name in enumerate(WORDS):
        if mine := [row for row in shown if row["category"] == place]:
            found["category"][name] = line(mine)
    for name, coloured in (("category", 0.0), ("colour category", 1.0)):
        if mine := [row for row in shown if row["coloured"] == coloured]:
            found["query"][name] = line(mine)
    return found


def onnx_respond(model: Path) -> Respond:
    """The responses of an exported scout, on one core."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def respond(image: np.ndarray, words: np.ndarray) -> np.ndarray:
        found = session.run(None, {"image": image[None], "words": words.astype(np.int64)})[0]
        return np.asarray(found)

    return respond


def milliseconds(respond: Respond, image: np.ndarray, repeats: int = 40) -> float:
    """Median time of one query about one panorama."""
    words = np.array([[0, NO_COLOUR]])
    taken = []
    for _ in range(repeats):
        started = time.perf_counter()
        respond(image, words)
        taken.append(time.perf_counter() - started)
    return 1000 * float(np.median(taken))


def main() -> None:
    """The command line."""
    default = Path(__file__).parents[2] / "src/eagor/perception/scout/scout.onnx"
    parser = argparse.ArgumentParser(description="Held-out figures of a scout.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", type=Path, default=default)
    parser.add_argument("--apartments", type=int)
    parser.add_argument("--out", type=Path, help="also write the figures there, as JSON")
    given = parser.parse_args()
    apartments = read_split(given.folder, given.apartments)
    respond = onnx_respond(given.model)
    rows = rows_of(apartments, respond)
    found, between = figures(rows), intervals(rows)
    report = {
        "apartments": len(apartments),
        "views": sum(len(apartment.rgb) for apartment in apartments),
        "visible targets": sum("error" in row for row in rows),
        "figures": {key: [round(v, 4), *(round(float(b), 4) for b in between[key])] for key, v in found.items()},
        "milliseconds": round(milliseconds(respond, apartments[0].rgb[0]), 1),
        **tables(rows),
    }
    print(json.dumps(report, indent=1))
    if given.out:
        given.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
