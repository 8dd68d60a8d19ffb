"""What the documentation says holds: its code runs, its commands can be typed, its tables are what scripts print."""

import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

import eagor
from eagor.cli import _parse
from eagor.worlds.painted import painted_room

ROOT = Path(__file__).parents[2]
SOURCE = Path(eagor.__file__).parent
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


@pytest.mark.parametrize("page", [p for p in PAGES if any(not needs for _, needs in blocks(p, "python"))], ids=name)
def test_the_python_of_a_page_runs_from_top_to_bottom(page, tmp_path):
    Image.fromarray(painted_room(128, 256)).save(tmp_path / "room.png")
    script = tmp_path / "page.py"
    script.write_text("\n".join(text for text, needs in blocks(page, "python") if not needs), encoding="utf-8")
    environment = os.environ | {"PYTHONWARNINGS": "error", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, script.name], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr


def test_the_first_lines_of_the_readme_print_what_it_says(tmp_path):
    (code, _), *_ = blocks(ROOT / "README.md", "python")
    (printed, _), *_ = blocks(ROOT / "README.md", "text")
    environment = os.environ | {"PYTHONWARNINGS": "error", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert (done.stderr, done.stdout) == ("", printed)


def commands():
    """Every command of the pages' shell blocks, without its comment."""
    for page in PAGES:
        for text, _ in blocks(page, "sh", "bash"):
            for line in text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                if words:
                    yield pytest.param(words, id=f"{name(page)}: {' '.join(words)}")


@pytest.mark.parametrize("words", [*commands()])
def test_a_command_can_be_typed(words):
    """Options exist and take what is given; scripts and targets of make are there. Nothing is run."""
    program, *arguments = words
    if program == "eagor":
        assert _parse(arguments) is not None
    elif program == "python":
        assert (ROOT / arguments[0]).is_file()
    elif program == "make":
        assert re.search(rf"^{arguments[0]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    else:
        assert program in ("pip", "vllm")


@pytest.mark.parametrize("script", ["mean", "degree", "parallax"])
def test_the_tables_of_the_method_are_what_the_figures_show(script, monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "figures"))
    printed = "\n".join(importlib.import_module(script).table()) + "\n"
    assert printed in [text for text, _ in blocks(DOCS / "method.md", "text")]


def modules_of(room):
    """A module or package right under `eagor`, and the modules in it."""
    return [room, *(path.stem for path in (SOURCE / room).glob("*.py") if path.stem != "__init__")]


def test_the_page_of_the_architecture_agrees_with_the_source(monkeypatch):
    """If this fails after a change: `python docs/figures/architecture.py` draws and prints what belongs there."""
    monkeypatch.syspath_prepend(str(DOCS / "figures"))
    architecture = importlib.import_module("architecture")
    page = DOCS / "architecture.md"
    texts = [text for text, _ in blocks(page, "text")]
    assert texts == ["\n".join(lines) + "\n" for lines in (architecture.table(), architecture.walk())]
    floors, below = list(architecture.FLOORS), architecture.edges()
    assert not [(a, b) for a in floors for b in below[a] if floors.index(b) < floors.index(a)], "no import runs up"
    assert list(architecture.SAID) == floors
    public = [room for room in architecture.rooms() if not room.startswith("_")]
    listed = [module for modules in architecture.FLOORS.values() for module in modules]
    assert sorted(listed) == public
    written = page.read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([a-z]+) \| (`.*`)[^|]* \|$", written, re.MULTILINE)
    core = floors[floors.index("measures") :]
    assert [(floor, sorted(re.findall(r"`(\w+)`", named))) for floor, named in rows] == [
        (floor, sorted(found for room in architecture.FLOORS[floor] for found in modules_of(room))) for floor in core
    ]
    doors = re.findall(r"^\| \d+ \| `([\w.]+)` \|", written, re.MULTILINE)
    assert len(doors) == 12
    assert set(doors) <= set(architecture.passed())


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
