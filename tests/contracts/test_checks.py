"""The checks that ship find what they say they find: for each rule, something good but for that one fault."""

import itertools
import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from box_scenes import scene_of, shell, thing
from rooms import two_rooms

from eagor.errors import EagorError, GridError, ImageError, PoseError, WorldError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid, PatchGrid
from eagor.lab import worlds
from eagor.lab.tasks import task as tasks
from eagor.lab.tasks.published import PublishedTask, score_metric
from eagor.lab.tasks.sim import rollout
from eagor.lab.tasks.sim.rollout import check_simulation
from eagor.lab.tasks.task import Sample, load
from eagor.lab.worlds.checking import check_world
from eagor.lab.worlds.painted import EYE, Room, paint, painted_room
from eagor.lab.worlds.render import Frame, Photograph, Renderer
from eagor.perception import check_perception
from eagor.sphere import world_R_body

sys.path.append(str(Path(__file__).parents[2] / "examples" / "plugin"))
import eagor_example as example

HERE = (2.0, 2.9, 1.25)


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The example plugin's world and task, as if it were installed."""
    monkeypatch.setitem(worlds.BUILT_IN, "hall", "eagor_example:hall")
    monkeypatch.setitem(tasks.BUILT_IN, "turntable", "eagor_example:TURNTABLE")


# --- what is ours passes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [pytest.param(3, marks=pytest.mark.slow), 600])
def test_apartments_keep_the_contract_of_worlds(seed):
    check_world(worlds.load("apartment"), seed)


def test_so_do_a_glb_file_a_photograph_and_a_painted_room(tmp_path):
    from eagor.lab.worlds.glb import export_glb

    check_world(worlds.load(str(export_glb(two_rooms(), tmp_path / "flat.glb"))))
    check_world(Photograph(painted_room(128, 256)))
    check_world(Looking(lambda position, pose, rows: Frame(paint(Room(), position, pose, rows, 2 * rows), None, None)),
                position=EYE)  # fmt: skip


@pytest.mark.parametrize("seed", [0, 1])
def test_so_does_the_examples_world(seed):
    check_world(worlds.load("hall"), seed)


@pytest.mark.parametrize(
    ("name", "settings"),
    [("waypoint", {"leg_steps": 5}), ("navigation", {"max_steps": 80}), ("tracking", {"steps": 8})],
)
@pytest.mark.parametrize("index", [0, *(pytest.param(index, marks=pytest.mark.slow) for index in (1, 2))])
def test_our_tasks_keep_the_contract_of_tasks(name, settings, index):
    found = check_simulation(load(name), seed=3, index=index, settings=settings)
    assert found["success" if name == "navigation" else load(name).headline] == (1.0 if name == "navigation" else 0.0)


def test_so_does_the_examples_task_in_its_own_world_and_in_ours():
    assert check_simulation(example.TURNTABLE, world="hall")["error"] == 0.0
    assert check_simulation(example.TURNTABLE, seed=3, settings={"steps": 8})["last"] == 0.0


@pytest.mark.parametrize("query", ["brightest", "darkest"])
def test_so_does_the_examples_perception(query):
    check_perception(example.Brightness(), painted_room(64, 128), query, roll=16)


def test_a_photograph_says_where_it_can_be_looked_at_from():
    view = Photograph(painted_room(32, 64))
    with pytest.raises(PoseError, match="where it was taken"):
        view.panorama((1.0, 0.0, 0.0), np.eye(3), 16)
    with pytest.raises(GridError, match="at least one row"):
        view.panorama((0.0, 0.0, 0.0), np.eye(3), 0)
    assert view.panorama((0.0, 0.0, 0.0), np.eye(3), 16, rgb=False).rgb is None
    with pytest.raises(ImageError, match="the photograph is float64"):
        Photograph(np.zeros((32, 64, 3))).panorama((0.0, 0.0, 0.0), np.eye(3), 16)


# --- worlds with one fault -------------------------------------------------------------------------------------------


class Looking:
    """A view made of a function of position, pose and rows."""

    def __init__(self, look):
        self.look = look

    def panorama(self, position, world_R_body, height, *, rgb=True, range=True, ids=True):
        return self.look(position, world_R_body, height)


FLAT = Renderer(two_rooms())


def flat(position, pose, rows):
    return FLAT.panorama(position, pose, rows, rgb=False)


def changed(**parts):
    """The flat, with parts of each frame made anew from the frame."""
    return Looking(lambda *where: replace(flat(*where), **{k: make(flat(*where)) for k, make in parts.items()}))


def depth(frame):
    """Ranges as a z-buffer of six faces has them."""
    return (frame.range * np.abs(ErpGrid(*frame.range.shape).directions).max(axis=-1)).astype(np.float32)


def noisy():
    luck = np.random.default_rng(0)
    return changed(ids=lambda f: luck.permutation(f.ids.ravel()).reshape(f.ids.shape))


def nose_up(pose):
    """The pose with pitch and roll of the other sign."""
    yaw, pitch = math.atan2(pose[1, 0], pose[0, 0]), math.asin(-pose[2, 0])
    return world_R_body(yaw, -pitch, math.atan2(pose[2, 1], pose[2, 2]))


def furnished(*more, **changes):
    things = [*shell(5.0, 4.0), thing("table", (1, 1, 0), (2, 1.6, 0.7), None, "brown"), *more]
    return replace(scene_of(things), **changes) if changes else scene_of(things)


def relabelled(**changes):
    scene = furnished()
    return replace(scene, instances=(*scene.instances[:-1], replace(scene.instances[-1], **changes)))


def moved(change):
    """The flat scene, with changed vertices and bounds that still fit."""
    scene = furnished()
    vertices = change(scene.vertices).astype(np.float32)
    things = []
    for index, one in enumerate(scene.instances):
        mine = vertices[scene.triangles[scene.instance == index]].reshape(-1, 3).astype(float)
        things.append(replace(one, low=mine.min(axis=0), high=mine.max(axis=0)))
    return replace(scene, vertices=vertices, instances=tuple(things))


_count = itertools.count()
BROKEN_WORLDS = {
    "no scene": (lambda seed: "a room", "made a str of seed 0; wanted a Scene"),
    "draws anew": (
        lambda seed: moved(lambda v: v * [1 + next(_count) / 100, 1, 1]),
        "wanted the same each time: draw everything from",
    ),
    "a colour of its own": (lambda seed: relabelled(colour="mauve"), "and None or one of black"),
    "nothing to ask for": (
        lambda seed: furnished(thing("table", (3, 1, 0), (4, 1.6, 0.7), None, "brown")),
        "none with a unique category and colour",
    ),
    "bounds in centimetres": (lambda seed: relabelled(high=np.array([200, 160, 70.0])), "metres, world frame"),
    "y up": (lambda seed: moved(lambda v: v[:, [0, 2, 1]] * [1, 1, -1] + [0, 0, 9]), "not Y up"),
    "colour in [0, 1]": (
        changed(rgb=lambda f: np.zeros((*f.ids.shape, 3), np.float32)),
        r"rgb of .* dtype\('float32'\), .*; wanted .*uint8",
    ),
    "no range is 0": (changed(range=lambda f: np.where(f.range > 2, 0, f.range)), "metres above 0, inf for no hit"),
    "ids below -1": (changed(ids=lambda f: f.ids - 5), "indices of instances, -1 for none"),
    "noise": (noisy(), "differently in a second look"),
    "mirrored": (
        changed(ids=lambda f: f.ids[:, ::-1], range=lambda f: f.range[:, ::-1]),
        "it turns the wrong way: is the picture mirrored",
    ),
    "transposed": (Looking(lambda p, pose, rows: flat(p, pose.T, rows)), "it turns the wrong way"),
    "never tilts": (
        Looking(lambda p, pose, rows: flat(p, world_R_body(math.atan2(pose[1, 0], pose[0, 0])), rows)),
        "the camera does not turn or tilt",
    ),
    "nose up": (Looking(lambda p, pose, rows: flat(p, nose_up(pose), rows)), "nose up is taken for nose down"),
    "depth, not range": (changed(range=depth), "not depth along an axis"),
    "position in centimetres": (
        Looking(lambda p, pose, rows: flat(np.asarray(HERE) + (np.asarray(p) - HERE) / 100, pose, rows)),
        "position is in metres",
    ),
}


@pytest.mark.parametrize(("world", "says"), BROKEN_WORLDS.values(), ids=BROKEN_WORLDS)
def test_the_check_of_worlds_finds(world, says):
    with pytest.raises(AssertionError, match=says) as raised:
        check_world(world, position=HERE)
    assert "anted" in str(raised.value), "it says what was wanted"


def test_a_world_that_cannot_be_looked_up_says_what_there_is():
    with pytest.raises(WorldError, match=r"no world 'barn'; known are apartment, habitat, hall, and GLB files"):
        worlds.load("barn")


# --- tasks with one fault --------------------------------------------------------------------------------------------

TURNTABLE = example.TURNTABLE


def env(**overrides):
    """The example's environment with some methods of its own."""
    return replace(TURNTABLE, environment=type("Env", (example.TurntableEnv,), overrides))


def planned(**changes):
    """Episodes that differ from the good ones; functions are called with the episode."""

    def plan(self, spec):
        good = example.TurntableEnv.plan(self, spec)
        return replace(good, **{k: make(good) if callable(make) else make for k, make in changes.items()})

    return env(plan=plan)


def sideways(self, ids):
    """The truth in the world's axes."""
    found = example.TurntableEnv._info(self, ids)
    found["truth"]["direction"] = found["truth"]["world_R_body"] @ found["truth"]["direction"]
    return found


def wandering():
    turn = itertools.count()

    def act(self, action):
        self.body.xy = self.body.xy + 0.01 * next(turn)
        return example.TurntableEnv._act(self, action)

    return env(_act=act)


def obeying(self, action):
    if float(action[0]) > 0:
        self.body.xy = self.body.xy + 0.1
    return example.TurntableEnv._act(self, action)


def endless(self, action):
    return example.TurntableEnv._act(self, action)[0], False, False


def blank(self):
    """Nothing is rendered: only the number of steps matters."""
    return lambda rows, **how: Frame(None, None, np.full((64, 128), -1, np.int32))


def forgetful():
    """Plans that depend on how many were made before."""
    made = itertools.count()
    return planned(yaw=lambda episode: episode.yaw + 0.001 * next(made))


BROKEN_TASKS = {
    "another episode each time": (forgetful(), "draw everything from spec.rng"),
    "a way that is drawn anew": (wandering(), "another path when the same episode is played again"),
    "a way that answers bend": (env(_act=obeying), "another path when other answers are given"),
    "the direction in the world": (env(_info=sideways), "from the nearest pixel that shows it"),
    "no end": (env(_act=endless, view=blank), "has not ended after"),
    "better the other way round": (
        replace(TURNTABLE, metrics=(replace(TURNTABLE.metrics[0], better="high"), TURNTABLE.metrics[1])),
        "though high is better",
    ),
}


@pytest.mark.parametrize(("task", "says"), BROKEN_TASKS.values(), ids=BROKEN_TASKS)
def test_the_check_of_tasks_finds(task, says, monkeypatch):
    monkeypatch.setattr(rollout, "STEPS", 50)
    with pytest.raises(AssertionError, match=says):
        check_simulation(task, world="hall")


def test_a_task_that_cannot_be_looked_up_says_what_there_is():
    names = "waypoint, navigation, tracking, hstar-hos, hstar-hps, osr, eagle360, turntable"
    with pytest.raises(EagorError, match=f"no task 'chess'; known are {names}"):
        load("chess")


# --- perceptions with one fault --------------------------------------------------------------------------------------

GRID = ErpGrid(32, 64)


def evidence(stamp, **changes):
    return replace(Evidence.from_response(np.zeros(GRID.shape), GRID, stamp=stamp), **changes)


def painting(panorama, query, *, stamp=None):
    panorama[:] = 0
    return evidence(stamp)


_turns = itertools.count()
BROKEN_PERCEPTIONS = {
    "paints": (painting, "changed the panorama; wanted it unchanged"),
    "no stamp": (lambda p, q, *, stamp=None: evidence(None), "carries None; wanted the same"),
    "another grid": (
        lambda p, q, *, stamp=None: evidence(stamp, grid=PatchGrid(4, 8)),
        "wanted the grid that the response was computed on",
    ),
    "beyond 1": (
        lambda p, q, *, stamp=None: evidence(stamp, drawn=4 * np.ones(GRID.shape), peak=2.0),
        r"wanted \[0, 1\]",
    ),
    "grids in turn": (
        lambda p, q, *, stamp=None: Evidence.from_response(*_sized(2 + next(_turns)), stamp=stamp),
        "wanted the same grid: a call must not change",
    ),
    "azimuth counts": (
        lambda p, q, *, stamp=None: Evidence.from_response(np.eye(32, 64), GRID, stamp=stamp),
        "treat all azimuths alike",
    ),
}  # fmt: skip


def _sized(rows):
    return np.zeros((rows, 64)), PatchGrid(rows, 64)


@pytest.mark.parametrize(("perception", "says"), BROKEN_PERCEPTIONS.values(), ids=BROKEN_PERCEPTIONS)
def test_the_check_of_perceptions_finds(perception, says):
    panorama = np.full((32, 64, 3), 9, np.uint8)
    panorama[:, :8] = 0
    with pytest.raises(AssertionError, match=says) as raised:
        check_perception(perception, panorama, "red", roll=8)
    assert "wanted" in str(raised.value)


# --- tasks with published data, with one fault -----------------------------------------------------------------------


class Numbers(PublishedTask):
    """As small as one can be: each file asks for a number, and holds the answer."""

    name, title, what = "numbers", "Numbers", "say the number"
    agents = {"right": "says what the file says"}  # noqa: RUF012
    metrics = (score_metric("overall", "Overall", "share of right answers", lambda record: record["score"]),)

    def info(self, data):
        return {"files": len(list(Path(data).glob("*.txt")))}

    def samples(self, config):
        files = sorted(Path(config.data).glob("*.txt"))
        return [Sample(file.stem, file.stem[0], file.read_text()) for file in files]

    def runner(self, config):
        return lambda payload: {"case": payload, "cluster": payload[0], "score": 1.0}

    def score(self, sample, prediction, config):
        return {"case": sample.id, "cluster": sample.group, "score": float(prediction["text"] == sample.payload)}


@pytest.fixture
def folder(tmp_path):
    """The data of `Numbers`."""
    for name in ("a1", "a2", "b1"):
        (tmp_path / f"{name}.txt").write_text(name)
    return str(tmp_path)


def faulty(faults):
    """A task whose records have these faults."""
    return other(runner=lambda self, config: lambda payload: Numbers.runner(self, config)(payload) | faults)


def other(**members):
    return type("Other", (Numbers,), members)()


SAMPLES = [Sample("a1", "a", "a1")]
BROKEN = {
    "a config that grows": (
        other(resolve=lambda self, c: msgspec.structs.replace(c, seed=c.seed + 1)),
        "to another config the second time",
    ),
    "an id twice": (other(samples=lambda self, config: SAMPLES * 2), "gives several samples the id a1; wanted"),
    "a payload with bytes": (
        other(samples=lambda self, config: [replace(SAMPLES[0], payload=b"a1")]),
        "gives a1 a payload that JSON cannot hold",
    ),
    "a record with NaN": (faulty({"views": math.nan}), "that JSON cannot hold"),
    "another case": (faulty({"case": "z9"}), "records the case z9 of the sample a1; wanted"),
    "a score of 100": (faulty({"score": 100}), r"wanted a number in \[0, 1\], 1 being success"),
}


def test_a_small_task_keeps_the_contract(folder):
    records = tasks.check_task(Numbers(), data=folder)
    assert [record["score"] for record in records] == [1.0, 1.0, 1.0]


def test_so_does_a_simulated_one():
    values = {"perception": "truth", "episodes": 1, "seed": 3, "methods": ["vmf", "eagor"], "rules": {"steps": 8}}
    (record,) = tasks.check_task(load("tracking"), **values)
    assert list(record["methods"]) == ["vmf", "eagor"]


def test_a_task_may_be_named_by_its_class_and_has_the_name_that_it_is_found_by(monkeypatch):
    monkeypatch.setitem(tasks.BUILT_IN, "numbers", f"{__name__}:Numbers")
    assert isinstance(load("numbers"), Numbers)
    for name, value, says in (
        ("digits", f"{__name__}:Numbers", "the task 'numbers'"), ("spin", "eagor_example:hall", "a function"),
    ):  # fmt: skip
        monkeypatch.setitem(tasks.BUILT_IN, name, value)
        with pytest.raises(EagorError, match=f"{name}.* is .*{says}; wanted"):
            load(name)


@pytest.mark.parametrize(("task", "says"), BROKEN.values(), ids=BROKEN)
def test_the_check_of_every_task_finds(task, says, folder):
    with pytest.raises(AssertionError, match=says):
        tasks.check_task(task, data=folder)


def test_a_setting_is_named_with_what_it_can_be(tmp_path):
    for changes, says in (
        ({"steps": "many"}, "rules.steps = 'many': Expected `int`, got `str`"),
        ({"speed": "-1"}, "rules.speed = '-1': Expected `float` > 0"),
        ({"chess": "1"}, "tracking has no 'chess' to set; it has perception, "),
    ):
        with pytest.raises(EagorError, match=re.escape(says)):
            tasks.read_config(load("tracking"), {}, changes)
    with pytest.raises(EagorError, match=re.escape("scoring = 'kind'")) as refused:
        tasks.read_config(load("hstar-hos"), {"data": str(tmp_path)}, {"scoring": "kind"})
    assert "wanted official, strict (what counts as success)" in str(refused.value)
