"""Promised: a record that is not what was written is named, with what is wrong, by every command that reads it."""

import json

import hstar_data
import pytest
import synthetic_runs
from commands import answer, refused
from mutations import put, taken_out

from eagor.errors import FormatError
from eagor.lab.eval import log
from eagor.lab.eval.results import made

GONE = object()
SIMULATED = [
    ("episode", GONE), ("episode/id", 3), ("episode/seed", [1]), ("episode/query", None),
    ("episode/targets", "x"), ("episode/stratum", [1]), ("methods", []),
    ("methods/eagor", None), ("methods/eagor/metrics", GONE), ("methods/eagor/metrics/L1", "x"),
    ("methods/eagor/trace", []), ("methods/eagor/trace/error_deg", GONE),
    ("methods/eagor/trace/error_deg", []), ("methods/eagor/trace/error_deg/0", {}), ("truth", [1]),
    ("truth/pose/0", [1, 2]), ("truth/leg", [{}]),
    ("truth/azimuth_deg", [1.0]), ("seconds", "long"), ("truth", GONE),
    ("methods/eagor/trace/searching", [1, 0]), ("methods/eagor/trace/searching", "yes"),
]  # fmt: skip
WALKED = [(f"methods/vmf/trace/{gone}", GONE) for gone in ("pose", "true_azimuth_deg", "true_range_m", "visible")]
PUBLISHED = [
    ("case", GONE), ("case", []), ("cluster", {}), ("score", "x"), ("score", 7), ("tags", None), ("tags", [3]),
    ("by_turn", [2]), ("views", None), ("stated", 1e308),
    ("scores", []), ("error", "far"), ("level", []),
]  # fmt: skip
CASES = [
    *(("waypoint", *case) for case in SIMULATED),
    *(("navigation", *case) for case in WALKED),
    *(("hstar-hos", *case) for case in PUBLISHED),
]


def changed(record, place, value):
    """The record with another value at a place, or without any."""
    path = tuple(int(key) if key.isdigit() else key for key in place.split("/"))
    return taken_out(record, path) if value is GONE else put(record, path, value)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The folder of a small good run of each task."""
    home = tmp_path_factory.mktemp("runs")
    for make in (synthetic_runs.waypoint, synthetic_runs.navigation):
        synthetic_runs.write_run(home / make.__name__, make(apartments=2, each=1, methods=("vmf", "eagor")))
    for task, data, words in (
        ("hstar-hos", hstar_data.write(home / "hstar data"), ("--perception", "truth", "--limit", "2")),
    ):
        answer("bench", "run", task, "--data", data, *words, "--out", home / task)
    return home


def damaged(runs, task, place, value):
    """The description and the records of the run, one of them changed, and its key."""
    records = [json.loads(line) for line in (runs / task / log.RECORDS).read_text().splitlines()]
    which = 0 if task == "navigation" else 1
    changed(records[which], place, value)
    return log.description(runs / task), records, records[which]["key"]


@pytest.mark.parametrize(("task", "place", "value"), CASES)
def test_what_is_no_record_is_named(runs, task, place, value):
    settings, records, key = damaged(runs, task, place, value)
    with pytest.raises(FormatError) as refused:
        made(settings, records)
    said = str(refused.value)
    assert repr(key) in said
    assert place.split("/")[-1 if value is GONE else 0] in said or "quaternion" in said or "lengths" in said


@pytest.mark.parametrize("command", ["report", "failures", "compare"])
@pytest.mark.parametrize(("task", "place"), [("waypoint", "methods/eagor/trace"), ("hstar-hos", "score")])
def test_no_command_goes_on_with_it(runs, tmp_path, command, task, place):
    settings, records, key = damaged(runs, task, place, "x")
    (tmp_path / log.RUN).write_text(json.dumps(settings))
    (tmp_path / log.RECORDS).write_text("".join(json.dumps(record) + "\n" for record in records))
    assert repr(key) in refused("bench", command, *[tmp_path] * (1 + (command == "compare")))
