"""Promised: what other packages bring, however broken, stops no command that does not need it; the doctor names it."""

import json
import os
import subprocess
import sys

import commands
import pytest

from eagor import plugins

BROKEN = {
    "raises": "raise RuntimeError('no such luck')",
    "exits": "raise SystemExit(3)",
    "vanishes": "import os; os._exit(0)",
    "prints": "print('{\"json\": 1}'); TASK = MAKE = 1",
    "hangs": "import time; time.sleep(600)",
}
NAMED = {
    "raises": "RuntimeError: no such luck",
    "exits": "SystemExit: 3",
    "vanishes": "ends the process",
    "hangs": "took longer than",
}
IMPATIENT = "import sys; from eagor import cli, plugins; plugins.PATIENCE = 8.0; sys.exit(cli.main())"


def install(folder, name, entry_points):
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_bytes(entry_points)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    groups = {"perceptions": "MAKE", "worlds": "MAKE", "tasks": "TASK"}
    lines = []
    for group, what in groups.items():
        lines.append(f"[eagor.{group}]")
        lines += [f"{name}-{group} = broken_{name}:{what}" for name in BROKEN if name != "hangs" or group == "worlds"]
        lines.append(f"odd-{group} = no module at all!")
    for name, text in BROKEN.items():
        (folder / f"broken_{name}.py").write_text(text + "\n")
    install(folder, "broken", "\n".join(lines).encode())
    install(folder, "torn", b"[eagor.tasks]\nno value\n")
    install(folder, "bytes", b"[eagor.worlds]\nx = \xff\xfe\n")
    install(folder, "nameless", b"[eagor.worlds]\nnameless = json:loads\n")
    (folder / "nameless-1.0.dist-info" / "METADATA").unlink()
    return folder


def eagor(site, *words):
    path = os.pathsep.join([str(site), *(entry for entry in sys.path if entry)])
    command = [sys.executable, "-c", IMPATIENT, *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=900)
    assert "Traceback" not in done.stderr
    return done


@pytest.mark.slow
def test_the_doctor_names_each_and_goes_on(site):
    done = eagor(site, "doctor", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for group in ("perceptions", "worlds", "tasks"):
        for name, why in NAMED.items():
            if name != "hangs" or group == "worlds":  # one is waited for long enough
                assert why in found[group][f"{name}-{group}"]
        assert found[group][f"prints-{group}"] == "ready"
        assert "cannot be imported" in found[group][f"odd-{group}"]
    assert found["worlds"]["apartment"] == found["worlds"]["nameless"] == "ready"
    for name in ("torn 1.0", "bytes 1.0"):
        assert any(name in line and "cannot be read" in line for line in found["left_out"])


def test_commands_that_do_not_need_them_do_their_work(site, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(site)
    monkeypatch.setattr(plugins, "PATIENCE", 8.0)
    done = commands.eagor("bench", "list", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert "title" in found["waypoint"]
    assert "agents" in found["osr"]
    assert "title" not in found["prints-tasks"]
    for name in ("raises", "exits", "vanishes"):
        assert NAMED[name] in found[f"{name}-tasks"]["unavailable"]
    run = ("--perception", "truth", "--methods", "vmf", "--set", "steps=4", "--episodes", 1, "--out", tmp_path / "run")
    done = commands.eagor("bench", "run", "tracking", *run, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["episodes"] == 1


def test_who_asks_for_a_broken_one_is_told_and_stdout_is_the_results(site, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(site)
    said = NAMED | {"prints": '{"json": 1}'}
    for name in ("raises", "exits", "prints"):
        monkeypatch.delitem(sys.modules, f"broken_{name}", raising=False)
        words = ("bench", "run", f"{name}-tasks", "--perception", "truth", "--out", tmp_path / "run", "--json")
        done = commands.eagor(*words)
        assert (done.returncode, done.stdout) == (2, ""), done.stderr
        assert "Traceback" not in done.stderr
        assert said[name] in (done.stderr if name == "prints" else done.stderr.splitlines()[-1])


def test_a_package_that_cannot_be_read_takes_nothing_from_the_others(site, monkeypatch):
    monkeypatch.syspath_prepend(site)
    assert "nameless" in plugins.known("eagor.worlds", {})
    assert plugins.version_of(plugins.known("eagor.worlds", {})["nameless"]) is None
