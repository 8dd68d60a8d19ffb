"""The search of ``eagor demo``: one walk of our tracker through an apartment, and what the newest look alone says.

The looks of the walk go to every method, so that all answer the same question. The report is one HTML file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._files import write_atomic
from eagor.cli import terminal
from eagor.cli.answers import save_image
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import draw_errors, draw_strip
from eagor.lab.agents.methods import DESCRIPTIONS, EVERY, PLAIN, TrackerEstimator
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, load_place
from eagor.lab.envs.rules import Camera
from eagor.lab.eval import episodes as parts
from eagor.lab.eval.page import Cell, Picture, Row, Section, Table, Text, address_of, cell, page
from eagor.lab.eval.results import OURS
from eagor.lab.tasks.sim.rollout import Runner, Step
from eagor.metrics import angular_error_deg
from eagor.sphere import direction
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from PIL.Image import Image


PICTURE_ROWS = 320  # of a panorama
NEWEST = "the highest response of the newest look"
SPOKEN = {PLAIN: "the newest look alone", OURS: "our tracker"}
PARTS = {parts.SEEN: "once it was seen", parts.IN_SIGHT: "in sight", parts.HIDDEN: "hidden again"}
# 200 searches in apartments that no setting was chosen on, as docs/results/navigation.md has them: degrees of error in
# each of `PARTS`, with 95 % intervals.
STUDY_COMMAND = "python benchmarks/first_sighting.py --seed 8900 --episodes 200"
STUDY = {
    SPOKEN[PLAIN]: ((12.37, 9.66, 15.35), (8.59, 7.35, 9.93), (48.81, 35.08, 62.83)),
    SPOKEN[OURS]: ((11.33, 8.22, 14.83), (9.33, 7.01, 12.06), (34.47, 21.39, 49.04)),
    "a von Mises-Fisher filter": ((12.69, 8.96, 17.13), (10.62, 7.63, 14.42), (36.01, 23.06, 50.30)),
    "a grid filter": ((11.13, 8.11, 14.66), (8.21, 6.61, 9.98), (36.79, 23.24, 51.46)),
}
STUDY_IN_WORDS = (
    "One search proves nothing. Over 200 of them memory takes more than a quarter off the error while the thing is "
    "hidden again. In sight the newest look is enough; between the filters all is chance (eagor bench compares them)."
)


@dataclass(frozen=True, eq=False)
class Search:
    """One walk: the record of our tracker on it, our estimates, and every method's answers and errors, step by step.

    `answers`: per method ``(n, 3)``, in the body frame; `errors`: per method degrees ``(n,)``.
    """

    spec: EpisodeSpec
    record: dict[str, Any]
    estimates: list[Estimate]
    answers: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    perception: str

    @property
    def walk(self) -> dict[str, Any]:
        """The metrics and the trace of the walk."""
        return self.record["methods"][OURS]

    @property
    def hidden(self) -> list[tuple[int, int]]:
        """The stretches, first and last step, in which the thing is out of sight."""
        edges = np.flatnonzero(np.diff([True, *self.walk["trace"]["visible"], True]))
        return [(int(begin), int(end) - 1) for begin, end in edges.reshape(-1, 2)]

    def means(self, name: str) -> dict[str, float | None]:
        """A method's mean error, degrees, in each of `PARTS`; None where the walk has no such step."""
        here = np.array(self.walk["trace"]["visible"])
        since = np.logical_or.accumulate(here)
        chosen = {parts.SEEN: since, parts.IN_SIGHT: here, parts.HIDDEN: since & ~here}
        return {part: float(self.errors[name][steps].mean()) if steps.any() else None for part, steps in chosen.items()}


def play(seed: int, index: int, perception: str, say: bool = False) -> Search:
    """Walk through one episode of navigation with our tracker, and give its looks to every method."""
    spec = EpisodeSpec("navigation", APARTMENT, seed, index, index)
    runner, steps = Runner({"task": "navigation", "perception": perception}), list[Step]()
    estimates, answers = list[Estimate](), dict[str, np.ndarray]()
    if say:
        print(f"Building {APARTMENT} {seed}, and walking in search of something ...", flush=True)

    def keep(seen: Step) -> None:
        steps.append(seen)
        assert isinstance(seen.method, TrackerEstimator)
        estimates.append(seen.method.estimate)

    with terminal.progress("searching", len(EVERY), shown=say) as advance:
        record = runner.run_episode(spec, [OURS], keep)
        trace = record["methods"][OURS]["trace"]
        for name in EVERY:
            if name == OURS:
                answers[name] = direction(*(np.radians(trace[key]) for key in ("azimuth_deg", "elevation_deg")))
            else:
                method = runner.method(name, spec)
                answers[name] = np.array([seen.answered_by(method) for seen in steps])
            advance()
    truths = np.array([seen.truth for seen in steps])
    errors = {name: np.asarray(angular_error_deg(found, truths)) for name, found in answers.items()}
    return Search(spec, record, estimates, answers, errors, perception)


# --- in words and numbers ---------------------------------------------------------------------------------------------


def errors_table(search: Search) -> Table:
    """The errors of this walk, and those of the study."""
    rows = [Row(f"{SPOKEN[name]}, here", [*map(cell, search.means(name).values())]) for name in (PLAIN, OURS)]
    rows += [Row(name, [cell(mean, ends) for mean, *ends in figures]) for name, figures in STUDY.items()]
    note = f"here: this walk; the others: 200 searches, with 95 % intervals, perception scout. Repeat: {STUDY_COMMAND}"
    return Table("Mean error in degrees", ("", *PARTS.values()), rows, [note])


def as_json(search: Search) -> dict[str, Any]:
    """The result for ``--json``; its summary is the walk in sentences, generated from the numbers."""
    episode, visible = search.record["episode"], search.walk["trace"]["visible"]
    query, metrics = episode["query"], search.walk["metrics"]
    steps, ended = metrics["steps"], "found" if metrics["success"] else "did not find"
    summary = [
        f"The camera {ended} the {query} in {steps} steps ({steps * Camera().seconds:.0f} s). It was out of sight in "
        f"{len(visible) - sum(visible)} of {len(visible)} looks."
    ]
    ours, alone = search.means(OURS), search.means(PLAIN)
    for part, when in (parts.HIDDEN, "While it was hidden again"), (parts.IN_SIGHT, "In sight"):
        if ours[part] is not None:
            off = f"{SPOKEN[OURS]} was off by {ours[part]:.1f}°, {SPOKEN[PLAIN]} by {alone[part]:.1f}°"
            summary.append(f"{when} {off}.")
    return {
        "query": query, "scene": episode["scene"], "seed": search.spec.seed, "episode": search.spec.index,
        "perception": search.perception, "walk": metrics, "visible": visible,
        "errors_deg": {name: found.round(3).tolist() for name, found in search.errors.items()},
        "means_deg": {name: search.means(name) for name in search.errors}, "summary": summary,
    }  # fmt: skip


# --- the report -------------------------------------------------------------------------------------------------------


def write_report(search: Search, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    found, seconds = as_json(search), Camera().seconds
    times = [step * seconds for step in range(len(search.estimates))]
    half = seconds / 2  # a single look is seen, too
    shaded = [(max(times[begin] - half, 0.0), times[end] + half, "out of sight") for begin, end in search.hidden]
    curves = {SPOKEN[name]: search.errors[name].tolist() for name in (OURS, PLAIN)}
    drawn = {"beliefs": _strip(search), "errors": draw_errors(times, curves, shaded)}
    for name, picture in drawn.items():
        save_image(picture, folder / f"{name}.png")
    words = "Four panoramas with our belief as heat, our estimate, the answer of the look alone, and the truth"
    beliefs = Picture(address_of(drawn["beliefs"]), words)
    words = "Direction error over time of our tracker and of the newest look alone, on a logarithmic axis"
    errors = Picture(address_of(drawn["errors"]), words)
    lead = Text(
        f"A camera walks through {APARTMENT} {search.spec.seed} and looks for it. Heat is what our tracker believes, "
        f"and the white line holds 90 % of that. {' '.join(found['summary'])}"
    )
    heads, rows = ("mean error in degrees", *PARTS.values(), "what it is"), list[Row]()
    for name in EVERY:
        rows.append(
            Row(name, [*map(cell, search.means(name).values()), Cell(DESCRIPTIONS.get(name) or NEWEST)], "text")
        )
    steered = (
        f"Our tracker steers, without a map; all methods get its looks, through the perception {search.perception}"
    )
    walk = Table("Every method on the same looks", heads, rows, [steered])
    sections = [
        Section("Is that luck?", [Text(STUDY_IN_WORDS), errors_table(search)], "luck"),
        Section("The error on this walk", [errors, Section(walk.title, [walk])], "error"),
    ]
    return write_atomic(folder / "report.html", page(f"Where is the {found['query']}?", [lead, beliefs], sections))


def _strip(search: Search) -> Image:
    """What the camera saw at four moments, what we believed, and what that look alone says."""
    place = load_place(search.spec.world, search.spec.seed, Camera().radius)
    trace, panels = search.walk["trace"], []
    for index, what in moments(search):
        position, pose = np.split(np.array(trace["pose"][index]), [3])
        seen = place.renderer.panorama(position, rotation_from_wxyz(pose), PICTURE_ROWS, range=False, ids=False)
        truth = direction(*(math.radians(trace[f"true_{part}_deg"][index]) for part in ("azimuth", "elevation")))
        ours, alone = (search.errors[name][index] for name in (OURS, PLAIN))
        title = f"{index * Camera().seconds:g} s, {what}: ours off by {ours:.0f}°, the look by {alone:.0f}°"
        shown = {"panorama": seen.rgb, "belief": search.estimates[index], "modes": (), "truth": truth}
        panels.append(shown | {"others": {SPOKEN[PLAIN]: search.answers[PLAIN][index]}, "title": title})
    return draw_strip(panels)


def moments(search: Search) -> list[tuple[int, str]]:
    """At most four moments for pictures, in order of time: chosen by what is in sight, not by who is right."""
    visible = search.walk["trace"]["visible"]
    chosen = {0: "the first look"}
    if any(visible):
        first = visible.index(True)
        chosen.setdefault(first, "in sight for the first time")
        if again := [(end - begin, begin) for begin, end in search.hidden if begin > first]:
            longest, begin = max(again, key=lambda stretch: stretch[0])
            chosen.setdefault(begin + longest // 2, "hidden again")
    chosen.setdefault(len(visible) - 1, "the last look")
    return sorted(chosen.items())
