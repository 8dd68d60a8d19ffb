"""Pictures that are no good panoramas are told from those that are: four photographs, and rendered rooms."""

import io
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from eagor.errors import ImageError
from eagor.grids import ErpGrid, FisheyeGrid
from eagor.lab.worlds.apartment import generate
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.painted import painted_room
from eagor.lab.worlds.render import Renderer
from eagor.sources.defects import InvalidMask, circles_in_words, invalid_mask, problems, seam_of
from eagor.sources.panorama import read_panorama, turn, view
from eagor.sphere import world_R_body

PHOTOGRAPHS = sorted(Path(__file__).parents[2].joinpath("../shared/panoramas").glob("*.png"))
NAMES = ["painted", *(path.stem for path in PHOTOGRAPHS)]
FEW = [*NAMES[:2], *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[2:])]


@lru_cache(maxsize=8)
def room(name):
    return painted_room(512, 1024) if name == "painted" else read_panorama({p.stem: p for p in PHOTOGRAPHS}[name])


def jpeg(image, quality=50):
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file).convert("RGB"))


def lenses(image, scale=1.0, size=256):
    """Two squares with the circles of fisheye lenses that see 190 degrees; `scale`: of the circles to the squares."""
    made = []
    for yaw in (0.0, np.pi):
        seen = view(image, FisheyeGrid(size, np.radians(190), world_R_body(yaw)))
        side = round(scale * size)
        circle = np.asarray(Image.fromarray(seen).resize((side, side)))
        square = np.zeros((max(size, side), max(size, side), 3), np.uint8)
        start = (len(square) - side) // 2
        square[start : start + side, start : start + side] = circle
        start = (len(square) - size) // 2
        made.append(square[start : start + size, start : start + size])
    return made


def check_good(image):
    assert not circles_in_words(image)
    assert not seam_of(image).visible, seam_of(image)
    assert not invalid_mask(image).any()
    assert problems(image) == ()


# --- good panoramas --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FEW)
def test_no_alarm_for_turned_photographs(name):
    for seed in range(2):
        turned = turn(room(name), Rotation.random(random_state=seed).as_matrix() if seed else np.eye(3))
        for image in (turned, jpeg(turned), turned[::2, ::2]):
            check_good(np.ascontiguousarray(image))


@pytest.mark.parametrize("name", FEW)
def test_no_alarm_wherever_the_seam_is(name):
    """Wherever the seam is put. Of 2050 places in the photographs and the painted room, none gave an alarm."""
    image = room(name)
    alarms = [seam_of(np.roll(image, k, axis=1)).visible for k in range(0, 1024, 32)]
    assert not any(alarms)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_no_alarm_in_apartments(seed):
    scene = generate(seed)
    renderer, ground, rng = Renderer(scene), Ground.from_scene(scene), np.random.default_rng(seed)
    for k in range(2):
        pose = Rotation.random(random_state=seed).as_matrix() if k else np.eye(3)
        image = renderer.panorama((*map(float, ground.sample(rng)), 1.25), pose, 128, range=False, ids=False).rgb
        assert image is not None
        check_good(image)
        check_good(jpeg(image))


def test_no_alarm_in_the_dark():
    check_good(np.full((64, 128, 3), 12, np.uint8))
    night = np.random.default_rng(0).integers(0, 10, (128, 256, 3)).astype(np.uint8)
    assert not circles_in_words(night)
    assert not invalid_mask(night).any()


# --- fisheye ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FEW)
@pytest.mark.parametrize("scale", [0.85, 0.95, 1.0, 1.1])
def test_fisheye_circles_are_found(name, scale):
    front, back = lenses(room(name), scale)
    both = np.concatenate([front, back], axis=1)
    wide = np.zeros_like(both)
    wide[:, 128:384] = front
    for change in (np.asarray, jpeg):
        assert circles_in_words(change(both)).startswith("the two circles of a dual fisheye")
        assert circles_in_words(change(front)) == "the circle of a fisheye lens"
        assert circles_in_words(change(wide)) == "the circle of a fisheye lens"
    assert "two circles of a dual fisheye camera" in problems(both)[0]
    assert "circle of a fisheye lens" in problems(wide)[0]


# --- the seam --------------------------------------------------------------------------------------------------------


def broken(image):
    width = image.shape[1]
    darker = image * np.linspace(1.0, 0.7, width)[None, :, None]
    yield darker.astype(np.uint8)  # by 30 % at one end
    yield image[:, : 3 * width // 4]  # not the whole turn
    yield np.concatenate([image[:, width // 4 :], image[:, width // 2 : 3 * width // 4]], axis=1)  # another place


@pytest.mark.parametrize("name", NAMES)
def test_borders_that_do_not_fit(name):
    found = [seam_of(change(np.ascontiguousarray(b))) for b in broken(room(name)) for change in (np.asarray, jpeg)]
    assert [seam.visible for seam in found[:2]] == [True, True]
    assert sum(seam.visible for seam in found) >= len(found) - 2
    assert all(seam.ratio > 3 for seam in found)


def test_the_seam_is_said_with_its_number():
    bad = next(broken(room("painted")))
    (said,) = problems(bad)
    seam = seam_of(bad)
    assert f"is {seam.ratio:.1f} times that between other neighbouring columns" in said
    assert f"in {100 * seam.rows:.0f} % of the rows" in said


# --- what is never seen ----------------------------------------------------------------------------------------------


def holes(shape):
    """What is black: a disc at the nadir, letterbox, all behind the camera, a disc at the top."""
    elevation = np.degrees(np.arcsin(ErpGrid(*shape).directions[..., 2]))
    azimuth = np.degrees(np.arctan2(*np.moveaxis(ErpGrid(*shape).directions[..., [1, 0]], -1, 0)))
    return [elevation < -75, np.abs(elevation) > 60, np.abs(azimuth) > 90, elevation > 84]


@pytest.mark.parametrize("name", FEW)
@pytest.mark.parametrize("which", range(4))
def test_black_holes_are_found(name, which):
    image = room(name).copy()
    truth = holes(image.shape[:2])[which]
    image[truth] = 0
    for change in (np.asarray, jpeg):
        found = invalid_mask(change(image))
        assert found.shape == truth.shape
        assert (found & truth).sum() > 0.9 * truth.sum()
        assert (found & ~truth).sum() < 0.03 * truth.size
        assert not circles_in_words(change(image))
        assert not seam_of(change(image)).visible


def test_black_things_and_dark_rooms_are_no_holes():
    image = room("painted").copy()
    image[200:300, 100:300] = 0  # a black screen
    assert not invalid_mask(image).any()
    image[-40:] = np.random.default_rng(0).integers(0, 24, (40, 1024, 3))  # a dark floor, photographed
    assert not invalid_mask(image).any()


def test_what_is_black_in_all_pictures():
    always = holes((256, 512))[0]
    gathered = InvalidMask()
    assert gathered.mask is None
    for k in range(4):
        image = turn(room("painted")[::2, ::2], world_R_body(0.5 * k))
        if k == 0:
            image[holes((256, 512))[3]] = 0  # a lamp that is off, once
        image[always] = 0
        mask = gathered.add(image)
        assert mask[:4].any() == (k == 0)
    assert mask is gathered.mask
    assert (mask & always).sum() > 0.95 * always.sum()
    assert (mask & ~always).mean() < 0.01


def test_what_is_no_picture():
    for look in (circles_in_words, seam_of, invalid_mask, problems):
        with pytest.raises(ImageError, match="wanted uint8 sRGB"):
            look(np.zeros((4, 8)))
        look(np.zeros((1, 1, 3), np.uint8))
        look(np.zeros((2, 3, 3), np.uint8))
