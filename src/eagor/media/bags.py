"""ROS 2 bags without ROS: recordings of topics, read from MCAP or SQLite (a folder or one file), and written as MCAP.

A file without an end, as a crash leaves it, is read up to where it breaks off. Reading takes about half a GiB at most,
whatever a file asks for; what would need more is refused (`eagor.media.bag_files`).

Of a recording, a crash takes little: `rosbags` keeps up to a megabyte in memory, and Python the rest of a block, so
chunks are closed often here.
"""

from __future__ import annotations

import os
import threading
import time
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._extras import need
from eagor.errors import EagorError, FormatError, StorageError
from eagor.media.panorama import in_order
from eagor.media.ros_messages import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    IMU,
    NANO,
    ODOMETRY,
    POSE,
    POSE_WITH_COVARIANCE,
    TRANSFORM,
    TRANSFORMS,
    nanoseconds,
    store,
)

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "AT_RISK", "MOTION", "PICTURES", "SUFFIXES", "TF", "TF_STATIC", "Bag", "BagWriter", "bag_topics", "is_bag",
    "listed", "pick", "read_bag", "split_bag",
]  # fmt: skip

SUFFIXES = (".mcap", ".db3")
PACKED = ("file", "message")  # how a recorder compresses beside what MCAP does itself
ZSTANDARD = b"\x28\xb5\x2f\xfd"
ROS_1, ROS_1_SUFFIX = b"#ROSBAG V", ".bag"
PICTURES = (IMAGE, COMPRESSED)
MOTION = (ODOMETRY, POSE, IMU, TRANSFORMS, POSE_WITH_COVARIANCE, TRANSFORM)  # the best first
TF, TF_STATIC = "/tf", "/tf_static"


def read_bag(path: str | Path, topics: Collection[str] | None = None) -> Iterator[tuple[float, str, str, Any]]:
    """(stamp, topic, kind, message) of each message, in order of the time of recording, seconds.

    `topics`: only these. Messages are `rosbags`' dataclasses. Raises `FormatError` as `Bag`, for a topic that the bag
    does not have, and for a type that neither the bag nor ROS 2 defines.
    """
    return Bag(path).messages(topics)


def bag_topics(path: str | Path) -> dict[str, str]:
    """The topics of a bag with their types, such as {"/odom": "nav_msgs/msg/Odometry"}. Raises as `Bag`."""
    return Bag(path).topics


class Bag:
    """A ROS 2 bag: a folder, or one .mcap or .db3 file.

    `topics`: name to type. `counts`: name to number of messages. A recording that was cut off is read as far as it
    goes, with a `UserWarning`. Raises `FormatError` for what is no bag of ROS 2, `MissingExtraError`.
    """

    def __init__(self, path: str | Path) -> None:
        need("reading bags", "robot", "rosbags", "mcap")
        self.path = Path(path)
        self._files = _opened(self.path)
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        for channel, count in ((c, file.counts[number]) for file in self._files for number, c in file.channels.items()):
            known = self.topics.setdefault(channel.topic, channel.kind)
            if known != channel.kind:
                raise FormatError(f"{path}: the topic {channel.topic} has two types, {known} and {channel.kind}")
            self.counts[channel.topic] = self.counts.get(channel.topic, 0) + count
        self.topics = dict(sorted(self.topics.items()))

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[float, str, str, Any]]:
        """As `read_bag`."""
        for topic in topics or ():
            if topic not in self.topics:
                raise FormatError(f"{self.path} has no topic {topic}; it has {listed(self.topics)}")
        return self._messages(topics)

    def _messages(self, topics: Collection[str] | None) -> Iterator[tuple[float, str, str, Any]]:
        for file in self._files:  # a bag of several files was split in time
            decode: dict[int, Any] = {}
            wanted = {key: each for key, each in file.channels.items() if topics is None or each.topic in topics}
            told = file.messages(wanted)
            while wanted:
                try:
                    number, nanos, data = next(told)
                except StopIteration:
                    break
                except Exception as error:  # as the libraries happen to meet the damage
                    raise FormatError(f"{file.path} is damaged ({error}); copy or record it again") from error
                channel, stamp = wanted[number], nanos / NANO
                if data[:4] == ZSTANDARD:  # as no message begins; metadata.yaml says it, where the folder is named
                    raise FormatError(_packed(file.path.parent, "message"))
                if number not in decode:
                    decode[number] = _decoder(self.path, channel)
                try:
                    found = decode[number](data, channel.kind)
                except Exception as error:
                    raise FormatError(
                        f"{self.path}: a message of {channel.topic} at {stamp:.3f} s is no {channel.kind} "
                        f"({type(error).__name__}: {error})"
                    ) from error
                yield stamp, channel.topic, channel.kind, found


def _opened(path: Path) -> list[Any]:
    """The files of a bag, in order of time; of several, those that hold messages. Raises `FormatError`."""
    from eagor.media.bag_files import McapFile, SqliteFile

    files, found, wrong = _files(path), [], []
    for file in files:
        try:
            with file.open("rb") as opened:
                head = opened.read(len(ROS_1))
            if head == ROS_1:
                to = f"rosbags-convert --src {file} --dst {file.with_suffix('')}"
                raise FormatError(f"{file} is a bag of ROS 1; convert it: {to}")
            if not head:
                raise FormatError(f"{file} is empty; a recording that was never begun, or a copy that failed")
            if file.suffix.lower() not in SUFFIXES:
                raise FormatError(
                    f"{file} is no bag of ROS 2; wanted a folder, or a file that ends in {' or '.join(SUFFIXES)}"
                )
            each = (McapFile if file.suffix.lower() == ".mcap" else SqliteFile)(file)
            many = sum(each.counts.values())
            if not many and (each.broken or not each.channels):
                raise FormatError(f"{file} holds no message ({each.broken or 'it is empty'}); record it again")
            if each.broken:
                warnings.warn(
                    f"{file.name} was cut off ({each.broken}); its first {many} messages are read", stacklevel=4
                )
            found.append(each)
        except (OSError, ValueError) as error:
            told = isinstance(error, EagorError)
            wrong.append(str(error) if told else f"{file} cannot be read as a bag ({error}); copy it again")
    if not found:
        raise FormatError(wrong[0])
    for text in wrong:
        warnings.warn(f"a part of {path} is left out: {text}", stacklevel=4)
    return found


def _files(path: Path) -> Sequence[Path]:
    """The file, or those in a folder that its metadata.yaml names; all where that is missing, as after a crash."""
    about = path / "metadata.yaml"
    try:
        if not path.is_dir():
            if not path.is_file():
                raise OSError(ENOENT, "it is a pipe or a device" if path.exists() else "No such file or directory")
            return [path]
        inside = in_order([file for file in path.iterdir() if file.suffix.lower() in SUFFIXES])
        text = about.read_text("utf-8", "replace") if about.is_file() else ""
    except OSError as error:
        wanted = "give a ROS 2 bag: a folder, .mcap or .db3"
        raise FormatError(f"{path} cannot be read ({error.strerror}); {wanted}") from error
    if text:
        from ruamel.yaml import YAML

        try:
            told = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
            packed = told.get("compression_mode", "").lower()
            named = [] if packed in PACKED else [path / Path(name).name for name in told["relative_file_paths"]]
        except Exception as error:  # the library's, or those of another shape
            raise FormatError(f"{about} is not that of a bag ({type(error).__name__}: {error})") from error
        if packed in PACKED:
            raise FormatError(_packed(path, packed))
        if missing := [file.name for file in named if not file.is_file()]:
            raise FormatError(f"{path} lacks {', '.join(missing)}, which {about.name} names; copy the whole folder")
        inside = named
    if not inside:
        if any(path.glob("*.zstd")):
            raise FormatError(
                f"{path} is compressed by file, and lacks metadata.yaml; unpack it: zstd -d {path}/*.zstd"
            )
        raise FormatError(f"{path} holds no bag: no metadata.yaml, no {' or '.join(SUFFIXES)} file")
    return inside


def _packed(folder: Path, how: str) -> str:
    to = f"rosbags-convert --src {folder} --dst {folder.name}-unpacked"
    return f"{folder} is compressed by {how}; unpack it: {to}"


def _decoder(path: Path, channel: Any) -> Any:
    """What decodes the messages of a topic: our types where they are the same, else those that the bag defines."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    known, kind, text = store(), channel.kind, channel.definition
    if not text and kind not in known.fielddefs:
        raise FormatError(
            f"{path}: {channel.topic} is of type {kind}, which neither the bag nor ROS 2 Humble defines; record it as "
            "MCAP, which keeps the definitions"
        )
    types: dict[str, Any] = {}
    try:
        if text and channel.encoding == "ros2idl":
            for part in filter(None, text.split("=" * 80 + "\n")):
                types |= get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part)
        elif text:
            types = get_types_from_msg(text, kind)
        if all(name in known.fielddefs and known.fielddefs[name][1] == about[1] for name, about in types.items()):
            return known.deserialize_cdr
        for name, about in types.items() if kind in (*PICTURES, *MOTION, CAMERA_INFO) else ():
            if lost := [
                field for field, told in known.fielddefs.get(name, ((), ()))[1] if (field, told) not in about[1]
            ]:
                raise ValueError(f"it has not the {lost[0]} of ROS 2's {name}")
        own = get_typestore(Stores.EMPTY)
        own.register({name: about for name, about in types.items() if name not in own.fielddefs})
        return own.deserialize_cdr
    except Exception as error:  # the library's, or what it does not expect
        raise FormatError(f"{path}: the definition of {kind} cannot be read ({error})") from error


# --- paths ---


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Whether `path` looks like a bag: a file by its name, a folder by what is in it."""
    path = Path(path)
    try:
        if path.is_dir():
            return (path / "metadata.yaml").is_file() or any(file.suffix.lower() in SUFFIXES for file in path.iterdir())
        return path.suffix.lower() in (*SUFFIXES, ROS_1_SUFFIX)
    except OSError:
        return False


def split_bag(text: str) -> tuple[str, str | None]:
    """Path and topic of ``BAG`` or ``BAG?topic=/image``."""
    place, found, topic = text.partition("?topic=")
    return (place, topic) if found and not os.path.exists(text) else (text, None)


def listed(topics: Mapping[str, str]) -> str:
    """Topics and their types in words."""
    return ", ".join(f"{name} ({kind})" for name, kind in topics.items()) or "none"


# --- recording ---


AT_RISK = 1.0  # seconds of a recording that a crash may take


class BagWriter:
    """Records messages into the new folder `path`, a ROS 2 bag in MCAP; a context manager, safe to use from threads.

    After a crash, all can be read that was written `at_risk` seconds before the last message. Raises `StorageError`
    where it cannot be written any more (it is closed then), or is there already, `FormatError` for an unknown type.
    """

    def __init__(self, path: str | Path, *, at_risk: float = AT_RISK) -> None:
        need("recording", "robot", "rosbags")
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.rosbag2.errors import WriterError

        self.path, self._at_risk = Path(path), at_risk
        self._lock = threading.Lock()
        self._topics: dict[str, tuple[str, Any]] = {}
        self._kept, self._fresh = time.monotonic(), False
        try:
            self._writer: Any = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except WriterError as error:
            raise StorageError(f"{path} is there already; name a new folder for the recording") from error
        except OSError as error:
            raise StorageError(f"{path} cannot be made ({error.strerror}); name another folder") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, kind: str, message: Any, stamp: float) -> None:
        """Record `message` of the ROS 2 type `kind` (a `rosbags` dataclass) under `topic` at `stamp`, seconds."""
        if kind not in store().fielddefs:
            raise FormatError(f"{kind!r} is no known ROS 2 type; wanted one such as sensor_msgs/msg/Imu")
        try:
            data, nanos = store().serialize_cdr(message, kind), nanoseconds(stamp)
        except EagorError:
            raise
        except Exception as error:
            raise FormatError(f"{topic}: the message is no {kind} ({type(error).__name__}: {error})") from error
        with self._lock:
            if self._writer is None:
                raise StorageError(f"the recording {self.path} is closed")
            if topic not in self._topics:
                self._topics[topic] = kind, self._writer.add_connection(topic, kind, typestore=store())
            known, connection = self._topics[topic]
            if known != kind:
                raise FormatError(f"{topic} was recorded as {known}, and now as {kind}; use two topics")
            with self._told():
                self._writer.write(connection, nanos, data)
                self._fresh = True
                if time.monotonic() - self._kept >= self._at_risk:
                    self._flush()

    def flush(self) -> None:
        """Hand all that was written over to the system: no crash of this process takes it then."""
        with self._lock, self._told():
            self._flush()

    def close(self) -> None:
        """Write the index. May be called twice."""
        with self._lock:
            if self._writer is not None:
                with self._told():
                    self._writer.close()
                self._writer = None

    def _flush(self) -> None:
        if self._writer is not None and self._fresh:
            self._writer.storage.close_chunk()
            self._writer.storage.bio.flush()
            self._fresh = False
        self._kept = time.monotonic()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn the system's errors into ours. They end the recording: nothing after half a chunk could be read."""
        try:
            yield
        except OSError as error:
            with suppress(Exception):
                self._writer.abort()
            self._writer = None
            raise StorageError(
                f"the recording {self.path} cannot be written ({error.strerror}); what was written before is intact"
            ) from error


def pick(
    topics: Mapping[str, str],
    kinds: Sequence[str],
    asked: str | None,
    *,
    where: str,
    option: str,
    error: type[EagorError] = FormatError,
) -> tuple[str, str]:
    """The topic `asked` for, or the only one of the first of `kinds` that there is; with its type.

    Of an Image and a CompressedImage with the same pictures (``name``, ``name/compressed``) the first kind is taken.
    `where` ("the bag x.mcap") and `option` ("--image-topic") are for the text of the error: the topic is not there, has
    another type, or there are several.
    """
    has = f"{where} has {listed(topics)}"
    if asked is not None:
        name = asked if asked.startswith("/") else f"/{asked}"
        if name not in topics:
            raise error(f"{where} has no topic {name}; it has {listed(topics)}")
        if topics[name] not in kinds:
            raise error(f"{name} is of type {topics[name]}; wanted {' or '.join(kinds)}. {has}")
        return name, topics[name]
    others = (TF_STATIC, "/compressedDepth", "/goal_pose", "/initialpose")  # none by itself: what it is not about
    fit = [(name, kind) for name, kind in topics.items() if kind in kinds and not name.endswith(others)]
    if not fit:
        raise error(f"{where} has no topic of type {' or '.join(kinds)}; it has {listed(topics)}")
    kind = next(kind for kind in kinds if any(each[1] == kind for each in fit))
    found = [name for name, its in fit if its == kind]
    if set(kinds) == set(PICTURES):
        base = {name.removesuffix("/compressed") for name, _ in fit}
        found = found if len(base) == 1 else sorted(base)
    if len(found) > 1:
        raise error(f"{where} has several topics that fit: {', '.join(found)}; say which one with {option}")
    return found[0], kind
