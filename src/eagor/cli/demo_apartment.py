"""The search of ``eagor demo``: one walk of our tracker through an apartment, and what the newest look alone says.

The looks of the walk go to every method, so that all answer the same question. The report is one HTML file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._files import written
from eagor.cli import terminal
from eagor.cli.answers import save_image
from eagor.conventions import rotation_from_wxyz
from eagor.drawing import draw_errors, draw_map, draw_strip
from eagor.lab.agents.methods import DESCRIPTIONS, EVERY, PLAIN, TrackerEstimator
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, Place, load_place
from eagor.lab.envs.rules import Camera, NavigationRules
from eagor.lab.eval import episodes as parts
from eagor.lab.eval.page import Cell, Pictures, Row, Section, Table, Text, address_of, page
from eagor.lab.eval.results import OURS
from eagor.lab.tasks.sim.play import Runner, Step
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
    rules: NavigationRules
    record: dict[str, Any]
    estimates: list[Estimate]
    answers: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    perception: str

    @property
    def thing(self) -> str:
        """The query."""
        return self.record["episode"]["query"]

    @property
    def walk(self) -> dict[str, Any]:
        """The metrics and the trace of the walk."""
        return self.record["methods"][OURS]

    @property
    def visible(self) -> list[bool]:
        """Whether the thing is in sight, step by step."""
        return self.walk["trace"]["visible"]

    @property
    def hidden(self) -> list[tuple[int, int]]:
        """The stretches, first and last step, in which it is out of sight."""
        edges = np.flatnonzero(np.diff([True, *self.visible, True]))
        return [(int(begin), int(end) - 1) for begin, end in edges.reshape(-1, 2)]

    @property
    def means(self) -> dict[str, dict[str, float | None]]:
        """Each method's mean error, degrees, in each of `PARTS`; None where the walk has no such step."""
        here = np.array(self.visible)
        since = np.logical_or.accumulate(here)
        chosen = {parts.SEEN: since, parts.IN_SIGHT: here, parts.HIDDEN: since & ~here}
        return {
            name: {part: float(errors[steps].mean()) if steps.any() else None for part, steps in chosen.items()}
            for name, errors in self.errors.items()
        }


def play(seed: int, index: int, perception: str, say: bool = False) -> Search:
    """Walk through one episode of navigation with our tracker, and give its looks to every method."""
    spec, config = EpisodeSpec("navigation", APARTMENT, seed, index, index), {"task": "navigation"}
    runner, steps, estimates = Runner(config | {"perception": perception}), list[Step](), list[Estimate]()
    if say:
        print(f"Building {APARTMENT} {seed}, and walking in search of something ...", flush=True)

    def keep(seen: Step) -> None:
        steps.append(seen)
        if isinstance(seen.method, TrackerEstimator):
            estimates.append(seen.method.estimate)

    with terminal.progress("searching", len(EVERY), shown=say) as advance:
        record = runner.run_episode(spec, [OURS], keep)
        advance()
        trace, truths = record["methods"][OURS]["trace"], np.array([seen.truth for seen in steps])
        azimuth, elevation = (np.radians(trace[f"{part}_deg"]) for part in ("azimuth", "elevation"))
        answers = {OURS: direction(azimuth, elevation)}
        for name in EVERY:
            if name != OURS:
                method = runner.method(name, spec)
                answers[name] = np.array([seen.answered_by(method) for seen in steps])
                advance()
    errors = {name: np.asarray(angular_error_deg(found, truths)) for name, found in answers.items()}
    return Search(spec, runner.rules, record, estimates, answers, errors, perception)


# --- in words and numbers ---------------------------------------------------------------------------------------------


def as_text(search: Search) -> list[str]:
    """The errors of this walk, and those of the study."""
    means = search.means
    rows = {f"{SPOKEN[name]}, here": [_degrees(means[name][part]) for part in PARTS] for name in (PLAIN, OURS)}
    rows = {"mean error": PARTS.values(), **rows} | {name: map(_interval, cells) for name, cells in STUDY.items()}
    lines = [f"{name:28}" + "".join(f"{cell:>24}" for cell in cells) for name, cells in rows.items()]
    note = "here: this walk; the others: 200 searches, with 95 % intervals (in the repository: "
    return [*lines, f"{note}{STUDY_COMMAND})"]


def as_json(search: Search) -> dict[str, Any]:
    """The result for ``--json``."""
    return {
        "query": search.thing, "scene": search.record["episode"]["scene"], "seed": search.spec.seed,
        "episode": search.spec.index, "perception": search.perception, "walk": search.walk["metrics"],
        "visible": search.visible,
        "errors_deg": {name: found.round(3).tolist() for name, found in search.errors.items()},
        "means_deg": search.means,
        "what": {name: DESCRIPTIONS.get(name, SPOKEN[PLAIN]) for name in search.errors},
        "summary": summary(search),
    }  # fmt: skip


def summary(search: Search) -> list[str]:
    """The walk in sentences, generated from the numbers."""
    metrics, seconds = search.walk["metrics"], Camera().seconds
    ended = "found" if metrics["success"] else "did not find"
    away = sum(not seen for seen in search.visible)
    lines = [
        f"The camera {ended} the {search.thing} in {metrics['steps']} steps ({metrics['steps'] * seconds:.0f} s). It "
        f"was out of sight in {away} of {len(search.visible)} looks."
    ]
    ours, alone = ({part: _degrees(mean) for part, mean in search.means[name].items()} for name in (OURS, PLAIN))
    if ours[parts.HIDDEN] != NONE:
        away, said = ours[parts.HIDDEN], alone[parts.HIDDEN]
        lines.append(f"While it was hidden again, {SPOKEN[OURS]} was off by {away}, {SPOKEN[PLAIN]} by {said}.")
    if ours[parts.IN_SIGHT] != NONE:
        lines.append(f"In sight: {ours[parts.IN_SIGHT]} and {alone[parts.IN_SIGHT]}.")
    return lines


NONE = "-"


def _degrees(value: float | None) -> str:
    return NONE if value is None else f"{value:.1f}°"


def _interval(cell: tuple[float, float, float]) -> str:
    return "{:.1f}° ({:.1f} to {:.1f})".format(*cell)


# --- the report -------------------------------------------------------------------------------------------------------


def write_report(search: Search, folder: Path) -> Path:
    """Draw the pictures into `folder` and write report.html there; returns its path. Raises `StorageError`."""
    place, seconds = load_place(search.spec.world, search.spec.seed, Camera().radius), Camera().seconds
    times = [step * seconds for step in range(len(search.visible))]
    shaded = [(times[begin], times[end], "out of sight") for begin, end in search.hidden]
    curves = {SPOKEN[name]: search.errors[name].tolist() for name in (OURS, PLAIN)}
    words = "Four panoramas with our belief as heat, our estimate, the answer of the look alone, and the truth"
    beliefs = _kept(_strip(search, place), folder / "beliefs.png", words)
    words = "Direction error over time of our tracker and of the newest look alone, on a logarithmic axis"
    errors = _kept(draw_errors(times, curves, shaded), folder / "errors.png", words)
    words = "Floor plan with the way of the camera from the start to where it ended"
    above = _kept(_map(search, place), folder / "map.png", words)
    means, heads, rows = search.means, ("mean error", *PARTS.values()), list[Row]()
    for name in EVERY:
        cells = [*(_degrees(means[name][part]) for part in PARTS), DESCRIPTIONS.get(name) or NEWEST]
        rows.append(Row(name, _cells(cells), "text ours" if name == OURS else "text"))
    ours = SPOKEN[OURS]
    study = [Row(name, _cells(map(_interval, cells)), "ours" * (name == ours)) for name, cells in STUDY.items()]
    lead = Text(
        f"A camera walks through {APARTMENT} {search.spec.seed} and looks for it. Heat is what our tracker believes, "
        f"and the white line holds 90 % of that. {' '.join(summary(search))}"
    )
    way = Text(
        f"Each step goes {Camera().step} m, sliding along walls; the search is over within "
        f"{search.rules.success_distance} m (of walking) of the {search.thing}, or after {search.rules.max_steps} "
        "steps. Our tracker steers, without a map: it walks by the floor that its looks have shown. All methods get "
        f"its looks, through the perception {search.perception}.", "note",
    )  # fmt: skip
    repeat = Text(f"The perception is scout, and intervals are of 95 %. Repeat it: {STUDY_COMMAND}", "note")
    walk = Table("Every method on this walk", (*heads, "what it is"), rows)
    more = Section("The way from above, and every method on the same looks", [above, way, walk])
    sections = [
        Section("Is that luck?", [Text(STUDY_IN_WORDS), Table("200 searches", heads, study), repeat], "luck"),
        Section("The error on this walk", [errors, more], "error"),
    ]
    return written(folder / "report.html", page(f"Where is the {search.thing}?", [lead, beliefs], sections))


def _kept(picture: Image, path: Path, words: str) -> Pictures:
    """A picture of the page, which is written as a file as well."""
    save_image(picture, path)
    return Pictures([(address_of(picture), words)], "wide")


def _cells(cells: Iterable[str]) -> list[Cell]:
    return [*map(Cell, cells)]


def _strip(search: Search, place: Place) -> Image:
    """What the camera saw at four moments, what we believed, and what that look alone says."""
    trace, panels = search.walk["trace"], []
    for index, what in _moments(search):
        pose = np.array(trace["pose"][index])
        seen = place.renderer.panorama(pose[:3], rotation_from_wxyz(pose[3:]), PICTURE_ROWS, range=False, ids=False)
        true = direction(*(math.radians(trace[f"true_{part}_deg"][index]) for part in ("azimuth", "elevation")))
        ours, alone = (search.errors[name][index] for name in (OURS, PLAIN))
        title = f"{index * Camera().seconds:g} s, {what}: ours off by {ours:.0f}°, the look by {alone:.0f}°"
        others = {SPOKEN[PLAIN]: search.answers[PLAIN][index]}
        shown = {"panorama": seen.rgb, "belief": search.estimates[index], "modes": (), "truth": true}
        panels.append(shown | {"others": others, "title": title})
    return draw_strip(panels)


def _moments(search: Search) -> list[tuple[int, str]]:
    """At most four moments for pictures, in order of time: chosen by what is in sight, not by who is right."""
    chosen = {0: "the first look"}
    if seen := [index for index, here in enumerate(search.visible) if here]:
        chosen.setdefault(seen[0], "in sight for the first time")
        if again := [(begin, end) for begin, end in search.hidden if begin > seen[0]]:
            begin, end = max(again, key=lambda stretch: stretch[1] - stretch[0])
            chosen.setdefault((begin + end) // 2, "hidden again")
    chosen.setdefault(len(search.visible) - 1, "the last look")
    return sorted(chosen.items())


def _map(search: Search, place: Place) -> Image:
    ground, (x, y) = place.ground, place.ground.origin
    rows, cols = ground.free.shape
    target = place.scene.instances[search.record["episode"]["targets"][0]].centre
    extent = (float(x), float(x + cols * ground.cell), float(y), float(y + rows * ground.cell))
    way = np.array(search.walk["trace"]["pose"])[:, :2]
    return draw_map(ground.structure, ground.free, extent, way, target, "the way of the camera")
