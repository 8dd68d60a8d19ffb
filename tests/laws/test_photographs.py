"""Photographs and what their files say (GPano): cropped areas, how the camera was held, other projections."""

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from eagor.errors import ImageError
from eagor.grids import ErpGrid
from eagor.lab.worlds.painted import painted_room
from eagor.sources.camera_sources import FrameCheck
from eagor.sources.intrinsics import ShapeError
from eagor.sources.panorama import turn
from eagor.sphere import angular_distance, direction

SHAPE = (128, 256)


def marked(azimuth, elevation):
    """A grey panorama with a white disc of 6 degrees at a direction (degrees)."""
    image = np.full((*SHAPE, 3), 60, np.uint8)
    place = direction(np.radians(azimuth), np.radians(elevation))
    image[angular_distance(ErpGrid(*SHAPE).directions, place) < np.radians(6)] = 255
    return image


def mark(image):
    weight = np.where(image.min(axis=2) > 150, ErpGrid(*image.shape[:2]).weights, 0.0)
    return (ErpGrid(*image.shape[:2]).directions * weight[..., None]).sum(axis=(0, 1))


def off(a, azimuth, elevation):
    return float(np.degrees(angular_distance(a, direction(np.radians(azimuth), np.radians(elevation)))))


def xmp(**said):
    inside = " ".join(
        f'GPano:{name}="{value}"' for name, value in ({"ProjectionType": "equirectangular"} | said).items()
    )
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
        f'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {inside}/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


def saved(folder, image, packet, kind="jpg"):
    path = folder / f"room.{kind}"
    picture = Image.fromarray(image)
    if kind == "png":
        info = PngImagePlugin.PngInfo()
        info.add_itxt("XML:com.adobe.xmp", packet.decode())
        picture.save(path, pnginfo=info)
    elif kind == "webp":
        picture.save(path, lossless=True, xmp=packet)
    else:
        picture.save(path, quality=95, xmp=packet)
    return path


def read(path, force=False):
    """The picture, and what is said of it."""
    said = []
    return FrameCheck(force, said.append).read(path), " ".join(said)


@pytest.mark.parametrize("kind", ["jpg", "png", "webp"])
def test_a_cropped_panorama_is_put_where_it_was(tmp_path, kind):
    whole = marked(40, 15)
    area = {"FullPanoWidthPixels": 256, "FullPanoHeightPixels": 128, "CroppedAreaImageWidthPixels": 160}
    area |= {"CroppedAreaImageHeightPixels": 64, "CroppedAreaLeftPixels": 48, "CroppedAreaTopPixels": 32}
    photo, said = read(saved(tmp_path, whole[32:96, 48:208], xmp(**area), kind))
    assert photo.picture.shape == (*SHAPE, 3)
    assert off(mark(photo.picture), 40, 15) < 1.0
    assert photo.unseen.mean() == pytest.approx(1 - 0.5 * 160 / 256)
    assert (photo.picture[photo.unseen] == 0).all()
    assert "225 x 90 degrees of the sphere" in said
    assert photo.level_R_body is None


@pytest.mark.parametrize(
    ("said", "at", "level"),
    [  # where the mark is in the picture, and level: azimuth, elevation
        ({"PosePitchDegrees": 25}, (0, 0), (0, 25)),
        ({"PoseRollDegrees": 20}, (-90, 0), (-90, -20)),  # the right side is down
        ({"PoseHeadingDegrees": 90, "PosePitchDegrees": -10}, (0, 0), (0, -10)),
    ],
)
def test_how_the_camera_was_held(tmp_path, said, at, level):
    photo, _ = read(saved(tmp_path, marked(*at), xmp(**said)))
    assert photo.unseen is None
    assert off(photo.level_R_body @ mark(photo.picture), *level) < 1.0
    assert off(mark(turn(photo.picture, photo.level_R_body)), *level) < 1.0


def test_a_photograph_that_says_nothing(tmp_path):
    Image.fromarray(painted_room(64, 128)).save(tmp_path / "room.png")
    photo, said = read(tmp_path / "room.png")
    assert np.array_equal(photo.picture, painted_room(64, 128))
    assert (photo.unseen, photo.level_R_body, said) == (None, None, "")
    Image.fromarray(painted_room(64, 128)[:, :100]).save(tmp_path / "room.png")
    with pytest.raises(ShapeError, match="not 2:1"):
        read(tmp_path / "room.png")
    photo, said = read(tmp_path / "room.png", force=True)
    assert photo.picture.shape == (64, 100, 3)
    assert "not 2:1; accepted" in said


@pytest.mark.parametrize("kind", ["cylindrical", "cubestrip"])
def test_other_projections(tmp_path, kind):
    with pytest.raises(ImageError, match=f"room.jpg is a {kind} picture, as its XMP .GPano. says, not equirectangular"):
        read(saved(tmp_path, marked(0, 0), xmp(ProjectionType=kind)))


def test_a_word_of_any_length_is_shown_in_part(tmp_path):
    with pytest.raises(ImageError, match=r"is a xxx.{0,500}$"):
        read(saved(tmp_path, marked(0, 0), xmp(ProjectionType="x" * 9000)))


FULL = {"FullPanoWidthPixels": 256, "FullPanoHeightPixels": 128}


def area(wide, high, left=None, top=None, **full):
    said = {"ImageWidth": wide, "ImageHeight": high, "Left": left, "Top": top}
    return full | {f"CroppedArea{name}Pixels": value for name, value in said.items() if value is not None}


@pytest.mark.parametrize(
    ("part", "said"),
    [  # rows and columns that the picture shows of a whole one of 128 x 256, and what it says
        ((32, 96, 48, 208), area(160, 64, 48, 32, FullPanoWidthPixels=256)),  # the sphere's height is half of that
        ((32, 96, 48, 208), area(160, 64, 48, 32, FullPanoHeightPixels=128)),
        ((32, 96, 48, 208), FULL | {"CroppedAreaLeftPixels": 48, "CroppedAreaTopPixels": 32}),  # its own size
        ((32, 96, 0, 256), area(256, 64, None, 32, **FULL)),  # all around begins at the border
        ((65, 128, 96, 256), area(160, 64, 97, 65, **FULL)),  # one row and one column too many
        ((0, 64, 96, 256), area(160, 64, 96, -1, **FULL)),
        ((32, 96, 200, 250), area(50, 64, 200, 32, **FULL)),  # far from the middle
        ((0, 128, 0, 256), {}),
        ((0, 128, 0, 256), FULL),
        ((0, 128, 0, 256), {"PosePitchDegrees": "nan", "PoseRollDegrees": "up"}),
    ],
)
def test_a_part_is_placed_where_the_numbers_allow_one_place(tmp_path, part, said):
    top, bottom, left, right = part
    at = 180 - (left + right) / 256 * 180, 90 - (top + bottom) / 128 * 90
    photo, _ = read(saved(tmp_path, marked(*at)[top:bottom, left:right], xmp(**said)))
    assert photo.picture.shape[1] == 2 * photo.picture.shape[0]
    assert off(mark(photo.picture), *at) < 1.5
    unseen = 0.0 if photo.unseen is None else photo.unseen.mean()
    assert unseen == pytest.approx(1 - (bottom - top) * (right - left) / 128 / 256, abs=0.02)


def test_an_area_without_a_type_is_one_all_the_same(tmp_path):
    packet = xmp(**area(128, 64, 48, 32, **FULL)).replace(b'GPano:ProjectionType="equirectangular"', b"")
    photo, _ = read(saved(tmp_path, marked(100, 10)[32:96, 48:176], packet))
    assert off(mark(photo.picture), 100, 10) < 1.5


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((60, 256), {}),  # the kind alone, and not 2:1
        ((60, 256), {"FullPanoWidthPixels": 256, "FullPanoHeightPixels": 60}),  # no sphere
        ((60, 256), area(256, 60, 0, 0, FullPanoWidthPixels=256, FullPanoHeightPixels=60)),
        ((64, 160), area(160, 64, 48, 32)),  # of what?
        ((64, 160), area(160, 64, 48, **FULL)),  # at what height?
        ((64, 160), area(160, 64, 120, 32, **FULL)),  # beyond the border
        ((64, 160), area(160, 64, 48, 32, FullPanoWidthPixels=256, FullPanoHeightPixels=95)),
        ((64, 100), area(160, 64, 48, 32, **FULL)),  # cut since
        ((128, 256), area(160, 64, FullPanoWidthPixels=100, FullPanoHeightPixels=128)),
        ((128, 256), area("wide", 1, FullPanoWidthPixels=1, FullPanoHeightPixels="nan")),
        ((64, 160), area(0, 64, 48, 32, **FULL)),
    ],
)
def test_an_area_that_does_not_add_up_is_refused_with_its_numbers(tmp_path, shape, said):
    path = saved(tmp_path, painted_room(128, 256)[: shape[0], : shape[1]], xmp(**said))
    with pytest.raises(ImageError, match=f"the picture is {shape[1]} x {shape[0]}.*--force") as refused:
        read(path)
    assert all(f"{name} {value}" in str(refused.value) for name, value in said.items())
    forced, said = read(path, force=True)
    assert (forced.unseen, forced.picture.shape[1]) == (None, 2 * shape[0])
    assert "all columns for 360 degrees" in said
