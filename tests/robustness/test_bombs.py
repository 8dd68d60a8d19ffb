"""What a file may ask for is bounded by what it holds: pictures and GLB files.

And no file is ever handed to another program.
"""

import io
import os
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from mutations import glb, png, reads
from PIL import Image
from processes import limited

from eagor.errors import ImageError, WorldError
from eagor.lab.tasks.hstar import open_panorama
from eagor.lab.worlds.glb import import_glb
from eagor.sources.panorama import read_panorama


def patch(corners):
    """A strip of triangles with so many corners: the JSON and the binary of a GLB with one node."""
    points = np.zeros((corners, 3), np.float32)
    points[:, 0], points[::2, 2] = np.arange(corners) / corners, 1
    first = np.arange(corners - 2, dtype=np.uint32)
    faces = np.stack([first, first + 1, first + 2], axis=1)
    binary = points.tobytes() + faces.tobytes()
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes},
        {"buffer": 0, "byteOffset": points.nbytes, "byteLength": faces.nbytes},
    ]
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": corners, "type": "VEC3",
             "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }, binary  # fmt: skip


def with_pictures(images, textures):
    """`patch` with so many materials, each with a texture: the number of one of the `images` (encoded)."""
    tree, binary = patch(4)
    for blob in images:
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(blob)})
        binary += blob
    tree["buffers"] = [{"byteLength": len(binary)}]
    tree["images"] = [{"bufferView": 2 + number, "mimeType": "image/png"} for number in range(len(images))]
    tree["textures"] = [{"source": source} for source in textures]
    tree["materials"] = [
        {"name": f"m{index}", "pbrMetallicRoughness": {"baseColorTexture": {"index": index}}}
        for index in range(len(textures))
    ]
    (primitive,) = tree["meshes"][0]["primitives"]
    tree["meshes"] = [{"primitives": [primitive | {"material": index}]} for index in range(len(textures))]
    tree["nodes"] = [{"mesh": index} for index in range(len(textures))]
    tree["scenes"] = [{"nodes": list(range(len(textures)))}]
    return tree, binary


def flat_png(width, height, mode="RGB"):
    file = io.BytesIO()
    Image.new(mode, (width, height)).save(file, "PNG")
    return file.getvalue()


def nodes_with_a_mesh(tree):
    tree["nodes"] = [{"mesh": 0}] * 5000
    tree["scenes"] = [{"nodes": list(range(5000))}]


def accessors_without_data(tree):
    tree["accessors"] += [{"componentType": 5126, "count": 9_000_000, "type": "VEC3"}] * 200


def primitives_with_the_same_corners(tree):
    tree["meshes"] = [{"primitives": tree["meshes"][0]["primitives"] * 5000}]


def nest(tree):
    tree["nodes"] = [{"children": [index + 1]} for index in range(60_000)] + [{"mesh": 0}]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (nodes_with_a_mesh, "ask for .* corners"),
        (accessors_without_data, "ask for .* corners"),
        (primitives_with_the_same_corners, "ask for .* corners"),
        (nest, "nested more than 256 deep"),
    ],
)
def test_a_world_that_asks_for_more_than_it_holds(tmp_path, change, says):
    tree, binary = patch(2000)
    change(tree)
    (tmp_path / "bomb.glb").write_bytes(glb(tree, binary))
    with pytest.raises(WorldError, match=says):
        import_glb(tmp_path / "bomb.glb")


def test_a_world_may_use_its_parts_again(tmp_path):
    tree, binary = patch(200)
    tree["nodes"] = [{"mesh": 0}] * 50
    tree["scenes"] = [{"nodes": list(range(50))}]
    (tmp_path / "parts.glb").write_bytes(glb(tree, binary))
    assert len(import_glb(tmp_path / "parts.glb").instances) == 50


def test_a_picture_that_is_used_twelve_times_is_decoded_once(tmp_path):
    (tmp_path / "shared.glb").write_bytes(glb(*with_pictures([flat_png(512, 512)], [0] * 12)))
    textures = [material.texture for material in import_glb(tmp_path / "shared.glb").materials]
    assert len(textures) == 12
    assert all(np.shares_memory(texture, textures[0]) for texture in textures)


def eps(size=32):
    file = io.BytesIO()
    Image.new("RGB", (size, 2 * size)).save(file, "EPS")
    return file.getvalue()


def test_no_other_program_is_asked_to_read_a_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a program is started"))
    (tmp_path / "pano.png").write_bytes(eps())
    for read in (read_panorama, lambda path: open_panorama(str(path))):
        with pytest.raises(ImageError, match="cannot be read"):
            read(tmp_path / "pano.png")
    (tmp_path / "eps.glb").write_bytes(glb(*with_pictures([eps()], [0])))
    reads(lambda: import_glb(tmp_path / "eps.glb"), "eps.glb")


def sixteen_bits(side):
    """A grey PNG of 16 bits that shows nothing."""
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(b"\0" * (1 + 2 * side)) for _ in range(side)) + packer.flush()
    return png(side, side, 16, 0, rows)


def test_grey_of_sixteen_bits_is_rounded_to_eight(tmp_path):
    grey = np.arange(65536, dtype=np.uint16).reshape(256, 256).repeat(2, axis=1)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    wanted = np.rint(grey / 257).astype(np.uint8)
    assert np.array_equal(read_panorama(tmp_path / "grey.png"), np.repeat(wanted[..., None], 3, axis=-1))


IMPORTS = """
import numpy, trimesh
from eagor.errors import EagorError
from eagor.lab.worlds.glb import import_glb
from eagor.sources.panorama import read_panorama
from eagor.perception.records import parse_record
"""
READERS = """
readers = {"a.glb": import_glb, "b.glb": import_glb, "d.png": read_panorama,
           "e.png": read_panorama, "f.jpg": read_panorama}
for name, read in readers.items():
    try:
        read(folder / name)
    except EagorError as error:
        assert "MemoryError" not in str(error), error
        print(error)
line = '{"stamp": 1, "image": {"width": 65536, "height": 32768}, "boxes": [{"box": [10, 10, 900, 900]}]}'
print(numpy.asarray(parse_record(line).evidence("x").coefficients(5)).shape)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory as Linux does")
def test_bombs_take_no_room(tmp_path):
    tree, binary = patch(20_000)
    nodes_with_a_mesh(tree)
    (tmp_path / "a.glb").write_bytes(glb(tree, binary))
    (tmp_path / "b.glb").write_bytes(glb(*with_pictures([flat_png(8000, 8000)], [0] * 12)))
    (tmp_path / "d.png").write_bytes(sixteen_bits(9000))
    (tmp_path / "e.png").write_bytes(png(12_000, 12_000))
    jpeg = io.BytesIO()
    Image.new("RGB", (32, 16)).save(jpeg, "JPEG")
    claims = bytearray(jpeg.getvalue())
    at = claims.index(b"\xff\xc0")
    claims[at + 5 : at + 9] = struct.pack(">HH", 12_000, 14_000)
    (tmp_path / "f.jpg").write_bytes(claims)
    printed = limited(IMPORTS, READERS, tmp_path, 400)
    assert len(printed) == 6, printed


SPREAD = """
import math, resource, numpy as np
from eagor.evidence.calibration import Calibration
from eagor.evidence import Evidence
from eagor.grids import PatchGrid, PerspectiveGrid

Evidence.from_response(np.eye(90, 180), PatchGrid(90, 180), Calibration(spread=0.2)).coefficients(3)  # imports
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + (700 << 20), resource.RLIM_INFINITY))
sharp = Calibration(spread=math.radians(1), temperature=6.0, floor=0.1)
for grid in (PatchGrid(90, 180), PerspectiveGrid(48, 64, 1.6, np.eye(3)), PerspectiveGrid(3, 4, 2.6, np.eye(3))):
    found = Evidence.from_response(np.eye(*grid.shape), grid, sharp).coefficients(15)
    assert np.isfinite(found).all()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory as Linux does")
def test_a_small_spread_takes_no_more_room_than_a_picture():
    done = subprocess.run(
        [sys.executable, "-c", SPREAD],
        capture_output=True, text=True, timeout=600, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
