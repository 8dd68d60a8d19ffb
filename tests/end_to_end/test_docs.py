"""What the documentation says holds: its code runs, its commands can be typed, its tables are what scripts print."""

import importlib
import io
import os
import re
import runpy
import shlex
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import commands
import pytest
import yaml
from PIL import Image

import eagor
from eagor import plugins
from eagor.cli import _parse
from eagor.cli.demo_apartment import STUDY, STUDY_COMMAND
from eagor.lab.worlds.painted import painted_room
from eagor.sources.rigs import read_rig

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NEEDS = re.compile(r"^\*Needs [^\n]+\*\n+\Z", re.MULTILINE)  # the line before a block that cannot run by itself


def blocks(page, *languages):
    """The blocks of a page in these languages, each with whether it says what it needs."""
    text = page.read_text(encoding="utf-8")
    return [
        (found[2], NEEDS.search(text[: found.start()]) is not None)
        for found in FENCE.finditer(text)
        if found[1] in languages
    ]


def name(page):
    return str(page.relative_to(ROOT))


def fences(page):
    """Language and text of every block, whether it says what it needs, and the output that stands right under it."""
    text = page.read_text(encoding="utf-8")
    found = list(FENCE.finditer(text))
    for here, after in zip(found, [*found[1:], None], strict=True):
        under = after is not None and after[1] == "text" and not text[here.end() : after.start()].strip()
        needs = NEEDS.search(text[: here.start()])
        yield here[1], here[2], needs and needs[0].strip(), after[2] if after is not None and under else None


def written(texts, folder):
    """The program that the texts make together."""
    script = folder / "page.py"
    script.write_text("\nprint(chr(30), end='')\n".join(texts), encoding="utf-8")
    return script


def run_here(texts, folder, monkeypatch):
    """What each of the texts prints, run as one program in this process, for which warnings are errors, too."""
    monkeypatch.chdir(folder)
    script = str(written(texts, folder))
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        runpy.run_path(script, run_name="__main__")
    assert err.getvalue() == ""
    return out.getvalue().split(chr(30))


def run_python(texts, folder):
    """The same in a process of its own, which others may import."""
    script = written(texts, folder)
    environment = os.environ | {"PYTHONWARNINGS": "error", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, script.name], cwd=folder, env=environment, capture_output=True, text=True, timeout=300
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split(chr(30))


NUMBER = re.compile(r"[-+]?\d+\.?\d*")


def alike(printed, written, apart, share=0.0):
    """Whether two texts differ only in numbers, and in these by at most `apart`, and a `share` of the written one."""
    if NUMBER.sub("#", printed).split() != NUMBER.sub("#", written).split():
        return False
    ours, theirs = ([float(each) for each in NUMBER.findall(text)] for text in (printed, written))
    return all(abs(a - b) <= apart + share * abs(b) for a, b in zip(ours, theirs, strict=True))


def check_commands(page, folder, apart=0.0, share=0.0):
    """Run each shell block of `page` that has an output under it, and compare; returns how many there were.

    `apart`, `share`: by how much numbers may differ. On stderr only facts are allowed: they begin with the
    program's name.
    """
    count = 0
    for kind, text, _, under in fences(page):
        if kind == "sh" and under is not None:
            (line,) = text.splitlines()
            words = shlex.split(line, comments=True)
            assert words[0] == "eagor"
            here = os.getcwd()
            os.chdir(folder)
            try:
                done = commands.eagor(*words[1:])
            finally:
                os.chdir(here)
            said = [row for row in done.stderr.splitlines() if not re.match("eagor: (?!warning|error)", row)]
            assert (done.returncode, said) == (0, []), line
            shown = done.stdout
            if "\neagor: " in under:  # with the notes, whose place among the results nothing here tells
                shown, under = ("\n".join(sorted(text.splitlines())) for text in (shown + done.stderr, under))
            assert shown == under if apart == 0 else alike(shown, under, apart, share), (line, shown)
            count += 1
    return count


# Pages whose commands run on what their Python leaves: how many, and by how much numbers may differ. The encoder of
# this machine may write other bytes than that of the page.
COMMANDS = {"quick-start.md": (2, 0.0), "footage.md": (1, 1.0)}


RECIPES = DOCS / "contributing.md"
TOGETHER = (DOCS / "how-to" / "robot-log.md", DOCS / "how-to" / "detector.md", RECIPES)  # have tests of their own
ALONE = [p for p in PAGES if p not in TOGETHER and any(not needs for _, needs in blocks(p, "python"))]
LONG = ("footage.md",)  # its commands are tried in this folder, too


@pytest.mark.parametrize(
    "page", [pytest.param(p, id=name(p), marks=pytest.mark.slow if p.name in LONG else ()) for p in ALONE]
)
def test_the_python_of_a_page_runs_and_prints_what_stands_under_it(page, tmp_path, monkeypatch):
    if page.name != "README.md":  # whose programs need no picture
        Image.fromarray(painted_room(128, 256)).save(tmp_path / "room.png")
    parts = [(text, under) for kind, text, needs, under in fences(page) if kind == "python" and not needs]
    for text, _ in parts:
        if named := re.match(r"# (\w+\.py)\n", text):  # to be saved so: others import it
            (tmp_path / named[1]).write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    printed = run_here([text for text, _ in parts], tmp_path, monkeypatch)
    assert len(printed) == len(parts)
    for out, (_, under) in zip(printed, parts, strict=True):
        assert under is None or out == under
    if page.name in COMMANDS:
        count, apart = COMMANDS[page.name]
        assert check_commands(page, tmp_path, apart) == count


def test_the_rigs_of_a_page_are_read(tmp_path):
    for text, _ in blocks(DOCS / "how-to" / "camera.md", "yaml"):
        (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
        assert len(read_rig(tmp_path / "rig.yaml").lenses) == len(yaml.safe_load(text)["lenses"])


def test_a_robots_log_and_its_detections_fit_each_other(tmp_path, monkeypatch):
    """One page writes the log, the other looks at it, and the commands of both run on these files."""
    log, detector, _ = TOGETHER
    for page in (log, detector):
        parts = [(text, under) for kind, text, needs, under in fences(page)
                 if kind == "python" and (needs is None or "robot-log.md" in needs)]  # fmt: skip
        for out, (_, under) in zip(run_here([text for text, _ in parts], tmp_path, monkeypatch), parts, strict=True):
            assert under is None or out == under
    assert check_commands(log, tmp_path) == 1
    assert check_commands(detector, tmp_path) == 1


@pytest.mark.parametrize("kind", ["perception", "source", "task", "world", "sink"])
def test_a_recipe_runs_and_makes_its_name_known(kind, tmp_path, monkeypatch):
    """Each is one file of at most 60 lines, alone in its folder; its lines of TOML make an installed package of it."""
    section = RECIPES.read_text(encoding="utf-8").partition(f"## A {kind}\n")[2].partition("\n## ")[0]
    assert 0 < len(section.splitlines()) <= 60
    blocks = {found[1]: found[2] for found in FENCE.finditer(section)}
    assert run_here([blocks["python"]], tmp_path, monkeypatch) == [blocks.get("text", "")]
    if kind == "sink":  # is given to the loop
        return
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_package", raising=False)
    (tmp_path / "page.py").rename(tmp_path / "my_package.py")
    head, entry = blocks["toml"].splitlines()
    group, (made, value) = head.split('"')[1], entry.replace('"', "").split(" = ")
    (tmp_path / "mine-1.dist-info").mkdir()
    (tmp_path / "mine-1.dist-info" / "entry_points.txt").write_text(f"[{group}]\n{made} = {value}\n")
    assert callable(plugins.bring(plugins.known(group, {})[made], kind))


@pytest.mark.slow
def test_apartments_are_exported_as_the_page_on_habitat_says(tmp_path):
    assert check_commands(DOCS / "how-to" / "habitat.md", tmp_path) == 1


def test_a_bag_is_followed_as_the_page_on_bags_says(tmp_path):
    page = DOCS / "how-to" / "bags.md"
    run_python([text for text, _ in blocks(page, "python")][:1], tmp_path)
    assert check_commands(page, tmp_path, apart=0.3) == 1


@pytest.mark.slow
def test_a_film_is_followed_as_the_page_on_a_live_camera_says(tmp_path):
    pytest.importorskip("cv2")
    page = DOCS / "how-to" / "live.md"
    written, followed = (text for text, _ in blocks(page, "python"))
    run_python([written], tmp_path)
    assert check_commands(page, tmp_path) == 1
    (under,) = (under for kind, text, _, under in fences(page) if text == followed)
    assert run_python([followed], tmp_path) == [under]  # by itself: the perception's process imports it


def typed():
    """Every command of the pages' shell blocks, without its comment."""
    for page in PAGES:
        for text, _ in blocks(page, "sh", "bash"):
            for line in text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                if words:
                    yield pytest.param(words, id=f"{name(page)}: {' '.join(words)}")


@pytest.mark.parametrize("words", [*typed()])
def test_a_command_can_be_typed(words):
    """Options exist and take what is given; scripts and targets of make are there. Nothing is run."""
    program, *arguments = words
    if program == "eagor":
        assert _parse(arguments) is not None
    elif program == "python":
        assert (ROOT / arguments[0]).is_file()
    elif program == "make":
        assert re.search(rf"^{arguments[0]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    elif program == "python3":
        assert arguments == ["-m", "venv", ".venv", "&&", ".", ".venv/bin/activate"]
    else:
        assert program in ("pip", "vllm")


@pytest.mark.parametrize("script", ["mean", "degree", "parallax", "presence"])
def test_the_tables_of_the_method_are_what_the_figures_show(script, monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "figures"))
    printed = "\n".join(importlib.import_module(script).table()) + "\n"
    assert printed in [text for text, _ in blocks(DOCS / "method.md", "text")]


def test_the_charts_of_the_results_are_drawn_from_the_tables(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(DOCS / "figures"))
    monkeypatch.setattr(sys, "argv", ["results.py", str(tmp_path)])
    import results

    for first in results.RUNS.values():
        assert len(results.run(first)) == 10, "every method has a row"
    yaw = (DOCS / "results/photographs.md").read_text(encoding="utf-8").split("yaw           eagor ")[1].splitlines()[0]
    assert results.photographs()["yaw"]["eagor"] == [float(word) for word in re.sub(r"\[.*?\]", "", yaw).split()]
    for draw in (results.right, results.honest, results.searches, results.cost):
        draw()
    assert {path.name for path in tmp_path.iterdir()} <= {path.name for path in (DOCS / "images").iterdir()}


def test_the_demo_shows_the_study_of_the_docs():
    page = (DOCS / "results" / "navigation.md").read_text(encoding="utf-8").partition(STUDY_COMMAND)[2]
    rows = [row.split()[1:] for row in page.splitlines() if re.match("(frame|eagor|vmf|grid_filter) +[0-9]", row)][:4]
    written = [[float(word.strip("[],")) for word in row if word.strip("[],")][:9] for row in rows]
    assert written == [[number for cell in cells for number in cell] for cells in STUDY.values()]


def test_the_page_of_the_architecture_agrees_with_the_source(monkeypatch):
    """If this fails after a change: `python docs/figures/architecture.py` draws and prints what belongs there."""
    monkeypatch.syspath_prepend(str(DOCS / "figures"))
    architecture = importlib.import_module("architecture")
    page = DOCS / "architecture.md"
    texts = [text for text, _ in blocks(page, "text")]
    assert texts == ["\n".join(architecture.table()) + "\n"]
    floors, below = list(architecture.FLOORS), architecture.edges()
    assert not [(a, b) for a in floors for b in below[a] if floors.index(b) < floors.index(a)], "no import runs up"
    assert list(architecture.SAID) == floors
    public = [room for room in architecture.rooms() if not room.startswith("_")]
    listed = [module for modules in architecture.FLOORS.values() for module in modules]
    assert sorted(listed) == public
    doors = re.findall(r"^\| \d+ \| `([\w.]+)` \|", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(doors) == 10
    assert set(doors) <= architecture.passed()


LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)(?:#([^)\s]+))?\)")


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files_of_the_repository(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for path, _ in LINK.findall(text):
        assert not path or (page.parent / path).exists(), path


def test_every_public_name_is_on_the_page_of_the_public_face():
    table = (DOCS / "api" / "index.md").read_text(encoding="utf-8").partition("\n## ")[0]
    listed = set(re.findall(r"\[`(\w+)`\]\(\w+\.md#eagor\.", table))
    assert listed == {name for name in eagor.__all__ if not name.startswith("__")}


def test_every_room_has_its_place_in_the_reference():
    shown = {
        found.split(".")[1]
        for page in (DOCS / "api").glob("*.md")
        for found in re.findall(r"^::: (eagor\.[\w.]+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    }
    source = ROOT / "src" / "eagor"
    rooms = {path.stem for path in source.glob("*.py")} | {path.parent.name for path in source.glob("*/__init__.py")}
    assert shown == {room for room in rooms if not room.startswith("_")}


def test_every_page_has_its_place_in_the_navigation():
    shown = re.findall(r": ([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(shown) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
