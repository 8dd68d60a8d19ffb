"""Promised: a record that is not what was written is named, with what is wrong."""

import copy
import html
import json

import hstar_data
import osr_data
import pytest
import synthetic_runs

from eagor.cli import main
from eagor.errors import FormatError
from eagor.lab.eval.report import write_report
from eagor.lab.eval.results import made

GONE = object()


def put(record, place, value):
    *above, last = place.split("/")
    for key in above:
        record = record[int(key) if isinstance(record, list) else key]
    if value is GONE:
        del record[last]
    else:
        record[int(last) if isinstance(record, list) else last] = value


SIMULATED = [
    ("episode", GONE), ("episode", []), ("episode/id", 3), ("episode/seed", [1]), ("episode/query", None),
    ("episode/targets", "x"), ("episode/targets", [None]), ("episode/stratum", [1]), ("methods", []),
    ("methods/eagor", None), ("methods/eagor/metrics", GONE), ("methods/eagor/metrics/L1", "x"),
    ("methods/eagor/metrics/L1", 1e308), ("methods/eagor/trace", []), ("methods/eagor/trace/error_deg", GONE),
    ("methods/eagor/trace/error_deg", []), ("methods/eagor/trace/error_deg/0", {}), ("truth", [1]),
    ("truth/pose/0", [1, 2]), ("truth/pose/0", [0, 0, 0, 0, 0, 0, 0]), ("truth/visible/1", "yes"), ("truth/leg", [{}]),
    ("truth/azimuth_deg", [1.0]), ("seconds", "long"), ("looked", {"looks": 1}), ("truth", GONE),
    ("methods/eagor/trace/searching", [1, 0]), ("methods/eagor/trace/searching", "yes"),
]  # fmt: skip
PUBLISHED = [
    ("case", GONE), ("case", []), ("cluster", {}), ("score", "x"), ("score", 7), ("tags", None), ("tags", [3]),
    ("by_turn", [2]), ("views", None), ("stated", 1e308), ("steps", {}), ("steps/0", None), ("steps/0/would", 3),
    ("scores", []), ("error", "far"), ("level", []),
]  # fmt: skip


@pytest.fixture(scope="module")
def walk():
    return json.loads(json.dumps(synthetic_runs.waypoint(apartments=2, each=1, methods=("vmf", "eagor"))))


@pytest.mark.parametrize(("place", "value"), SIMULATED)
def test_a_record_of_a_simulated_task(walk, place, value):
    bad = copy.deepcopy(walk)
    put(bad[1], place, value)
    with pytest.raises(FormatError) as refused:
        made({"task": "waypoint"}, bad)
    assert repr(bad[1]["key"]) in str(refused.value)
    where = place.split("/")[-1 if value is GONE else 0]
    assert where in str(refused.value) or "quaternion" in str(refused.value) or "lengths" in str(refused.value)


@pytest.mark.parametrize("command", ["report", "failures", "compare"])
def test_no_command_goes_on_with_a_malformed_record(walk, tmp_path, capsys, command):
    for place, value in SIMULATED:
        bad = copy.deepcopy(walk)
        put(bad[1], place, value)
        run = str(synthetic_runs.write_run(tmp_path / "run", bad))
        code = main(["bench", command, *[run] * (1 + (command == "compare"))])
        said = capsys.readouterr()
        assert (code, said.out) == (2, ""), (place, said)
        assert repr(bad[1]["key"]) in said.err


@pytest.mark.parametrize("gone", ["pose", "true_azimuth_deg", "true_range_m", "visible"])
def test_a_record_of_a_task_where_each_method_goes_its_own_way(gone):
    records = json.loads(json.dumps(synthetic_runs.navigation(apartments=2, each=1, methods=("vmf", "eagor"))))
    put(records[1], f"methods/{next(iter(records[1]['methods']))}/trace/{gone}", GONE)
    with pytest.raises(FormatError, match=f"missing required field `{gone}`") as refused:
        made({"task": "navigation"}, records)
    assert repr(records[1]["key"]) in str(refused.value)


def test_a_record_that_lacks_what_only_pictures_need(walk, tmp_path):
    bad = copy.deepcopy(walk)
    for record in bad:
        put(record, "episode/seed", GONE)
    page = html.unescape(write_report(synthetic_runs.write_run(tmp_path / "run", bad)).read_text())
    assert f"No pictures: the record '{bad[0]['key']}' does not hold all that they need" in page


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    home = tmp_path_factory.mktemp("found")
    words = ("--data", str(hstar_data.write(home)), "--perception", "truth", "--limit", "2", "--out", str(home / "run"))
    assert main(["bench", "run", "hstar-hos", *words]) == 0
    return home / "run"


@pytest.mark.parametrize("command", ["report", "failures", "compare"])
def test_a_record_of_a_benchmark(found, capsys, command):
    kept = found / "records.jsonl"
    whole = kept.read_text()
    records = [json.loads(line) for line in whole.splitlines()]
    for place, value in PUBLISHED:
        bad = copy.deepcopy(records)
        put(bad[1], place, value)
        kept.write_text("".join(json.dumps(record) + "\n" for record in bad))
        capsys.readouterr()
        code = main(["bench", command, *[str(found)] * (1 + (command == "compare"))])
        kept.write_text(whole)
        said = capsys.readouterr()
        assert (code, said.out) == (2, ""), (place, said)
        assert repr(bad[1]["key"]) in said.err
        assert place.split("/")[0] in said.err


@pytest.fixture(scope="module")
def answered(tmp_path_factory):
    home = tmp_path_factory.mktemp("answered")
    words = ("--data", str(osr_data.write(home)), "--agent", "oracle", "--out", str(home / "run"))
    assert main(["bench", "run", "osr", *words]) == 0
    return home / "run"


@pytest.mark.parametrize("gone", ["skill", "tags", "scores", "question", "answer"])
def test_a_record_that_lacks_what_its_own_benchmark_reads(answered, capsys, gone):
    kept = answered / "records.jsonl"
    whole = kept.read_text()
    records = [json.loads(line) for line in whole.splitlines()]
    del records[1][gone]
    kept.write_text("".join(json.dumps(record) + "\n" for record in records))
    capsys.readouterr()
    code = main(["bench", "report", str(answered)])
    kept.write_text(whole)
    said = capsys.readouterr()
    assert (code, said.out) == (2, "")
    assert repr(records[1]["key"]) in said.err
    assert f"missing required field `{gone}`" in said.err
