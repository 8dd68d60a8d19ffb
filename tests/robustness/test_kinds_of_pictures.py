"""Kinds of pictures that people have: animations, AVIF, transparency, suffixes of their own, two strips of a cube."""

import json

import av
import cv2
import numpy as np
import pytest
from clips import clip
from commands import answer, eagor, refused
from PIL import Image

from eagor.errors import ImageError, TimeError
from eagor.lab.worlds.painted import painted_room
from eagor.sources import check_camera
from eagor.sources.animations import is_animation
from eagor.sources.camera_sources import FrameCheck, open_source
from eagor.sources.panorama import BOXED, UNREAD, turn
from eagor.sources.video import Video
from eagor.sphere import world_R_body

ROOM = painted_room(128, 256)
TURNING = [turn(ROOM, world_R_body(0.15 * k).T) for k in range(5)]
ANIMATED = [
    ("webp", {"lossless": True}),
    ("gif", {}),
    ("png", {}),
    ("apng", {"format": "PNG"}),
    ("avif", {"quality": 95}),
]


def animated(path, times=(200, 300, 400, 500, 600), **how):
    first, *rest = map(Image.fromarray, TURNING)
    first.save(path, save_all=True, append_images=rest, duration=list(times), **how)
    return path


@pytest.mark.parametrize(("kind", "how"), ANIMATED)
def test_an_animation_is_looked_at_picture_by_picture_at_its_times(tmp_path, kind, how):
    path = animated(tmp_path / f"turning.{kind}", **how)
    assert is_animation(path)
    frames = list(Video(path))
    assert [frame.stamp for frame in frames] == pytest.approx([0, 0.2, 0.5, 0.9, 1.4], abs=0.011)
    shown = np.stack([frame.picture for frame in frames]).astype(int)
    assert np.abs(shown - TURNING).mean() < 6  # a GIF has 256 colours, an AVIF is compressed
    assert [f.stamp for f in Video(path, rate=2, start=0.2, end=1.3)] == pytest.approx([0.2, 0.9], abs=0.011)
    assert Video(path, rows=64).shape == (64, 128)
    with pytest.raises(TimeError, match="no picture from 9 s on"):
        list(Video(path, start=9))


def test_track_live_look_and_locate_take_animations(tmp_path):
    path = animated(tmp_path / "turning.webp", lossless=True)
    found = answer("track", path, "the red ball", "--perception", "colour", "--rate", 10)["frames"]
    turned = np.unwrap([frame["azimuth_deg"] for frame in found], period=360)
    assert len(found) == 5
    assert turned[-1] - turned[0] == pytest.approx(-np.degrees(0.6), abs=4)
    done = eagor("locate", path, "the red ball", "--perception", "colour")
    assert "5 pictures, one after the other" in done.stderr
    check_camera(open_source(str(path)))
    assert len(list(open_source(str(path)))) == 5


def test_times_that_are_missing_are_a_tenth_of_a_second(tmp_path):
    path = animated(tmp_path / "turning.gif", times=[0] * 5)
    assert [frame.stamp for frame in Video(path)] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_a_damaged_animation_gives_what_can_be_read(tmp_path):
    path = animated(tmp_path / "turning.png")
    data = bytearray(path.read_bytes())
    at = data.rindex(b"fdAT") + 100
    data[at : at + 200] = bytes(200)
    path.write_bytes(data)
    frames = iter(Video(path))
    assert [next(frames).stamp for _ in range(4)] == pytest.approx([0, 0.2, 0.5, 0.9])
    with pytest.raises(ImageError, match=r"is damaged: its picture after 1\.40 s"):
        next(frames)


def test_pages_are_not_time_and_that_is_said(tmp_path):
    first, *rest = map(Image.fromarray, TURNING)
    first.save(tmp_path / "pages.tif", save_all=True, append_images=rest)
    assert not is_animation(tmp_path / "pages.tif")
    said = []
    FrameCheck(say=said.append).read(tmp_path / "pages.tif")
    assert any("it holds 5 pictures, of which the first is taken" in text for text in said)


# --- kinds of files ---


@pytest.mark.parametrize("name", ["a.avif", "b.insp", "c.jfif", "d.gif", "e.ppm"])
def test_a_folder_may_hold_every_kind_that_can_be_read(tmp_path, name):
    kinds = {".insp": "JPEG", ".jfif": "JPEG"}
    for k in range(2):
        Image.fromarray(ROOM).save(tmp_path / f"{k}{name}", kinds.get(f".{name.split('.')[1]}"))
    assert len(list(open_source(str(tmp_path)))) == 2
    assert np.abs(FrameCheck(True).read(tmp_path / f"1{name}").picture.astype(int) - ROOM).mean() < 6


@pytest.mark.parametrize("brand", BOXED)
def test_a_kind_that_needs_a_package_names_it(tmp_path, monkeypatch, brand):
    monkeypatch.setattr("eagor.sources.panorama.FORMATS", ("PNG", "JPEG"))
    monkeypatch.setattr("eagor.sources.panorama.find_spec", lambda name: None)
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftyp" + brand + bytes(60))
    with pytest.raises(ImageError, match=r"pillow-heif|Pillow from version 11\.3"):
        FrameCheck(True).read(tmp_path / "a.heic")


@pytest.mark.parametrize(("begin", "name"), UNREAD)
def test_a_kind_that_is_not_read_is_named(tmp_path, begin, name):
    (tmp_path / "0.exr").write_bytes(begin + bytes(60))
    (frame,) = open_source(str(tmp_path))
    assert f"is {name}, which is not read; export it as PNG or JPEG" in frame.problem


def test_pictures_of_12_bits_in_16_are_scaled_or_refused(tmp_path):
    Image.fromarray(ROOM[..., 1].astype(np.uint16) * 16).save(tmp_path / "grey.png")
    said = []
    found = FrameCheck(True, said.append).read(tmp_path / "grey.png").picture
    assert np.abs(found[..., 0].astype(int) - ROOM[..., 1]).max() <= 1
    assert any("16-bit values are taken for 12 bits" in text for text in said)
    cv2.imwrite(str(tmp_path / "colour.png"), ROOM.astype(np.uint16) * 16)
    with pytest.raises(ImageError, match="16-bit colours of which 12 bits or fewer are used"):
        FrameCheck(True).read(tmp_path / "colour.png")


def test_pictures_that_are_there_in_two_kinds_are_said(tmp_path):
    for name in ("a.png", "a.JPG", "b.png"):
        Image.fromarray(ROOM).save(tmp_path / name)
    with pytest.warns(UserWarning, match="1 names with several endings, such as a: all are taken"):
        assert len(list(open_source(str(tmp_path)))) == 3


@pytest.mark.parametrize(
    ("name", "container"), [("a.m2ts", "mpegts"), ("a.MTS", "mpegts"), ("a.clip", "matroska"), ("a", "mp4")]
)
def test_a_video_of_any_name_is_one(tmp_path, name, container):
    path = tmp_path / name
    clip(path, TURNING * 2, rate=5, container=container)
    assert len(answer("track", path, "the red ball", "--perception", "colour")["frames"]) == 4


def test_what_is_neither_a_picture_nor_a_video_is_called_no_picture(tmp_path):
    (tmp_path / "notes.txt").write_text("0 0 0\n" * 100)
    assert "cannot be read as an image" in refused("locate", tmp_path / "notes.txt", "ball", "--perception", "colour")


def test_two_strips_of_a_cube_are_not_sent_to_a_rig(tmp_path):
    with av.open(str(tmp_path / "GS01.360"), "w", format="mp4") as file:
        tracks = [file.add_stream("libx264", rate=5) for _ in range(2)]
        for track in tracks:
            track.width, track.height, track.pix_fmt = 384, 128, "yuv420p"
        for track in tracks:
            for _ in range(4):
                file.mux(track.encode(av.VideoFrame.from_ndarray(np.full((128, 384, 3), 90, np.uint8), "rgb24")))
            file.mux(track.encode())
    said = refused("track", tmp_path / "GS01.360", "ball", "--perception", "colour")
    assert "v360=eac:e" in said
    assert "--rig" not in said


# --- transparency ---


def seen_half(mode):
    """The room with its lower half transparent, as `mode`; what is hidden is white, or a colour of its own."""
    alpha = np.full(ROOM.shape[:2], 255, np.uint8)
    alpha[64:] = 0
    if mode == "RGBA":
        return Image.fromarray(np.dstack([np.where(alpha[..., None] > 0, ROOM, 255).astype(np.uint8), alpha])), {}
    if mode == "RGB":  # a colour that is transparent
        key = np.array((1, 2, 3), np.uint8)
        keyed = np.where(alpha[..., None] > 0, np.maximum(ROOM, 5), key)
        return Image.fromarray(keyed.astype(np.uint8)), {"transparency": (1, 2, 3)}
    palette = Image.fromarray(np.where(alpha > 0, ROOM[..., 0] // 2 + 1, 0).astype(np.uint8))
    palette.putpalette([value for k in range(256) for value in (k, k, 255 - k)])
    return palette, {"transparency": 0}


@pytest.mark.parametrize("mode", ["RGBA", "RGB", "P"])
def test_what_is_transparent_is_not_seen(tmp_path, mode):
    image, how = seen_half(mode)
    image.save(tmp_path / "half.png", **how)
    found = FrameCheck(True).read(tmp_path / "half.png")
    assert found.unseen[64:].all()
    assert not found.unseen[:64].any()
    assert (found.picture[64:] == 0).all()


def test_the_mask_of_a_part_goes_with_it_and_opaque_pictures_have_none(tmp_path):
    said = dict(FullPanoWidthPixels=256, CroppedAreaLeftPixels=64, CroppedAreaTopPixels=32)
    tags = " ".join(f'GPano:{name}="{value}"' for name, value in {"ProjectionType": "equirectangular", **said}.items())
    packet = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<r:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {tags}/></r:RDF></x:xmpmeta>'
    )
    part = np.dstack([ROOM, np.full(ROOM.shape[:2], 255, np.uint8)])[32:96, 64:192]
    part[:, :32, 3] = 0
    Image.fromarray(part).save(tmp_path / "part.webp", lossless=True, xmp=packet.encode())
    seen = ~FrameCheck(True).read(tmp_path / "part.webp").unseen
    assert np.array_equal(np.argwhere(seen).min(axis=0), (32, 96))
    assert seen.sum() == 64 * 96
    Image.fromarray(np.dstack([ROOM, np.full(ROOM.shape[:2], 200, np.uint8)])).save(tmp_path / "whole.png")
    assert FrameCheck(True).read(tmp_path / "whole.png").unseen is None


def test_an_ordinary_picture_hides_what_is_transparent(tmp_path):
    """A red ball in an opaque half is found; where the other half is hidden, the answer is less sure of its absence."""
    picture = np.full((90, 120, 4), 90, np.uint8)
    picture[..., 3] = 255
    Image.fromarray(picture).save(tmp_path / "all.png")
    picture[:, :60, 3] = 0
    Image.fromarray(picture).save(tmp_path / "half.png")
    whole, half = (
        answer("locate", tmp_path / name, "the red ball", "--perception", "colour", "--hfov", 60)
        for name in ("all.png", "half.png")
    )
    assert half["presence"] > whole["presence"] + 0.001
    assert json.dumps(half["azimuth_deg"])
