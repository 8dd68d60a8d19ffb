"""The demo's search: every method plays one episode; a summary in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from eagor.cli import terminal
from eagor.evaluation.published import OURS, PAPERS
from eagor.perception import load, rows_of
from eagor.tasks.episodes import Slot
from eagor.tasks.methods import NAMES, TrackerMethod
from eagor.tasks.models import is_privileged
from eagor.tasks.places import APARTMENT
from eagor.tasks.play import Player, Seen
from eagor.tasks.rules import Camera, Disturbances, NavigationRules, as_dict
from eagor.tracking.estimate import Estimate

SPOKEN = {
    "centroid": "the plain centroid",
    "cent_circ": "the circular centroid",
    "grid": "the published pixel grid",
    "eagor_paper": "EAGOR as published",
    "best_detection": "the best detection so far",
    "last_detection": "the last detection",
    "vmf": "the von Mises-Fisher filter",
    "grid_filter": "the grid filter",
    "particle_filter": "the particle filter",
    "eagor": "our tracker",
}


@dataclass(frozen=True, eq=False)
class Search:
    """The episode's record, each method's part of it, and our estimates step by step.

    `perception`: its name; `drawn`: whether its mistakes are random, drawn from the episode's seed.
    """

    slot: Slot
    rules: NavigationRules
    episode: dict[str, Any]
    methods: dict[str, dict[str, Any]]
    estimates: list[Estimate]
    perception: str
    drawn: bool

    @property
    def thing(self) -> str:
        """The query."""
        return self.episode["query"]


def play(seed: int, index: int, perception: str, say: bool = False) -> Search:
    """Play one episode of navigation with every method."""
    rules, seeing = NavigationRules(), load(perception)
    config = {
        "task": "navigation",
        "perception": perception,
        "rules": as_dict(rules),
        "camera": as_dict(Camera()),
        "disturbances": as_dict(Disturbances()),
        "rows": rows_of(seeing),
    }
    slot = Slot("navigation", APARTMENT, seed, index, index)
    estimates: list[Estimate] = []
    player = Player(config, seeing)
    if say:
        print(f"Building {APARTMENT} {seed} and looking for something to search ...", flush=True)
    episode = player.plan(slot)
    if say:
        print(
            f"A camera stands in {episode.scene}, {episode.shortest:.1f} m of walking from the {episode.query}, with "
            f"its back to it. Each of {len(NAMES)} methods walks on its own, seeing through the same perception "
            f"({perception}).",
            flush=True,
        )
    found: dict[str, dict[str, Any]] = {}
    record: dict[str, Any] = {}

    def keep(seen: Seen) -> None:
        if isinstance(seen.method, TrackerMethod):
            estimates.append(seen.method.estimate)

    with terminal.progress("searching", len(NAMES)) as advance:
        for name in NAMES:
            record = player.play(slot, [name], keep if name == OURS else None)
            found |= record["methods"]
            advance()
    return Search(slot, rules, record["episode"], found, estimates, perception, is_privileged(seeing))


def summary(search: Search) -> list[str]:
    """The result in sentences, generated from the numbers."""
    metrics = {name: part["metrics"] for name, part in search.methods.items()}
    lines = [f"{_told(OURS, metrics, search)}; {_told('centroid', metrics, search, short=True)}."]
    lines[0] = lines[0][0].upper() + lines[0][1:]
    published = _told(PAPERS, metrics, search, short=True)
    lines.append(f"{published[0].upper()}{published[1:]}, off by {metrics[PAPERS]['mae']:.0f} degrees on average; "
                 f"ours by {metrics[OURS]['mae']:.0f}.")  # fmt: skip
    faster = [n for n, m in metrics.items() if m["success"] and n != OURS and m["steps"] < metrics[OURS]["steps"]]
    if metrics[OURS]["success"] and faster:
        best = min(faster, key=lambda name: metrics[name]["steps"])
        lines.append(f"The quickest was {SPOKEN[best]}, with {metrics[best]['steps']} steps.")
    found = sum(bool(m["success"]) for m in metrics.values())
    lines.append(
        f"{found} of {len(metrics)} methods found it. One episode shows how it works, not who is better: for that, "
        "see eagor bench."
    )
    return lines


def collisions(search: Search) -> str:
    """What a collision is, and how many there were."""
    numbers = {name: part["metrics"]["collisions"] for name, part in search.methods.items()}
    steps = search.methods[OURS]["metrics"]["steps"]
    return (
        "A collision is a step that a wall or a piece of furniture cut short; the body slides on along it. No method "
        "has a map: each walks by the floor that its looks have shown, and learns by touching of what reaches over it. "
        f"So collisions are part of the ways here: {numbers[OURS]} in the {steps} steps of our tracker, "
        f"{min(numbers.values())} to {max(numbers.values())} over all methods."
    )


def mistakes(search: Search) -> str:
    """Where the mistakes of the perception come from."""
    told = f"All methods see through the same perception, {search.perception}."
    if search.drawn:
        return f"{told} Its mistakes are drawn from one seed."
    return f"{told} What it gets wrong depends on the picture, so methods that walk elsewhere meet other mistakes."


def _told(name: str, metrics: dict[str, Any], search: Search, short: bool = False) -> str:
    m = metrics[name]
    thing = "it" if short else f"the {search.thing}"
    if m["success"]:
        return f"{SPOKEN[name]} found {thing} in {m['steps']} steps"
    return f"{SPOKEN[name]} gave up on {thing} after {m['steps']} steps" if not short else (
        f"{SPOKEN[name]} gave up after {m['steps']}"
    )  # fmt: skip
