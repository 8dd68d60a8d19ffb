"""Draw the floors of the package and which floor imports which, from the imports in the source.

python docs/figures/architecture.py [FOLDER]
"""

from __future__ import annotations

import ast
import io
import sys
import tempfile
import threading
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from common import INK, OURS, QUIET, figure, keep
from PIL import Image

from eagor.cli import main as run
from eagor.lab.worlds.painted import painted_room

if TYPE_CHECKING:
    from types import FrameType

PACKAGE = Path(__file__).parents[2] / "src" / "eagor"
# From the top down. Modules that begin with an underscore are helpers; they belong to the lowest floor.
FLOORS = {
    "cli": ("cli",),
    "studio": ("studio",),
    "robots": ("robots",),
    "lab": ("lab",),
    "live": ("live",),
    "drawing": ("drawing",),
    "perception": ("perception",),
    "sources": ("sources",),
    "odometry": ("odometry",),
    "measures": ("metrics", "statistics"),
    "tracking": ("tracking",),
    "baselines": ("baselines",),
    "belief": ("belief",),
    "evidence": ("evidence",),
    "harmonics": ("harmonics", "conventions", "thumbnail"),
    "sphere": ("cameras", "grids", "sphere"),
    "helpers": ("plugins", "queries", "errors"),
}
SAID = {
    "cli": "commands and their options",
    "studio": "the web page's server",
    "robots": "ROS 2, Go2, the safety gate",
    "lab": "worlds, tasks, runs, reports",
    "live": "answers at a steady rate",
    "drawing": "pictures and charts",
    "perception": "panorama in, evidence out",
    "sources": "videos, lenses, bags",
    "odometry": "poses of files, of an IMU, of pictures",
    "measures": "errors, intervals, paired tests",
    "tracking": "poses and looks by time, answers",
    "baselines": "the methods to compare with",
    "belief": "what all looks say together",
    "evidence": "what one look says",
    "harmonics": "fields on the sphere, conventions",
    "sphere": "directions, rotations, grids",
    "helpers": "arrays, files, errors, plugins",
}


def floor_of(module: str) -> str:
    """The floor of a module right under `eagor`."""
    if module.startswith("_"):
        return "helpers"
    return next(floor for floor, modules in FLOORS.items() if module in modules)


def rooms() -> list[str]:
    """The modules and packages right under `eagor`."""
    found = [path.stem for path in PACKAGE.glob("*.py")] + [path.parent.name for path in PACKAGE.glob("*/__init__.py")]
    return sorted({*found} - {"__init__", "__main__"})


def imported(path: Path) -> set[str]:
    """The modules right under `eagor` that a file imports, inside functions and for types alone too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.split(".")[1] for name in found if name.startswith("eagor.")}


def edges() -> dict[str, set[str]]:
    """Each floor, from the top down, with the other floors that it imports."""
    found: dict[str, set[str]] = {floor: set() for floor in FLOORS}
    for room in rooms():
        files = (PACKAGE / room).rglob("*.py") if (PACKAGE / room).is_dir() else [PACKAGE / f"{room}.py"]
        for path in files:
            found[floor_of(room)] |= {floor_of(name) for name in imported(path)}
    return {floor: below - {floor} for floor, below in found.items()}


def table() -> list[str]:
    """What the figure shows, as text."""
    below = edges()
    rows = [(floor, ", ".join(other for other in FLOORS if other in below[floor]) or "nothing") for floor in FLOORS]
    return [f"{floor:<12}imports {others}" for floor, others in rows]


def passed() -> set[str]:
    """The modules whose code runs while ``eagor track`` takes pictures to a page, without ``eagor.``."""
    seen = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_globals.get("__name__", "")
        if event == "call" and name.startswith("eagor."):
            seen.add(name.removeprefix("eagor."))

    with tempfile.TemporaryDirectory() as folder:
        for number in range(2):
            Image.fromarray(painted_room(128, 256)).save(f"{folder}/{number}.png")
        page = f"{folder}/chair.html"
        words = ["track", folder, "red chair", "--perception", "colour", "--poses", "level", "--page", page, "--json"]
        before = sys.getprofile()
        threading.setprofile(note)  # pictures are read ahead in a thread
        sys.setprofile(note)
        try:
            with redirect_stdout(io.StringIO()):
                run(words)
        finally:
            sys.setprofile(before)
            threading.setprofile(None)
    return seen


def main() -> None:
    """Draw the floors, and print them."""
    sheet = figure(1100, 560)
    axes = sheet.add_axes((0.01, 0.02, 0.98, 0.96))
    below, count, left = edges(), len(FLOORS), 9.6
    axes.set_xlim(0, left + count + 1)
    axes.set_ylim(count + 0.1, -2.8)
    axes.axis("off")
    for row, (floor, said) in enumerate(SAID.items()):
        axes.barh(row + 0.5, left - 0.3, left=0.1, height=0.86, color="#eef3f8" if row % 2 else "#e3ebf3")
        axes.text(0.4, row + 0.5, floor, color=INK, fontsize=11.5, weight="bold", va="center")
        axes.text(3.3, row + 0.5, said, color=QUIET, fontsize=11, va="center")
        axes.text(left + row + 0.4, -0.2, floor, color=INK, fontsize=10.5, rotation=50, va="bottom", ha="left")
        axes.barh(row + 0.5, row + 1, left=left, height=1, color="#f1f1f1")  # itself and above: no imports
        for column, other in enumerate(FLOORS):
            if other in below[floor]:
                axes.plot(left + column + 0.5, row + 0.5, "o", color=OURS, ms=10)
    axes.text(0.1, -1.8, "The floors of eagor", color=INK, fontsize=14, weight="bold")
    axes.text(0.1, -1.1, "Dot: the floor on the left imports the floor at the top.", color=QUIET, fontsize=10.5)
    axes.text(0.1, -0.5, "Grey: the floor itself and the floors above it.", color=QUIET, fontsize=10.5)
    keep(sheet, "architecture.png")
    print("\n".join(table()))


if __name__ == "__main__":
    main()
