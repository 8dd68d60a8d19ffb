"""The tables of `photographs`: what each method said of each thing, and the figures made of it.

Each function of `TABLES` gives one table: rows of plain values. `print_all` prints them. A unit of every interval is a
thing on a photograph, or a class that is absent from one; intervals are 95 % bootstrap intervals, from a fixed seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from eagor.statistics import bootstrap_interval

NEAR = 15  # degrees
SCORED = (1, 3, 10, 30, 40)  # after how many looks the log score is taken
LEAST = 1e-6  # probabilities are clipped from below
SWING, SEEN_BEFORE = 0.3, 3  # change of presence from look to look; looks that have seen the thing before
STATUSES = ("tracking", "ambiguous", "searching")
RESAMPLES = 2000

Row = dict[str, Any]
Span = list[float] | None


@dataclass(frozen=True)
class Run:
    """One method on one case. Lists have an entry for each frame.

    `here`: whether the thing is there; `lookalike`: whether the detector sees it most of the time where it is not;
    `boxes`: whether a box of score 0.3 or more was seen, `near_boxes`: within 15 degrees of an instance. `errors`:
    degrees to the nearest instance; `covered`: whether the 90 % region holds one, None where that was not judged.
    Trackers also say `presence`, `status`, and, by the number of looks, `log_scores`. `right`: whether the answer is
    within 15 degrees, or half the thing's size, of the nearest instance. What needs a thing is empty without one.
    """

    photograph: str
    condition: str
    query: str
    method: str
    here: bool
    lookalike: bool
    boxes: Sequence[bool] = ()
    near_boxes: Sequence[bool] = ()
    errors: list[float] = field(default_factory=list)
    covered: list[bool | None] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    presence: list[float] = field(default_factory=list)
    status: list[str] = field(default_factory=list)
    log_scores: dict[int, float] = field(default_factory=dict)

    @property
    def base(self) -> str:
        """The method without its settings."""
        return self.method.partition(":")[0]

    @property
    def error(self) -> float:
        """Mean error over the last ten looks, degrees."""
        return float(np.mean(self.errors[-10:]))

    @property
    def within(self) -> float:
        """Share of the last ten looks with an error below 15 degrees."""
        return float(np.mean(np.array(self.errors[-10:]) < NEAR))


def groups(runs: Sequence[Run], here: bool | None = None) -> Iterator[tuple[str, str, list[Run]]]:
    """Condition, method, and the runs of both; with `here` only those where the thing is there, or is not."""
    for condition in dict.fromkeys(run.condition for run in runs):
        for method in dict.fromkeys(run.method for run in runs):
            own = [run for run in runs if (run.condition, run.method) == (condition, method)]
            own = [run for run in own if here is None or run.here == here]
            if own:
                yield condition, method, own


def trackers(runs: Sequence[Run], here: bool | None = None) -> Iterator[tuple[str, str, list[Run]]]:
    """As `groups`, only for methods that say how probable it is that the thing is there."""
    return groups([run for run in runs if run.presence], here)


def mean(values: Sequence[float]) -> float | None:
    """The mean, None of nothing."""
    return float(np.mean(values)) if len(values) else None


def interval(values: Sequence[float]) -> Span:
    """The 95 % interval of a mean; None for fewer than two values."""
    if len(values) < 2:
        return None
    found = bootstrap_interval(values, np.random.default_rng(0), resamples=RESAMPLES)
    return [found.low, found.high]


def sum_interval(a: Sequence[float], b: Sequence[float]) -> Span:
    """The 95 % interval of the sum of two means, each resampled on its own."""
    if not len(a) or not len(b):
        return None
    rng = np.random.default_rng(0)
    drawn = sum(np.array(x)[rng.integers(len(x), size=(RESAMPLES, len(x)))].mean(axis=1) for x in (a, b))
    return [float(end) for end in np.quantile(drawn, (0.025, 0.975))]


def found(runs: Sequence[Run]) -> list[Row]:
    """Errors, share within 15 degrees and coverage in the last ten looks, of every method."""
    rows = []
    for condition, method, own in groups(runs, here=True):
        first, last, near = [r.errors[0] for r in own], [r.error for r in own], [r.within for r in own]
        held = [x for r in own for x in r.covered[-10:] if x is not None]
        row: Row = {"condition": condition, "method": method, "things": len(own)}
        for name, values in (("first", first), ("last_ten", last), ("within", near)):
            row |= {name: mean(values), f"{name}_interval": interval(values)}
        rows.append(row | {"covered": mean(held), "covered_looks": len(held)})
    return rows


def claims(runs: Sequence[Run]) -> list[Row]:
    """How often a tracker claims a thing, here and absent, and what a single box of score 0.3 would have said."""
    rows = []
    for condition, method, both in trackers(runs):
        for words, here in (("here", True), ("absent", False)):
            own = [run for run in both if run.here == here]
            if not own:
                continue
            lasting = [run.presence[-1] for run in own if run.lookalike]
            row: Row = {"condition": condition, "method": method, "truth": words, "cases": len(own)}
            row["claimed_first"] = mean([run.presence[0] > 0.5 for run in own])
            row["claimed_last"] = mean([run.presence[-1] > 0.5 for run in own])
            row["box_first"] = mean([run.boxes[0] for run in own])
            row["box_last_ten"] = mean([any(run.boxes[-10:]) for run in own])
            row |= {"lookalikes": len(lasting) / len(own), "lookalike_presence": mean(lasting)}
            rows.append(row)
    return rows


def log_scores(runs: Sequence[Run]) -> list[Row]:
    """The log score after some looks: its mean over things plus its mean over absent classes. Higher is better."""
    rows = []
    for condition, method, own in trackers(runs):
        row: Row = {"condition": condition, "method": method}
        for looks in SCORED:
            here = [run.log_scores[looks] for run in own if run.here]
            absent = [run.log_scores[looks] for run in own if not run.here]
            total = float(np.mean(here) + np.mean(absent)) if here and absent else None
            row[f"after_{looks}"] = total
            row |= {"things": mean(here), "absent": mean(absent)}  # of the last
        row[f"after_{looks}_interval"] = sum_interval(here, absent)
        rows.append(row)
    return rows


def swings(runs: Sequence[Run]) -> list[Row]:
    """How often presence jumps although the thing is there and was seen: share of the looks after the third box."""
    rows = []
    for condition, method, own in trackers(runs, here=True):
        jumps = [abs(b - a) > SWING for run in own for a, b in list(pairwise(run.presence))[_settled(run) :]]
        rows.append({"condition": condition, "method": method, "share": mean(jumps), "looks": len(jumps)})
    return rows


def _settled(run: Run) -> int:
    """The frame of the third look with a box near the thing; the number of frames if there is none."""
    at = np.flatnonzero(run.near_boxes)
    return int(at[SEEN_BEFORE - 1]) if len(at) >= SEEN_BEFORE else len(run.near_boxes)


def paired(runs: Sequence[Run]) -> list[Row]:
    """Each rival against each variant of ours, on the same things: rival minus ours, over the last ten looks."""
    rows = []
    for condition, ours, rivals in _matches(runs):
        for name, rival in rivals.items():
            row: Row = {"condition": condition, "ours": ours[0].method, "rival": name, "things": len(ours)}
            for key, sign in (("error", 1), ("within", -1)):
                apart = [getattr(b, key) - getattr(a, key) for a, b in zip(ours, rival, strict=True)]
                ends = interval(apart)
                row |= {key: mean(apart), f"{key}_interval": ends, f"{key}_ahead": _ahead(ends, sign)}
            rows.append(row)
    return rows


def _ahead(ends: Span, sign: int) -> str:
    """Who is ahead beyond chance; `sign` is 1 where a larger value of the rival is good for us."""
    if ends is None or ends[0] <= 0 <= ends[1]:
        return ""
    return "ours" if sign * ends[0] > 0 else "rival"


def ranks(runs: Sequence[Run]) -> list[Row]:
    """The place of our mean among ours and all rivals, 1 is the best; other variants of ours do not count."""
    rows = []
    for condition, ours, rivals in _matches(runs):
        row: Row = {"condition": condition, "ours": ours[0].method, "of": 1 + len(rivals)}
        for key, sign in (("error", 1), ("within", -1)):
            own, others = _rank_mean(ours, key), [_rank_mean(rival, key) for rival in rivals.values()]
            row[f"{key}_rank"] = 1 + sum(sign * other < sign * own for other in others)
        rows.append(row)
    return rows


def _rank_mean(runs: Sequence[Run], key: str) -> float:
    """The mean over things, rounded so that equal ones tie."""
    return round(float(np.mean([getattr(run, key) for run in runs])), 9)


def _matches(runs: Sequence[Run]) -> Iterator[tuple[str, list[Run], dict[str, list[Run]]]]:
    """Condition, the runs of one variant of ours, and those of each rival; in each the same things in one order."""
    played = {(condition, method): own for condition, method, own in groups(runs, here=True)}
    for (condition, _), ours in played.items():
        if ours[0].base == "eagor":
            yield (
                condition,
                ours,
                {m: own for (c, m), own in played.items() if c == condition and own[0].base != "eagor"},
            )


def lookalikes(runs: Sequence[Run]) -> list[Row]:
    """Every absent class that the detector sees at one place most of the time."""
    return [
        {
            "photograph": run.photograph,
            "class": run.query,
            "condition": run.condition,
            "method": run.method,
            "presence": run.presence[-1],
            "highest": max(run.presence[-10:]),
        }
        for _, _, own in trackers(runs, here=False)
        for run in own
        if run.lookalike
    ]


def statuses(runs: Sequence[Run]) -> list[Row]:
    """How often each status is told of things that are there, and how often the answer is right while "tracking"."""
    rows = []
    for condition, method, own in trackers(runs, here=True):
        told = [status for run in own for status in run.status]
        right = [x for run in own for x, status in zip(run.right, run.status, strict=True) if status == "tracking"]
        row: Row = {"condition": condition, "method": method, "looks": len(told)}
        row |= {name: told.count(name) / len(told) for name in STATUSES}
        rows.append(row | {"right": mean(right), "tracking_looks": len(right)})
    return rows


TABLES: dict[str, Callable[[Sequence[Run]], list[Row]]] = {
    "found": found,
    "absent": claims,
    "log_score": log_scores,
    "swings": swings,
    "paired": paired,
    "ranks": ranks,
    "lookalikes": lookalikes,
    "status": statuses,
}
# Of each table: its title, and its columns: heading, key, digits after the point. A number's interval is shown with it.
SHOWN: dict[str, tuple[str, list[tuple[str, str, int]]]] = {
    "found": (
        "Things that are there: error, share within 15 degrees in the last ten looks, coverage of the 90 % regions",
        [("first look, deg", "first", 1), ("last ten, deg", "last_ten", 1), ("within 15", "within", 2),
         ("covered", "covered", 2), ("of looks", "covered_looks", 0)],
    ),
    "absent": (
        "How often something is claimed: presence > 0.5, a box of 0.3 or more, and lasting look-alikes",
        [("", "truth", 0), ("claim, first", "claimed_first", 3), ("claim, last", "claimed_last", 3),
         ("box, first", "box_first", 3), ("box, last ten", "box_last_ten", 3), ("look-alikes", "lookalikes", 3),
         ("their presence", "lookalike_presence", 2), ("of cases", "cases", 0)],
    ),
    "log_score": (
        "Log score after so many looks (things + absent; higher is better), and the two parts of the last",
        [*((f"{looks}", f"after_{looks}", 3) for looks in SCORED), ("things", "things", 3), ("absent", "absent", 3)],
    ),
    "swings": (
        "Presence swings by more than 0.3 from look to look, once the thing was seen in three looks",
        [("share", "share", 4), ("of looks", "looks", 0)],
    ),
    "paired": (
        "Rival minus ours over the last ten looks, and who is ahead beyond chance",
        [("rival", "rival", 0), ("error, deg", "error", 1), ("ahead", "error_ahead", 0), ("within 15", "within", 2),
         ("ahead", "within_ahead", 0)],
    ),
    "ranks": (
        "Place of our mean among ours and all rivals (1 is the best)",
        [("error", "error_rank", 0), ("within 15", "within_rank", 0), ("of", "of", 0)],
    ),
    "lookalikes": (
        "Absent classes with a lasting look-alike: presence at the end, and the highest over the last ten looks",
        [("photograph", "photograph", 0), ("class", "class", 0), ("at the end", "presence", 2),
         ("highest", "highest", 2)],
    ),
    "status": (
        "Status, share of the looks at things that are there; how often the answer is right while tracking",
        [*((name, name, 3) for name in STATUSES), ("of looks", "looks", 0), ("right", "right", 3),
         ("of tracking", "tracking_looks", 0)],
    ),
}  # fmt: skip


def print_all(runs: Sequence[Run]) -> None:
    """Print every table that has rows."""
    for name, table in TABLES.items():
        title, columns = SHOWN[name]
        if rows := table(runs):
            who = "ours" if "ours" in rows[0] else "method"
            print(f"\n{title}\n")
            print_table([("", "condition", 0), ("", who, 0), *columns], rows)


def print_table(columns: Sequence[tuple[str, str, int]], rows: Sequence[Row]) -> None:
    """Columns as wide as they need to be: text to the left, numbers to the right."""
    lines = [[cell(row, key, digits) for _, key, digits in columns] for row in rows]
    for line in [[heading for heading, _, _ in columns], *lines]:
        parts = []
        for place, (text, (_, key, _)) in enumerate(zip(line, columns, strict=True)):
            wide = max(len(columns[place][0]), *(len(other[place]) for other in lines))
            parts.append(f"{text:{'<' if isinstance(rows[0][key], str) else '>'}{wide}}")
        print("  ".join(parts).rstrip())


def cell(row: Row, key: str, digits: int) -> str:
    """One value, with its interval if it has one."""
    value, ends = row[key], row.get(f"{key}_interval")
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    if ends is None:
        return f"{value:.{digits}f}"
    low, high = (f"{end:.{digits}f}" for end in ends)
    return f"{value:.{digits}f} [{low:>{digits + 4}} {high:>{digits + 4}}]"
