"""What pictures of a scene must obey, whatever the scene, the pose and the grid."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import at_most, rotations

from eagor.errors import GridError, PoseError, RotationError
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.lab.worlds import light as light_module
from eagor.lab.worlds.light import SKY_GAIN, Lattice, bake, hemisphere, light_of, sky_radiance
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import Instance, Lamp, Material, Room, Scene
from eagor.sphere import rotation, world_R_body

SIZE = np.array([5.0, 4.0, 2.6])
EYE = (2.2, 1.7, 1.4)
LAMP = np.array([2.5, 2.0, 2.1])
WINDOW = np.array([[1.5, 4.02, 0.9], [3.0, 4.06, 2.1]])


def quad(corner, along, up):
    """A rectangle of two triangles, counter-clockwise from the side that along x up points to; uv 0 to 1."""
    corner, along, up = (np.array(a, dtype=float) for a in (corner, along, up))
    vertices = np.stack([corner, corner + along, corner + along + up, corner + up])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    places = np.array([[0, 1, 2], [0, 2, 3]])
    return vertices, places, uv[places]


def box(low, high):
    """The six faces of a box, seen from outside."""
    (x0, y0, z0), size = low, np.subtract(high, low)
    x, y, z = np.diag(size)
    corner, far = np.array([x0, y0, z0]), np.array(high)
    sides = [(corner, y, x), (corner, x, z), (corner, z, y), (far, -x, -y), (far, -z, -x), (far, -y, -z)]
    return [quad(*side) for side in sides]


def build(things, materials, rooms=(), lamps=()):
    """A scene of `things`: (category, colour, faces, material); a face is (vertices, triangles, uv)."""
    parts, instances, owner, look, count = [], [], [], [], 0
    for place, (category, colour, faces, material) in enumerate(things):
        points = np.concatenate([face[0] for face in faces])
        instances.append(Instance(category, colour, None, points.min(axis=0), points.max(axis=0)))
        for vertices, triangles, uv in faces:
            parts.append((vertices, triangles + count, uv))
            count += len(vertices)
            owner += [place] * len(triangles)
            look += [material] * len(triangles)
    vertices, triangles, uv = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Scene(
        vertices.astype(np.float32), triangles.astype(np.int32), np.array(owner, np.int32), np.array(look, np.int32),
        uv.astype(np.float32), tuple(instances), tuple(materials), tuple(rooms), tuple(lamps),
    )  # fmt: skip


def furnished():
    """A white room with a window, a lamp, a red box and a table with a chequered top."""
    x, y, z = np.diag(SIZE)
    left, right = (WINDOW[0, 0], WINDOW[1, 0]), (WINDOW[0, 2], WINDOW[1, 2])
    wall = [quad(0 * x, z, x), quad(0 * x, y, z), quad(x, z, y)]
    for a, b, low, high in (
        (0, left[0], 0, SIZE[2]),
        (left[1], SIZE[0], 0, SIZE[2]),
        (*left, 0, right[0]),
        (*left, right[1], SIZE[2]),
    ):
        wall.append(quad([a, SIZE[1], low], [b - a, 0, 0], [0, 0, high - low]))
    chequer = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((8, 8)))[..., None] * [90, 60, 30] + 60
    materials = (
        Material("white", (0.9, 0.9, 0.88)),
        Material("boards", (0.75, 0.6, 0.45)),
        Material("red", (0.7, 0.1, 0.1)),
        Material("chequer", texture=chequer.astype(np.uint8)),
        Material("frame", (0.8, 0.8, 0.8)),
    )
    sill = box(WINDOW[0], [WINDOW[1, 0], WINDOW[1, 1], WINDOW[0, 2] + 0.04])
    head = box([WINDOW[0, 0], WINDOW[0, 1], WINDOW[1, 2] - 0.04], WINDOW[1])
    things = [
        ("floor", None, [quad(0 * x, x, y)], 1),
        ("ceiling", None, [quad(z, y, x)], 0),
        ("wall", None, wall, 0),
        ("window", None, [*sill, *head], 4),
        ("box", "red", box([3.6, 0.4, 0.0], [4.6, 1.2, 0.9]), 2),
        ("table", None, box([0.4, 2.6, 0.7], [1.6, 3.4, 0.76]), 3),
    ]
    room = Room("room", "living room", np.array([[0, 0, SIZE[0], SIZE[1]]]))
    return build(things, materials, [room], [Lamp(LAMP, np.array([1.2, 1.1, 0.9]))])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("light")


@pytest.fixture(autouse=True)
def _own_cache(folder, monkeypatch):
    monkeypatch.setenv("EAGOR_CACHE", str(folder))


@pytest.fixture(scope="module")
def scene():
    return furnished()


@pytest.fixture(scope="module")
def renderer(scene, folder):
    return Renderer(scene, cache=folder)


def bare(size=SIZE):
    """An empty white room without a source of light."""
    x, y, z = np.diag(size)
    faces = [quad(0 * x, x, y), quad(z, y, x), quad(0 * x, z, x), quad(0 * x, y, z), quad(x, z, y), quad(y, x, z)]
    return build([("wall", None, faces, 0)], [Material("white", (0.8, 0.8, 0.8))])


@given(st.floats(-math.pi, math.pi), st.integers(-70, 70), st.sampled_from([16, 33]))
@at_most(40)
def test_turning_by_whole_columns_rolls_the_panorama_bit_for_bit(renderer, start, columns, height):
    turn = columns * 2 * math.pi / (2 * height)
    before = renderer.panorama(EYE, world_R_body(start), height)
    after = renderer.panorama(EYE, world_R_body(start + turn), height)
    for name in ("rgb", "range", "ids"):
        # Turning left moves what is seen to the right.
        assert np.array_equal(np.roll(getattr(before, name), columns, axis=1), getattr(after, name))


@given(rotations())
@settings(max_examples=25)
def test_range_in_an_empty_room_is_the_closed_form_in_any_pose(pose):
    frame = Renderer(bare()).panorama(EYE, pose, 16, rgb=False)
    ways = ErpGrid(16, 32).directions @ pose.T
    with np.errstate(divide="ignore"):
        expected = np.min(np.where(ways > 0, (SIZE - EYE) / ways, -np.array(EYE) / ways), axis=-1)
    assert np.allclose(frame.range, expected, rtol=1e-4)
    assert (frame.range.dtype, frame.ids.dtype) == (np.float32, np.int32)
    assert not frame.ids.any()


GRIDS = {
    "perspective": PerspectiveGrid(40, 60, math.radians(80), rotation((0, 0, 1), 0.4)),
    "patches": PatchGrid(9, 20),
    "fisheye": FisheyeGrid(40, math.radians(190)),
    "erp": ErpGrid(32, 64),
}


@pytest.mark.parametrize("name", GRIDS)
def test_a_view_agrees_with_the_panorama(renderer, name):
    grid, pose = GRIDS[name], world_R_body(0.7, 0.2, -0.3)
    view = renderer.view(EYE, pose, grid)
    panorama = renderer.panorama(EYE, pose, 180)
    x, y, _ = ErpGrid(180, 360).project(grid.directions)
    row, column = np.clip(y.astype(int), 0, 179), x.astype(int) % 360
    seen = grid.weights > 0
    same = (panorama.ids[row, column] == view.ids) & seen
    assert view.rgb.shape == (*grid.shape, 3)
    assert same[seen].mean() > 0.96
    finite = same & np.isfinite(view.range)
    assert np.median(np.abs(panorama.range[row, column] / np.where(finite, view.range, 1) - 1)[finite]) < 0.01
    plain = same & (view.ids != 5) & finite  # not the chequered table: one pixel aside is another square
    apart = np.abs(panorama.rgb[row, column].astype(int) - view.rgb)[plain]
    assert np.quantile(apart, 0.95) <= 6


def test_what_a_grid_does_not_see_is_black_endless_and_nothing(renderer):
    grid = FisheyeGrid(24, math.pi)
    frame = renderer.view(EYE, np.eye(3), grid)
    blind = grid.weights == 0
    assert blind.any()
    assert not frame.rgb[blind].any()
    assert np.isinf(frame.range[blind]).all()
    assert (frame.ids[blind] == -1).all()
    assert frame.rgb[~blind].any(axis=-1).all()


def test_out_of_the_window_there_is_nothing_to_hit_but_something_to_see(renderer):
    frame = renderer.panorama((2.25, 3.0, 1.5), world_R_body(math.pi / 2), 64)
    outside = frame.ids == -1
    assert 0.02 < outside.mean() < 0.3
    assert np.array_equal(outside, np.isinf(frame.range))
    upper, lower = frame.rgb[:32][outside[:32]].mean(axis=0), frame.rgb[32:][outside[32:]].mean(axis=0)
    assert upper[2] > 180  # sky above
    assert lower[1] > lower[2]  # grass below


def test_ids_and_range_need_no_light(scene, monkeypatch):
    monkeypatch.setattr("eagor.lab.worlds.render.light_of", lambda *_: pytest.fail("light was asked for"))
    Renderer(scene).panorama(EYE, np.eye(3), 8, rgb=False)


def test_a_texture_is_the_right_way_up_and_round():
    colours = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]], dtype=np.uint8)  # rows from the top
    wall = quad([2, 1, 0], [0, -2, 0], [0, 0, 2])  # seen from the origin: u to the right, v up
    scene = build(
        [("wall", None, [wall], 0)], [Material("four", texture=np.kron(colours, np.ones((8, 8, 1), np.uint8)))]
    )
    rgb = Renderer(scene).view((0, 0, 1), np.eye(3), PerspectiveGrid(32, 32, math.radians(50))).rgb
    found = rgb[8:24:15, 8:24:15].astype(int)  # one pixel in each quarter
    expected = np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 0]]], dtype=bool)
    assert np.array_equal(found > 60, expected)


def test_light_of_one_lamp_is_the_inverse_square_law():
    floor = quad([-4, -4, 0], [8, 0, 0], [0, 8, 0])
    power = np.array([3.0, 2.0, 1.0])
    scene = build(
        [("floor", None, [floor], 0)], [Material("black", (0, 0, 0))], lamps=[Lamp(np.array([0, 0, 2.0]), power)]
    )
    scene = replace(scene, daylight=(0.0, 0.0, 0.0))
    lattice = Lattice.of(scene)
    found = bake(scene, lattice)
    place = lattice.points.position[lattice.points.of_slot]
    square = (place**2)[:, :2].sum(axis=1) + 4
    expected = 2 / square[:, None] ** 1.5 * power
    inner = square < 13
    assert np.allclose(found[inner], expected[inner], rtol=0.03)


def test_a_plane_under_the_open_sky_has_the_light_of_half_a_sphere():
    floor = quad([0, 0, 0], [1, 0, 0], [0, 1, 0])
    scene = build([("floor", None, [floor], 0)], [Material("grey", (0.5, 0.5, 0.5))])
    found = bake(scene, Lattice.of(scene)).mean(axis=0)
    ways = hemisphere(4000)
    expected = SKY_GAIN * sky_radiance(ways).mean(axis=0) * scene.daylight
    assert np.allclose(found, expected, rtol=0.02)


def test_a_room_without_any_source_is_still_seen():
    rgb = Renderer(bare()).panorama(EYE, np.eye(3), 16).rgb
    assert rgb.min() > 40


def test_light_is_kept_on_disk_and_read_again(scene, folder, monkeypatch):
    first = Renderer(scene, cache=folder).panorama(EYE, np.eye(3), 16).rgb
    (file,) = folder.glob(f"*{scene.hash}*")
    assert file.match(f"light-{light_module.VERSION}-*.npz")
    monkeypatch.setattr(light_module, "bake", lambda *_: pytest.fail("the light was in the cache"))
    assert np.array_equal(first, Renderer(scene, cache=folder).panorama(EYE, np.eye(3), 16).rgb)


@pytest.mark.parametrize("damage", [b"", b"not an archive", None])
def test_a_damaged_file_is_made_anew(tmp_path, damage):
    scene = bare()
    lattice = Lattice.of(scene)
    light = light_of(scene, lattice, cache=tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-200] if damage is None else damage)
    assert np.array_equal(light_of(scene, lattice, cache=tmp_path), light)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    assert np.load(file)["light"].shape == light.shape


def test_the_same_walls_with_other_rooms_have_a_light_of_their_own(scene, tmp_path):
    closed = replace(scene, rooms=())  # without rooms nobody knows that the window leads outdoors
    assert closed.hash == scene.hash
    lights = [light_of(s, Lattice.of(s), cache=tmp_path) for s in (scene, closed)]
    assert len(list(tmp_path.iterdir())) == 2
    assert np.array_equal(light_of(scene, Lattice.of(scene), cache=tmp_path), lights[0])
    assert not np.array_equal(*lights)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda r: r.panorama((1, 2), np.eye(3), 8), PoseError),
        (lambda r: r.panorama((1, 2, math.nan), np.eye(3), 8), PoseError),
        (lambda r: r.panorama(EYE, np.ones((3, 3)), 8), RotationError),
        (lambda r: r.view(EYE, -np.eye(3), ErpGrid(4, 8)), RotationError),
        (lambda r: r.panorama(EYE, np.eye(3), 0), GridError),
    ],
)
def test_bad_arguments_are_refused(renderer, call, error):
    with pytest.raises(error):
        call(renderer)
