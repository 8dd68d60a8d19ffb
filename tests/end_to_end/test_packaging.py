"""What is shipped: the wheel is complete and clean, runs without the repository, and finds plugins by name."""

import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from importlib.metadata import PathDistribution
from pathlib import Path

import numpy as np
import pytest
import yaml
from msgspec import toml
from PIL import Image

from eagor import __version__, perception
from eagor.drawing.video import Movie
from eagor.lab import worlds
from eagor.lab.tasks import task
from eagor.lab.worlds.painted import EYE, Room, bearing, painted_room
from eagor.sources import camera_sources as cameras
from eagor.sources.panorama import turn
from eagor.sphere import world_R_body

ROOT = Path(__file__).parents[2]
PROJECT = toml.decode((ROOT / "pyproject.toml").read_bytes())
PIP = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--disable-pip-version-check")


def done(*words, **more):
    """Run a command to its end; what it printed."""
    found = subprocess.run([*map(str, words)], capture_output=True, text=True, timeout=300, **more)
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Source archive, and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("dist")
    done(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
    (archive,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return archive, wheel


@pytest.fixture(scope="module")
def installed(dist, tmp_path_factory):
    """A folder into which the wheel and the example plugin are installed, each as a package of its own."""
    target, source = tmp_path_factory.mktemp("target"), tmp_path_factory.mktemp("source") / "plugin"
    shutil.copytree(ROOT / "examples" / "plugin", source, ignore=shutil.ignore_patterns("__pycache__"))
    done(*PIP, "--target", target, dist[1])
    done(*PIP, "--no-build-isolation", "--target", target, source)
    return target


@pytest.fixture
def eagor(installed, tmp_path):
    """Runs the installed command where there is no repository."""
    environment = os.environ | {"PYTHONPATH": str(installed), "OPENBLAS_NUM_THREADS": "1"}

    def run(*words):
        return done(sys.executable, "-m", "eagor", *words, cwd=tmp_path, env=environment)

    return run


def files_of(archive):
    """The files of an archive, by path, with their bytes."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as file:
            return {name: file.read(name) for name in file.namelist() if not name.endswith("/")}
    with tarfile.open(archive) as file:
        found = {}
        for member in file.getmembers():
            assert member.isfile() or member.isdir(), f"{member.name} is a link"
            content = file.extractfile(member)
            if content is not None:
                found[member.name.partition("/")[2]] = content.read()
        return found


def test_the_wheel_holds_the_package_and_nothing_else(dist):
    files = files_of(dist[1])
    info = f"eagor-{__version__}.dist-info"
    package = {path.relative_to(ROOT / "src").as_posix() for path in (ROOT / "src" / "eagor").rglob("*")
               if path.is_file() and "__pycache__" not in path.parts}  # fmt: skip
    assert {name for name in files if not name.startswith(info)} == package
    for name in ("eagor/py.typed", "eagor/perception/scout/scout.onnx", "eagor/perception/scout/vocabulary.json"):
        assert files[name] == (ROOT / "src" / name).read_bytes()
    assert files[f"{info}/licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()
    assert {name.removeprefix(f"{info}/") for name in files if name.startswith(info)} == {
        "METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE",
    }  # fmt: skip


def test_the_source_archive_is_complete(dist):
    files = files_of(dist[0])
    for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "Makefile", "examples/README.md",
                 "examples/plugin/pyproject.toml", "examples/plugin/eagor_example.py", "docs/conventions.md",
                 "tests/end_to_end/test_packaging.py", "training/scout/train.py", "benchmarks/core.py",
                 "src/eagor/perception/scout/scout.onnx"):  # fmt: skip
        assert name in files, name
    tops = {name.partition("/")[0] for name in files}
    assert tops <= {"src", "tests", "training", "benchmarks", "docs", "examples", "ros2", "studio", "pyproject.toml",
                    "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "Makefile", "PKG-INFO", ".gitignore",
                    "mkdocs.yml"}  # fmt: skip
    assert not [name for name in files if "__pycache__" in name or name.endswith((".pyc", ".so", ".pickle"))]


def test_the_citation_fits_the_package():
    told, project = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8")), PROJECT["project"]
    assert (told["version"], told["license"]) == (__version__, project["license"])
    assert [author["name"] for author in told["authors"]] == [author["name"] for author in project["authors"]]
    (paper,) = told["references"]
    assert f"*{paper['title']}*" in " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())


def test_nothing_of_this_machine_is_shipped(dist):
    here = {str(ROOT), sys.prefix, str(Path(tempfile.gettempdir(), "pytest-"))}
    for archive in dist:
        for name, content in files_of(archive).items():
            for place in here:
                assert place.encode() not in content, f"{place} in {name} of {archive.name}"


def test_the_entry_points_are_those_that_work_without_metadata(dist):
    text = files_of(dist[1])[f"eagor-{__version__}.dist-info/entry_points.txt"].decode()
    for module in (perception, worlds, task, cameras):
        points = text.partition(f"[{module.GROUP}]\n")[2].partition("\n\n")[0].splitlines()
        assert sorted(points) == sorted(f"{name} = {value}" for name, value in module.BUILT_IN.items())


def test_the_package_runs_without_the_repository(eagor, installed, tmp_path):
    where = done(sys.executable, "-c", "import eagor; print(eagor.__file__)", cwd=tmp_path,
                 env=os.environ | {"PYTHONPATH": str(installed)})  # fmt: skip
    assert where.strip() == str(installed / "eagor" / "__init__.py")
    Image.fromarray(painted_room(64, 128)).save(tmp_path / "room.png")
    found = json.loads(eagor("locate", "room.png", "red", "--json"))
    azimuth, elevation = (np.degrees(a) for a in _angles(bearing(Room().balls[0], EYE, np.eye(3))[0]))
    assert abs(found["azimuth_deg"] - azimuth) < 3
    assert abs(found["elevation_deg"] - elevation) < 3
    assert "status" in json.loads(eagor("locate", "room.png", "chair", "--perception", "scout", "--json"))


@pytest.mark.slow
def test_a_plugin_is_found_by_name(eagor, installed, tmp_path):
    dist_info = next(installed.glob("eagor_example-*.dist-info"))
    assert {point.group for point in PathDistribution(dist_info).entry_points} == {
        "eagor.perceptions", "eagor.worlds", "eagor.tasks",
    }  # fmt: skip
    picture = np.full((64, 128, 3), 120, np.uint8)
    picture[20:24, 30:34] = 255  # azimuth 180 - 360 * 32 / 128, elevation 90 - 180 * 22 / 64
    Image.fromarray(picture).save(tmp_path / "lamp.png")
    found = json.loads(eagor("locate", "lamp.png", "brightest", "--perception", "brightness", "--json"))
    assert abs(found["azimuth_deg"] - 90) < 2
    assert abs(found["elevation_deg"] - 28.1) < 2
    run = ("turntable", "--world", "hall", "--perception", "truth:ideal", "--episodes", "1", "--set", "steps=8")
    assert json.loads(eagor("bench", "run", *run, "--out", "run", "--json"))["failed"] == 0


@pytest.mark.slow
@pytest.mark.registry
def test_the_first_commands_of_the_readme_end_with_an_answer(dist, tmp_path):
    """As printed and in order, in an empty environment: what pip and npm fetch comes from their registries."""
    with tarfile.open(dist[0]) as archive:
        archive.extractall(tmp_path, filter="data")
    (clone,) = tmp_path.iterdir()
    film = Movie(clone / "clip.mp4", (512, 256), rate=4)
    for stamp in np.arange(0, 2, 0.25):
        film.add(turn(painted_room(256, 512), world_R_body(0.4 * stamp).T), stamp)
    film.close()
    text = (ROOT / "README.md").read_text(encoding="utf-8").split("```sh\n")[2].partition("```")[0]
    assert "\neagor track clip.mp4" in text
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    clean |= {"EAGOR_CACHE": str(tmp_path / "cache")}
    ran = subprocess.run(["bash", "-euc", text], cwd=clone, env=clean, capture_output=True, text=True, timeout=3600)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "coco is installed" in ran.stdout
    assert "cone 90%" in ran.stdout
    assert (clone / "out.mp4").stat().st_size > 0
    assert (clone / "out.html").stat().st_size > 0


def _angles(direction):
    x, y, z = direction
    return np.arctan2(y, x), np.arcsin(z)
