"""Damaged samples of what people have, for as long as one likes: answers, poses, calibrations, GPano, bags.

    .venv/bin/python tests/robustness/fuzz.py --minutes 60 [--kinds answers bags] [--first NUMBER]

Each input may give an answer, in which every number can be, or an `EagorError`, within seconds of CPU time and bounded
memory, and may warn by `UserWarning` alone. What else happens is printed with the number of its case, once for each
place; the exit code is 1 then. ``--kinds KIND --first NUMBER --minutes 0`` tries that case again.
"""

import argparse
import ast
import faulthandler
import json
import random
import re
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
from PIL import Image

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), *(str(TESTS / part) for part in ("oracles", "laws", "contracts"))]
import test_camera_files as cameras  # noqa: E402
import test_pose_files as trajectories  # noqa: E402
from contract_server import ContractServer  # noqa: E402
from rosmaking import camera_info, cdr, imu_message, pose_message  # noqa: E402
from test_bad_bags import chunk, finished, record, text  # noqa: E402
from test_bags import databased  # noqa: E402
from test_photographs import area, xmp  # noqa: E402
from test_rig_files import GOOD  # noqa: E402
from test_videos import SPOKEN  # noqa: E402

from eagor.errors import EagorError  # noqa: E402
from eagor.grids import ErpGrid  # noqa: E402
from eagor.odometry.axes import AXES, settled  # noqa: E402
from eagor.odometry.files import interpolated, pair, read_poses, usable  # noqa: E402
from eagor.perception.endpoint import EndpointPerception  # noqa: E402
from eagor.perception.vlm.answers import parse_boxes, parse_presence  # noqa: E402
from eagor.perception.vlm.perception import box_detections  # noqa: E402
from eagor.sources import Pose  # noqa: E402
from eagor.sources import ros_messages as m  # noqa: E402
from eagor.sources.bags import MAGIC, MOTION, PICTURES, Bag  # noqa: E402
from eagor.sources.camera_sources import FrameCheck  # noqa: E402
from eagor.sources.intrinsics import intrinsics_from_exif, read_camera  # noqa: E402
from eagor.sources.rigs import read_rig  # noqa: E402
from eagor.sources.ros_sources import BagCamera, BagPoses  # noqa: E402
from eagor.sources.video import Video  # noqa: E402

SECONDS, MEMORY = 5.0, 3 << 30  # of CPU for one input; bytes above what the samples take
ODD = [b"0", b"-1", b"1", b"-0.0", b"0.5", b"360", b"1e308", b"-1e308", b"1e-320", b"1e400", b"nan", b"inf", b"-inf",
       b".nan", b".inf", b"9" * 320, b"9" * 5000, b"1_0", b"0x10", b"4294967296", b"-2147483649", b"1" + b"0" * 30,
       "٣".encode(), "²".encode(), "１２".encode(), b"true", b"null", b"[]", b"{}", b"~", b"", b"''", b"\0", b"\xff",
       "\u2028".encode(), b"\xed\xa0\x80", b"&a ", b"*a", b"!!binary ", b"<!DOCTYPE a>", b"<<: ", b"---\n"]  # fmt: skip
BITS = [struct.pack(f"<{form}", value) for form, values in (
    ("d", (np.nan, np.inf, 1e308, -1e308, 0, 1e-320, -1)), ("f", (np.nan, 3e38)), ("I", (0, 1, 2**31, 2**32 - 1)),
    ("Q", (0, 2**63, 2**64 - 1)), ("H", (0, 2**16 - 1))) for value in values]  # fmt: skip
NUMBER = re.compile(rb"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?")
TOKEN = re.compile(rb"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?|[A-Za-z_]\w*|\s+|[\x80-\xff]+|.", re.DOTALL)
CODES = ("utf-16", "utf-16-be", "utf-32", "utf-8-sig", "latin-1", "cp1252", "shift_jis")


def changed(data, draw, others):
    """`data` with up to six changes: of bytes, of words and numbers, their order and nesting, or of the encoding."""
    for _ in range(draw.randint(1, 6)):
        at, how = draw.randint(0, len(data)), draw.randrange(16)
        end = min(len(data), at + draw.choice((1, 2, 4, 8, 30)))
        found = [*(NUMBER if how < 4 else TOKEN).finditer(data[:20000])] if how < 7 else []
        if found:  # a number, or any word: becomes odd, or another, or goes
            (at, end), (one, other) = draw.choice(found).span(), draw.choice(found).span()
            data = data[:at] + draw.choice((draw.choice(ODD), draw.choice(ODD), data[one:other], b"")) + data[end:]
        elif how == 7:
            bits, at = draw.choice(BITS), at - at % 4
            data = data[:at] + bits + data[at + len(bits) :]
        elif how == 8:
            odd = draw.choice(ODD) + data[at:end]
            data = data[:at] + draw.choice((draw.randbytes(end - at), b"", odd)) + data[end:]
        elif how == 9:
            data = data[:at] + data[at:end] * draw.choice((2, 2, 3, 300)) + data[end:]
        elif how == 10:
            data = data[:at] + draw.choice((b"", draw.choice(others)[draw.randint(0, 200) :]))
        elif how == 11 and draw.random() < 0.3:
            data = data.decode("utf-8", "replace").encode(draw.choice(CODES), "replace")
        elif how == 12:
            data = data.replace(b"\n", draw.choice((b"\r\n", b"\r", b"\n\n", b"\0", b"\x0b", b" ")))
        elif how == 13:
            depth, (left, right) = draw.choice((1, 2, 45, 3000)), draw.choice((b"[]", b"{}", b"()", b'""', b"<>"))
            data = data[:at] + bytes([left]) * depth + data[at:end] + bytes([right]) * depth + data[end:]
        elif how == 14:
            data = b"\n".join(draw.sample(lines := data.split(b"\n"), len(lines)))
        elif at < len(data):
            data = data[:at] + bytes([data[at] ^ 1 << draw.randrange(8)]) + data[at + 1 :]
    return data[: 1 << 20]


# --- kinds: what is read of an input; each gives what has to be finite ---


def tried(read, *given, **named):
    """What `read` gives; None where it refuses."""
    with suppress(EagorError):
        return read(*given, **named)


def answers(data, draw, folder):
    said = data.decode("utf-8", "replace")
    size, tokens = draw.choice(((448, 896), (1, 1))), [(piece, -0.5) for piece in said[:300]]
    for frame, order in (("pixels", "xyxy"), ("thousand", "yxyx"), ("percent", "xyxy"), ("unit", "xyxy")):
        found = tried(parse_boxes, said, frame, size, order, tokens if draw.random() < 0.3 else None) or []
        assert all(0 <= b.x0 < b.x1 <= 1 and 0 <= b.y0 < b.y1 <= 1 and 0 <= b.score <= 1 for b in found), found
        yield from ((each.direction, each.covariance) for each in box_detections(found[:20], ErpGrid(*size)))
    yield 0.0 if (presence := tried(parse_presence, said, tokens)) is None else presence
    whole = {"choices": [{"message": {"content": said}, "finish_reason": "stop"}]}
    SERVER.sent = data if data.lstrip()[:1] == b"{" else json.dumps(whole).encode()
    if draw.random() < 0.1 and (seen := tried(draw.choice(ASKING), np.zeros((56, 112, 3), np.uint8), "chair")):
        yield seen.log_ratio


def poses(data, draw, folder):
    (path := folder / "poses.txt").write_bytes(data)
    found = read_poses(path)
    assert [each.stamp for each in found] == sorted({each.stamp for each in found}), "the stamps do not rise"
    for axes in ("auto", *AXES):
        if made := tried(settled, found, axes, "poses.txt", None, len):
            turns = np.array([each.world_R_body for each in made])
            assert np.allclose(turns @ turns.swapaxes(1, 2), np.eye(3), atol=1e-6), "no rotations"
            yield [each.stamp for each in made]
        if made and (near := tried(usable, made, "poses.txt")):
            yield [each.position for each in near if each.position is not None]
            yield interpolated(near)(draw.uniform(near[0].stamp, near[-1].stamp))[0]
    tried(pair, found, [Path(each.frame or "a.png") for each in found])


def calibrations(data, draw, folder):
    (path := folder / draw.choice(("camera.yaml", "camera.yaml", "cameras.txt"))).write_bytes(data)
    for rig in filter(None, (tried(read_camera, path), tried(read_rig, path))):
        yield rig.rows
        for lens in rig.lenses:
            assert min(lens.reach, lens.pixels_per_radian) > 0, lens
            yield lens.unproject(*np.random.default_rng(0).uniform(0, 1, (2, 50)) * np.reshape(rig.sizes[0], (2, 1)))
            yield lens.project(ErpGrid(8, 16).directions)


def gpano(data, draw, folder):
    path = folder / "picture.jpg"
    path.write_bytes(data)
    if data[4:8] == b"ftyp" or data[:4] == b"\x1aE\xdf\xa3":
        video = Video(path, rows=32)
        yield [frame.stamp for frame in tried(lambda: [*video]) or ()]
        if video.level_R_body is not None:
            yield video.level_R_body
        return
    if data[:2] != b"\xff\xd8":
        shape = draw.choice(((64, 32), (60, 20), (32, 32), (1, 1)))
        Image.new("RGB", shape).save(path, "jpeg", xmp=data[:60000])
    found = FrameCheck(draw.random() < 0.5).read(path)
    assert (found.picture.dtype, found.picture.ndim) == (np.uint8, 3)
    yield from (each for each in (found.level_R_body,) if each is not None)
    yield intrinsics_from_exif(path).focal or 0.0


def bags(data, draw, folder):
    for old in folder.iterdir():
        old.unlink()
    wal = data[:3] == b"\x37\x7f\x06"  # what a recorder that was killed left beside the file
    for name, content in (("bag.db3-wal", data), ("bag.db3", BAGS[0])) if wal else (("bag.db3", data),):
        (folder / name).write_bytes(content)
    path = folder / "bag.db3"
    bag = Bag(path.rename(folder / "bag.mcap") if data.startswith(MAGIC[:4]) else path)
    yield [stamp for stamp, *_ in tried(lambda: [*bag.messages()]) or ()]
    for topic, kind in bag.topics.items():
        shown = lambda topic=topic: [(stamp, made()) for stamp, made in BagCamera(bag, topic).pictures()]  # noqa: E731
        for stamp, picture in (kind in PICTURES and tried(shown)) or ():
            assert (picture.dtype, picture.ndim) == (np.uint8, 3)
            yield stamp
        for pose in (kind in MOTION and tried(lambda topic=topic: [*BagPoses(bag, topic, camera=LENS)])) or ():
            yield pose.stamp, pose.world_R_body, 0.0 if pose.position is None else pose.position
            assert np.allclose(pose.world_R_body @ pose.world_R_body.T, np.eye(3), atol=1e-6), "no rotation"


# --- samples ---


def literals(path):
    """The texts in a file of tests."""
    nodes = [node for node in ast.walk(ast.parse((TESTS / path).read_text("utf-8"))) if isinstance(node, ast.Constant)]
    return [node.value.encode("utf-8", "replace") for node in nodes if isinstance(node.value, str) and node.value[5:]]


LENS = "lens_optical_frame"


def messages():
    """Time, topic, type and message of a few moments."""
    lens = m.transform_message(0.0, "base_link", LENS, np.eye(3), (0.1, 0, 0.5))
    told = [("/tf_static", m.TRANSFORMS, m.transforms_message(lens))]
    for k in range(3):
        pose, grey = Pose(100.0 + k, trajectories.TURNS[k], trajectories.PLACES[k]), np.full((6, 12, 3), 90, np.uint8)
        step = m.transform_message(pose.stamp, "odom", "base_link", pose.world_R_body, pose.position)
        told += [
            ("/image", m.IMAGE, m.image_message(grey, pose.stamp, LENS)),
            ("/narrow/image", m.IMAGE, m.image_message(grey[:, :8], pose.stamp, LENS)),
            ("/narrow/camera_info", m.CAMERA_INFO, camera_info((8, 6), (7, 7, 4, 3), (0.1, 0, 0, 0, 0))),
            ("/packed", m.COMPRESSED, m.compressed_message(grey, pose.stamp, LENS)),
            ("/odom", m.ODOMETRY, m.odometry_message(pose)), ("/pose", m.POSE, pose_message(pose)),
            ("/imu", m.IMU, imu_message(pose)), ("/tf", m.TRANSFORMS, m.transforms_message(step)),
        ]  # fmt: skip
    return [(float(at), *each) for at, each in enumerate(told)]


def recorded():
    """The bytes of bags: SQLite and what is in its ``-wal``; MCAP without an index, and with one, and a chunk."""
    parts, topics, told = b"", {}, messages()
    with tempfile.TemporaryDirectory() as place:
        databased(Path(place, "bag.db3"), told, "WAL", told)
        yield from (Path(place, name).read_bytes() for name in ("bag.db3", "bag.db3-wal"))
    for at, topic, kind, message in told:
        if topic not in topics:
            number = topics[topic] = len(topics) + 2
            definition = m.store().generate_msgdef(kind, ros_version=2)[0] if kind in (m.POSE, m.IMAGE) else ""
            parts += record(3, struct.pack("<H", number) + text(kind) + text("ros2msg") + text(definition))
            parts += record(4, struct.pack("<HH", number, number) + text(topic) + text("cdr") + text(""))
        parts += record(5, struct.pack("<HIQQ", topics[topic], 0, int(at), int(at)) + cdr(kind, message))
    yield from (MAGIC + record(1, text("ros2") + text("")) + parts, finished(chunk(len(parts), parts, "")))


BAGS = [*recorded()]
MODELS = (("plumb_bob", cameras.PLUMB), ("equidistant", cameras.ROUND))
CAMERAS = [
    getattr(cameras, name).format(matrix=cameras.MATRIX, model=model, values=[*values], count=len(values)).encode()
    for name in ("ROS", "ECHO", "KALIBR")
    for model, values in MODELS
]
with tempfile.TemporaryDirectory() as place:
    for ending in ("yml", "xml", "json"):
        CAMERAS.append(cameras.written_by_opencv(Path(place, f"a.{ending}"), cameras.PLUMB).read_bytes())
ANGLES = b"stamp,yaw_deg,pitch_deg,roll_deg,frame\n0.5,0,2,3,a_0.png\n1.5,9,2,3,a_1.png\n2,20,2,-3,a_2.png\n"
SERVED = [
    b'{"choices": [{"message": {"content": [{"type": "text", "text": "[[1, 2, 30, 40]]"}]}, "usage": {}}]}',
    b'{"choices": [{"message": {"content": null, "reasoning_content": "so\\n\\n[[1, 2, 30, 40]]"}}], "usage": {}}',
    b'{"error": {"message": "too many requests", "code": 429}}',
    b'{"choices": [{"message": {"content": "yes"}, "logprobs": {"content": [{"token": "yes", "logprob": -0.1, '
    b'"top_logprobs": [{"token": "no", "logprob": -2}]}]}}]}',
]
KINDS = {
    "answers": (answers, [*literals("laws/test_vlm_parts.py"), *SERVED]),
    "poses": (poses, [*map(str.encode, (*trajectories.FORMS.values(), *trajectories.WRITTEN.values())), ANGLES]),
    "calibrations": (calibrations, [*CAMERAS, GOOD.encode(), b"# List\n1 OPENCV 64 48 50 51 32 24 -0.3 0.1 0.001 0\n"]),
    "gpano": (gpano, [xmp(PoseHeadingDegrees=30, PosePitchDegrees=-5, PoseRollDegrees=8), xmp(**area(32, 16, 8, 8)),
                      xmp(**area(60, 20, 2, 6, FullPanoWidthPixels=64, FullPanoHeightPixels=32)), *SPOKEN]),
    "bags": (bags, BAGS),
}  # fmt: skip


# --- the hour ---


class Slow(BaseException):
    """No `except Exception` keeps it."""


def slow(*_):
    raise Slow(f"more than {SECONDS} s")


def fault(kind, number, folder):
    """What went wrong with a case, and where; None if nothing did."""
    read, samples = KINDS[kind]
    draw = random.Random(f"{kind} {number}")
    data = changed(draw.choice(samples), draw, samples)
    faulthandler.dump_traceback_later(60 * SECONDS, exit=True)  # where no signal is heard
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            for each in read(data, draw, folder):
                for part in each if isinstance(each, tuple | list) else (each,):
                    assert np.isfinite(part).all(), f"not finite: {part}"
        except EagorError as error:
            if len(str(error)) > 3000:
                return f"an error of {len(str(error))} characters", ""
        except (Exception, Slow) as error:
            frames = traceback.extract_tb(error.__traceback__)
            own = [frame for frame in frames if "/eagor/" in frame.filename] or frames
            return f"{type(error).__name__} {str(error)[:300]}", f"{own[-1].filename}:{own[-1].lineno}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    other = next((each for each in said if not issubclass(each.category, UserWarning)), None)
    return other and (f"{other.category.__name__} {other.message}", f"{other.filename}:{other.lineno}")


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--minutes", type=float, default=60.0)
    options.add_argument("--kinds", nargs="+", choices=KINDS, default=[*KINDS])
    options.add_argument("--first", type=int, default=0)
    given = options.parse_args()
    faulthandler.enable()
    signal.signal(signal.SIGPROF, slow)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.RLIM_INFINITY))
    places = {}
    with tempfile.TemporaryDirectory(prefix="eagor-fuzz-") as place:
        for kind in given.kinds:
            (folder := Path(place, kind)).mkdir()
            end, number = time.monotonic() + 60 * given.minutes / len(given.kinds), given.first
            while number == given.first or time.monotonic() < end:
                Path(place, "last").write_text(f"{kind} {number}")  # the one that ends the process, if one does
                if (found := fault(kind, number, folder)) and found[1] not in places:
                    places[found[1]] = found
                    print(f"{kind} {number}: {found[0]} ({found[1]})", flush=True)
                number += 1
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
            print(f"{kind}: {number - given.first} cases, up to {most} MiB of memory", flush=True)
    return bool(places)


class Serving(ContractServer):
    """Answers what was put into `sent`."""

    sent = b""

    def _write(self, handler, status, raw, kind):
        super()._write(handler, status, self.sent, kind)


if __name__ == "__main__":
    with Serving(lambda request: "[]") as SERVER:
        about = {"retries": 0, "seam": False, "pixels": 112 * 112, "frame": "pixels", "cell": 28, "backoff": 0.001}
        ASKING = [EndpointPerception("qwen", SERVER.url, **about, **more) for more in (
            {}, {"extractor": "views"}, {"extractor": "views", "per_view": "boxes"})]  # fmt: skip
        sys.exit(main())
