"""Readers of pictures and of worlds: a right value, or an error with a name; no room for what is only claimed."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from box_scenes import scene_of, thing
from hypothesis import example, given
from hypothesis import strategies as st
from mutations import as_text, damaged, glb, png, reads, trees
from PIL import Image
from strategies import HOSTILE

from eagor.lab.tasks.hstar import open_panorama
from eagor.lab.worlds.glb import export_glb, import_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.painted import painted_room
from eagor.lab.worlds.scene import Material
from eagor.sources.panorama import read_panorama

PIXELS = painted_room(16, 32)
MODES = {
    "PNG": ["RGB", "L", "1", "P", "RGBA", "LA", "I;16"],
    "JPEG": ["RGB", "L", "CMYK", "YCbCr"],
    "TIFF": ["RGB", "L", "1", "P", "RGBA", "LA", "CMYK", "I;16", "F", "LAB"],
    "WEBP": ["RGB", "RGBA"],
}


def encoded(mode="RGB", kind="PNG", **more):
    file = io.BytesIO()
    if mode in ("I;16", "I", "F"):
        grey = PIXELS[..., 0].astype({"I;16": np.uint16, "I": np.int32, "F": np.float32}[mode]) * 257
        image = Image.fromarray(grey)
    else:
        image = Image.fromarray(PIXELS).convert(mode)
    image.save(file, kind, **more)
    return file.getvalue()


PICTURES = [encoded(), encoded(kind="JPEG"), encoded(kind="WEBP"), encoded("P"), encoded("I;16"), encoded(kind="GIF"),
            encoded(kind="BMP"), encoded("CMYK", "TIFF"), encoded("RGBA"), encoded(kind="PPM")]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pictures")


@HOSTILE
@given(damaged(PICTURES))
@example(png(0, 0))
@example(png(2**31 - 1, 2**31 - 1))
def test_pictures(folder, blob):
    path = folder / "pano.bin"
    path.write_bytes(blob)
    image = reads(lambda: read_panorama(path), "pano.bin")
    if image is not None:
        assert image.dtype == np.uint8
        assert image.ndim == 3
        assert image.shape[2] == 3
    open_panorama.cache_clear()
    again = reads(lambda: open_panorama(str(path)), "pano.bin")
    assert (again is None) == (image is None)
    assert image is None or np.array_equal(again, image)


@pytest.mark.parametrize(("kind", "mode"), [(kind, mode) for kind, modes in MODES.items() for mode in modes])
def test_every_mode_is_read_as_colours_or_refused_by_name(folder, mode, kind):
    blob = encoded(mode, kind, **({"lossless": True} if kind == "WEBP" else {}))
    path = folder / f"{mode.replace(';', '')}.{kind.lower()}"
    path.write_bytes(blob)
    image = reads(lambda: read_panorama(path), path.name)
    if image is None:
        assert mode in ("F", "LAB")
        return
    assert mode != "F"
    assert image.shape == PIXELS.shape
    grey = {"L", "1", "LA", "I;16", "I"}
    wanted = PIXELS if mode not in grey else np.repeat(PIXELS[..., :1], 3, axis=-1)
    if mode in ("RGB", "RGBA", "I;16", "I") and kind != "JPEG":
        assert np.array_equal(image, wanted)
    elif mode != "1":
        assert np.abs(image.astype(int) - wanted).mean() < 40  # other colours, coarser colours, but the same picture


# Worlds


def box_scene():
    """A floor and a box on it."""
    materials = (Material("wood", (0.5, 0.4, 0.3)), Material("red", (0.9, 0.1, 0.1)))
    things = [thing("floor", (-2, -2, -0.1), (2, 2, 0)), thing("chair", (0, 0, 0), (1, 1, 1), None, "red")]
    return scene_of(things, materials=materials)


@pytest.fixture(scope="module")
def world(folder):
    """The parts of an exported GLB: its JSON, its binary, and the semantic JSON."""
    path = export_glb(box_scene(), folder / "box.glb")
    blob = path.read_bytes()
    length = int.from_bytes(blob[12:16], "little")
    tree = json.loads(blob[20 : 20 + length])
    return blob, tree, blob[28 + length :], json.loads((folder / "box.semantic.json").read_text())


def looked_at(path):
    scene = reads(lambda: import_glb(path), path.stem)
    if scene is not None:
        assert np.isfinite(scene.vertices).all()
        reads(lambda: Ground.from_scene(scene))
        assert scene.hash


@HOSTILE
@given(st.data())
def test_worlds(folder, world, draw):
    blob, tree, binary, _ = world
    path = folder / "world.glb"
    how = draw.draw(st.sampled_from(["tree", "tree", "bytes"]))
    content = glb(draw.draw(trees([tree])), binary) if how == "tree" else draw.draw(damaged([blob]))
    path.write_bytes(content)
    looked_at(path)


@HOSTILE
@given(st.data())
def test_worlds_as_text(folder, world, draw):
    path = folder / "world.gltf"
    path.write_bytes(as_text(draw.draw(trees([world[1]]))).encode("utf-8", "surrogatepass"))
    looked_at(path)


def test_nodes_below_themselves_are_refused(folder, world):
    tree = json.loads(json.dumps(world[1]))
    for node in tree["nodes"]:
        node.setdefault("children", [])
    tree["nodes"][-1]["children"].append(len(tree["nodes"]) - 1)
    (folder / "loop.glb").write_bytes(glb(tree, world[2]))
    assert reads(lambda: import_glb(folder / "loop.glb"), "loop.glb", "in a cycle") is None


@HOSTILE
@given(st.data())
def test_semantics(folder, world, draw):
    path = folder / "told.glb"
    path.write_bytes(world[0])
    told = draw.draw(trees([world[3]]))
    path.with_suffix(".semantic.json").write_bytes(as_text(told).encode("utf-8", "surrogatepass"))
    looked_at(path)


def test_a_floor_far_below_another_takes_no_room_for_what_is_between():
    scene = box_scene()
    far = scene.vertices.copy()
    far[8:] += np.array([0, 0, 3e9], dtype=np.float32)
    assert Ground.from_scene(replace(scene, vertices=far)).floor == 0.0


@pytest.mark.parametrize("kind", ["jpg", "png", "tiff"])
@pytest.mark.parametrize("tag", range(1, 9))
def test_a_picture_is_turned_and_mirrored_as_its_tag_says(tmp_path, kind, tag):
    """Stored as a camera with this tag stores it, a panorama comes back as it was seen."""
    seen = np.zeros((64, 128, 3), np.uint8)
    seen[8:24, 16:40, 0] = 250
    stored = {
        1: seen, 2: seen[:, ::-1], 3: seen[::-1, ::-1], 4: seen[::-1], 5: seen.swapaxes(0, 1),
        6: np.rot90(seen), 7: seen[::-1, ::-1].swapaxes(0, 1), 8: np.rot90(seen, -1),
    }[tag]  # fmt: skip
    exif = Image.Exif()
    exif[0x0112] = tag
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / f"p.{kind}", exif=exif, quality=95)
    found = read_panorama(tmp_path / f"p.{kind}")
    assert found.shape == seen.shape
    assert np.abs(found.astype(int) - seen).mean() < 3


def test_a_panorama_is_not_stood_on_its_side_by_a_tag(tmp_path):
    lying = np.zeros((64, 128, 3), np.uint8)
    lying[8:24, 16:40] = 250
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(lying).save(tmp_path / "p.png", exif=exif)
    assert np.array_equal(read_panorama(tmp_path / "p.png"), lying)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF data")  # Pillow says so wherever it opens one
def test_a_damaged_tag_changes_nothing(tmp_path):
    lying = np.zeros((64, 128, 3), np.uint8)
    for exif in (b"Exif\0\0II*\0\xff\xff\xff\xff", b"Exif\0\0nothing", b"Exif\0\0"):
        Image.fromarray(lying).save(tmp_path / "p.jpg", exif=exif)
        assert np.array_equal(read_panorama(tmp_path / "p.jpg"), lying)
