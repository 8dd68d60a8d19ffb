"""``pip install .`` is lean: what it brings is enough for the core, `locate` and `track`; the rest names its extra.

No environment is made for this: processes run with all packages hidden that the base does not bring.
"""

import json
import os
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import toml
from PIL import Image

import eagor
from eagor import _extras
from eagor._extras import extras, how_to_install, require_extra
from eagor.errors import EagorError, MissingExtraError
from eagor.lab.worlds.painted import painted_room

SOURCE = Path(eagor.__file__).parents[1]
PROJECT = toml.decode(Path(__file__).parents[2].joinpath("pyproject.toml").read_bytes())["project"]
EXTRAS = {extra: least for extra, least in extras().items() if extra not in ("dev", "docs", "oracles")}
HIDE = """
from importlib.machinery import PathFinder
from importlib.metadata import Distribution, PackageNotFoundError

hidden = set({hidden!r})
find_spec, from_name = PathFinder.find_spec, Distribution.from_name

def find(name, path=None, target=None):
    return None if name in hidden else find_spec(name, path, target)

def distribution(name):
    if name in hidden:
        raise PackageNotFoundError(name)
    return from_name(name)

PathFinder.find_spec, Distribution.from_name = find, distribution
"""


def name_of(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")


def brought(names: set[str]) -> set[str]:
    """The distributions with these names, and all that they need."""
    found: set[str] = set()
    while names:
        found |= names
        needed: set[str] = set()
        for name in names:
            try:
                needed |= {name_of(line) for line in requires(name) or () if "extra ==" not in line}
            except PackageNotFoundError:
                continue  # not for this machine
        names = needed - found
    return found


@pytest.fixture(scope="module")
def lean(tmp_path_factory):
    """An environment for processes with the packages of the base alone."""
    base = brought({name_of(line) for line in PROJECT["dependencies"]}) | {"eagor"}
    modules = packages_distributions().items()
    hidden = {name for name, dists in modules if not base & {name_of(each) for each in dists} and name[0] != "_"}
    folder = tmp_path_factory.mktemp("lean")
    brings = {name for packages in EXTRAS.values() for name in packages}
    folder.joinpath("sitecustomize.py").write_text(HIDE.format(hidden=sorted(hidden | brings | {"embreex"})))
    return os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{SOURCE}", "NO_COLOR": "1"}


BASE = {
    "doctor": "doctor --json",
    "locate": "locate room.png red --picture found.png --json",
    "track": "track frames red --poses poses.csv --compare",
    "help": "--help",
    "list": "bench list",
}
OTHERS = [
    ("sim", "demo --out demo"),
    ("sim", "locate room.png chair --perception scout"),
    ("sim", "track frames chair --poses poses.csv --perception scout"),
    ("sim", "bench run navigation --perception truth --episodes 1 --out run"),
    ("sim", "bench run waypoint --world scene.glb --episodes 1 --out run"),
    ("report", "bench report run-of-another"),
    ("sim", "calibrate --episodes 20 --out calibration.json"),
    ("vlm", "locate room.png chair --perception some/model"),
    ("vlm", "calibrate heads --perception some/model --out heads.json"),
    ("endpoint", "locate room.png chair --perception endpoint:qwen"),
    ("photos", "locate room.png chair --perception onnx:d.onnx"),
]
CALLS = [
    "import eagor.lab.tasks; eagor.lab.tasks.register()",
    "import eagor.lab.envs.place_env",
    "from eagor.lab.tasks.sim.navigation import NAVIGATION",
    "from eagor.lab.tasks import task; task.load('waypoint')",
    "from eagor.perception.scout import ScoutPerception; ScoutPerception()",
    "from eagor.lab import worlds; worlds.load('scene.glb')(0)",
    "import numpy as np; from eagor.lab.worlds.scene import Raycaster; Raycaster(np.eye(3), [[0, 1, 2]])",
]
# One after the other in one process, as each costs a second to start: what they said, and how they ended.
ALL = """
import contextlib, io, json, shlex, sys
from eagor.cli import main

def said(do):
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = do()
        except Exception as error:
            code = f"{type(error).__module__}.{type(error).__qualname__}: {error}"
    return code, out.getvalue(), err.getvalue()

commands, calls = json.load(sys.stdin)
found = {text: said(lambda: main(shlex.split(text))) for text in commands}
found |= {text: said(lambda: exec(text, {})) for text in calls}
json.dump(found, sys.stdout)
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with room.png, and frames with poses.csv."""
    place = tmp_path_factory.mktemp("place")
    room = painted_room(64, 128)
    place.joinpath("frames").mkdir()
    for number in range(2):
        Image.fromarray(np.roll(room, 8 * number, axis=1)).save(place / "frames" / f"{number}.png")
    Image.fromarray(room).save(place / "room.png")
    place.joinpath("poses.csv").write_text("stamp,yaw_deg,pitch_deg,roll_deg\n0,0,0,0\n1,22.5,0,0\n")
    place.joinpath("scene.glb").write_bytes(b"glTF" + bytes(40))
    return place


@pytest.fixture(scope="module")
def run(lean, place):
    """Run Python with these arguments; (exit code, stdout, stderr)."""

    def run(*arguments, **more):
        done = subprocess.run(
            [sys.executable, *arguments], cwd=place, env=lean, capture_output=True, text=True, timeout=300, **more
        )
        return done.returncode, done.stdout, done.stderr

    return run


@pytest.fixture(scope="module")
def answers(run):
    """What each of the commands and calls came to: exit code or error, stdout, stderr."""
    asked = [*BASE.values(), *(command for _, command in OTHERS)], CALLS
    code, out, err = run("-c", ALL, input=json.dumps(asked))
    assert code == 0, err
    return json.loads(out)


def test_the_base_is_what_was_promised():
    promised = {"numpy", "scipy", "array-api-compat", "pillow", "matplotlib", "tyro", "rich", "msgspec", "tomli"}
    assert {name_of(line) for line in PROJECT["dependencies"]} == promised


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_extras_are_those_of_the_project(extra):
    lines = PROJECT["optional-dependencies"][extra]
    everywhere = [line for line in lines if ";" not in line]  # embreex and pycolmap have no wheels for Linux on ARM
    assert dict(re.match(r"([\w-]+)>=([\d.]+)", line).groups() for line in everywhere) == EXTRAS[extra]


def test_base_commands_work(answers):
    for command in BASE.values():
        assert answers[command][0] == 0, answers[command]
    found = json.loads(answers[BASE["doctor"]][1])
    assert found["healthy"]
    assert {found["packages"][name] for packages in EXTRAS.values() for name in packages} == {None}
    assert found["perceptions"]["scout"] == f"gymnasium, jinja2, onnxruntime, trimesh: {how_to_install('sim')}"
    assert found["extras"]["sim"] == [found["perceptions"]["scout"]]
    assert found["tasks"]["navigation"] == f"a simulated task needs gymnasium: {how_to_install('sim')}"
    assert abs(json.loads(answers[BASE["locate"]][1])["azimuth_deg"] + 23.4) < 3
    assert len(answers[BASE["track"]][1].splitlines()) >= 2


@pytest.mark.parametrize(("extra", "command"), OTHERS)
def test_other_commands_name_their_extra(answers, extra, command):
    code, out, err = answers[command]
    assert (code, out) == (2, "")
    assert how_to_install(extra) in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("call", CALLS)
def test_calls_name_their_extra(answers, call):
    said = f"eagor.errors.MissingExtraError: .* needs .*: {re.escape(how_to_install('sim'))}.*"
    assert re.fullmatch(said, answers[call][0])


def test_the_line_names_what_is_absent_and_how_to_install_it():
    require_extra("this", "sim")
    require_extra("this", "sim", "numpy")
    with pytest.raises(MissingExtraError, match=r"^this needs nowhere_to_be_found: ") as caught:
        require_extra("this", "sim", "numpy", "nowhere_to_be_found")
    assert str(caught.value).endswith(how_to_install("sim"))
    assert isinstance(caught.value, EagorError)
    assert isinstance(caught.value, ImportError)


@pytest.mark.parametrize(
    ("noted", "command"),
    [
        ('{{"url": "file://{folder}", "dir_info": {{}}}}', "pip install '{folder}[sim]'"),
        ('{{"url": "file://{folder}", "dir_info": {{"editable": true}}}}', "pip install -e '{folder}[sim]'"),
        ('{{"url": "file://{folder}/eagor.whl", "archive_info": {{}}}}', "pip install '{folder}/eagor.whl[sim]'"),
        ('{{"url": "file://{folder}/gone", "dir_info": {{}}}}', None),
        ("no JSON", None),
        (None, None),  # from a registry
    ],
)
def test_how_to_install_names_the_clone_or_the_wheel_if_it_is_known_and_there(tmp_path, monkeypatch, noted, command):
    folder = tmp_path / "my clone"
    folder.mkdir()
    (folder / "eagor.whl").touch()
    url = str(folder).replace(" ", "%20")
    text = None if noted is None else noted.format(folder=url)
    monkeypatch.setattr(_extras, "distribution", lambda _: SimpleNamespace(read_text=lambda _: text))
    if command is None:
        assert how_to_install("sim").startswith("pip install 'FILE[sim]', FILE being the wheel or the clone of eagor")
    else:
        assert how_to_install("sim") == command.format(folder=folder)


def test_no_text_names_a_package_of_a_registry():
    root = Path(__file__).parents[2]
    files = [root / "README.md", *root.glob("docs/**/*.md"), *root.glob("src/**/*.py"), *root.glob("examples/*.*")]
    assert not [file.name for file in files if re.search(r"pip install\s+'?eagor\b", file.read_text(encoding="utf-8"))]
