"""ROS 2 bags without ROS: recordings of topics, read from MCAP or SQLite (a folder or one file), and written as MCAP.

`rosbags` reads them. Of an MCAP file without an end, as a crash leaves it, a copy of its whole chunks is read; of an
SQLite file with a journal beside it, one into which that is folded.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
import threading
import time
import warnings
import weakref
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eagor._extras import require_extra
from eagor.errors import EagorError, FormatError, StorageError
from eagor.sources.panorama import in_order
from eagor.sources.ros_messages import CAMERA_INFO, MOTION, NANO, PICTURES, nanoseconds, store

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "AT_RISK", "MAGIC", "MOTION", "PICTURES", "SUFFIXES", "TF", "TF_STATIC", "Bag", "BagWriter", "is_bag",
    "listed", "pick", "read_bag", "split_bag",
]  # fmt: skip

SUFFIXES = (".mcap", ".db3")
MAGIC, ROS_1, ROS_1_SUFFIX = b"\x89MCAP0\r\n", b"#ROSBAG V", ".bag"
ZSTANDARD = b"\x28\xb5\x2f\xfd"  # as no message begins: a recorder compresses by message, too
DEFINITIONS = ("ros2msg", "ros2idl", "omgidl")  # of types, that `rosbags` reads
MOST = 1 << 28  # bytes of a record of a file that was cut off, which may claim any
TF, TF_STATIC = "/tf", "/tf_static"


def read_bag(path: str | Path, topics: Collection[str] | None = None) -> Iterator[tuple[float, str, str, Any]]:
    """(stamp, topic, kind, message) of each message, in order of the time of recording, seconds.

    `topics`: only these. Messages are `rosbags`' dataclasses. Raises `FormatError` as `Bag`, for a topic that the bag
    does not have, and for a type that neither the bag nor ROS 2 defines.
    """
    return Bag(path).messages(topics)


class Bag:
    """A ROS 2 bag: a folder, or one .mcap or .db3 file.

    `topics`: name to type. `counts`: name to number of messages. A recording that was cut off is read as far as it
    goes, with a `UserWarning`. Raises `FormatError` for what is no bag of ROS 2, `MissingExtraError`.
    """

    def __init__(self, path: str | Path) -> None:
        require_extra("reading bags", "robot", "rosbags", "mcap")
        self.path = Path(path)
        self.topics: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self._files: list[Path] = []  # or whole copies of them
        wrong = []
        for file in _files(self.path):
            try:
                self._open(file)
            except Exception as error:  # ours, or as the libraries happen to meet the damage
                known = isinstance(error, EagorError)
                wrong.append(str(error) if known else f"{file} cannot be read as a bag ({error}); copy it again")
        if not self._files:
            raise FormatError(wrong[0])
        for text in wrong:
            warnings.warn(f"a part of {path} is left out: {text}", stacklevel=3)
        self.topics = dict(sorted(self.topics.items()))

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[float, str, str, Any]]:
        """As `read_bag`."""
        for topic in topics or ():
            if topic not in self.topics:
                raise FormatError(f"{self.path} has no topic {topic}; it has {listed(self.topics)}")
        return self._messages(topics)

    def _messages(self, topics: Collection[str] | None) -> Iterator[tuple[float, str, str, Any]]:
        from rosbags.rosbag2 import Reader
        from zstandard import ZstdDecompressor

        decoders: dict[str, Any] = {}
        for file in self._files:  # a bag of several files was split in time
            try:
                with Reader(file) as reader:
                    wanted = [each for each in reader.connections if topics is None or each.topic in topics]
                    for connection, nanos, data in reader.messages(wanted) if wanted else ():
                        if data[:4] == ZSTANDARD:
                            data = ZstdDecompressor().decompressobj().decompress(data)
                        stamp, topic, kind = nanos / NANO, connection.topic, connection.msgtype
                        decoders[topic] = decode = decoders.get(topic) or _decoder(self.path, connection)
                        try:
                            message = decode(data, kind)
                        except Exception as error:
                            what = f"{topic} at {stamp:.3f} s is no {kind} ({type(error).__name__}: {error})"
                            raise FormatError(f"{self.path}: a message of {what}") from error
                        yield stamp, topic, kind, message
            except EagorError:
                raise
            except Exception as error:  # as the libraries happen to meet the damage
                raise FormatError(f"{file} is damaged ({error}); copy or record it again") from error

    def _open(self, file: Path) -> None:
        """Take in a file, or a copy of it. Raises `FormatError`, and what the libraries raise."""
        from rosbags.rosbag2 import Reader

        with file.open("rb") as opened:
            head = opened.read(len(ROS_1))
        if head == ROS_1:
            to = f"rosbags-convert --src {file} --dst {file.with_suffix('')}"
            raise FormatError(f"{file} is a bag of ROS 1; convert it: {to}")
        if not head:
            raise FormatError(f"{file} is empty; a recording that was never begun, or a copy that failed")
        if (kind := file.suffix.lower()) not in SUFFIXES:
            wanted = f"wanted a folder, or a file that ends in {' or '.join(SUFFIXES)}"
            raise FormatError(f"{file} is no bag of ROS 2; {wanted}")
        if kind == ".mcap" and not head.startswith(MAGIC):
            raise FormatError(f"{file} does not begin as an MCAP file does; wanted a ROS 2 bag (.mcap or .db3)")
        beside = [Path(f"{file.resolve()}{end}") for end in ("-wal", "-journal")]
        beside = [each for each in beside if each.exists() and each.stat().st_size]
        whole, broken = file, None
        if not _is_indexed(file) if kind == ".mcap" else beside or file.suffix != kind or {*"?#%"} & {*str(file)}:
            folder = tempfile.mkdtemp(prefix="eagor-bag-")
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            whole = Path(folder, f"bag{kind}")
            broken = _recover(file, whole) if kind == ".mcap" else _fold(file, beside, whole)
        with Reader(whole) as reader:
            connections, many = [*reader.connections], reader.message_count
        if not many and (broken or not connections):
            raise FormatError(f"{file} holds no message ({broken or 'it is empty'}); record it again")
        if any(not isinstance(name, str) for each in connections for name in (each.topic, each.msgtype)):
            raise FormatError(f"{file} is damaged: a topic has no name, or no type; copy it again")
        for each in connections:
            if (known := self.topics.setdefault(each.topic, each.msgtype)) != each.msgtype:
                raise FormatError(f"{file}: the topic {each.topic} has two types, {known} and {each.msgtype}")
            self.counts[each.topic] = self.counts.get(each.topic, 0) + each.msgcount
        if broken:
            warnings.warn(f"{file.name} was cut off ({broken}); its first {many} messages are read", stacklevel=4)
        self._files.append(whole)


def _is_indexed(file: Path) -> bool:
    """Whether an MCAP file has a sound index, by which `rosbags` gives messages in order of time."""
    from rosbags.rosbag2.storage_mcap import McapReader

    reader = McapReader(file)
    with suppress(Exception):  # as the library happens to meet the damage
        reader.open()
        with closing(reader):
            counts = reader.statistics.channel_message_counts if reader.statistics else {}
            return bool(reader.chunks) and sum(each.msgcount for each in reader.connections) == sum(counts.values())
    return False


def _recover(file: Path, whole: Path) -> str | None:
    """Copy the messages of an MCAP file up to the first damage, with an index; what the damage is."""
    from mcap.records import Channel, DataEnd, Message, Schema
    from mcap.stream_reader import StreamReader
    from mcap.writer import CompressionType, Writer

    schemas, channels = dict[int, int](), dict[int, int]()
    with file.open("rb") as source, whole.open("wb") as copy:
        writer = Writer(copy, compression=CompressionType.NONE)
        writer.start("ros2")
        try:
            for record in StreamReader(source, validate_crcs=True, record_size_limit=MOST).records:
                if isinstance(record, Message):
                    if (number := channels.get(record.channel_id)) is not None:
                        writer.add_message(number, record.log_time, record.data, record.publish_time, record.sequence)
                elif isinstance(record, Schema) and record.id not in schemas:  # each chunk may say it again
                    known = record.encoding in DEFINITIONS and record.data
                    how = (record.encoding, record.data) if known else ("", b"")
                    schemas[record.id] = writer.register_schema(record.name, *how)
                elif isinstance(record, Channel) and record.id not in channels:
                    schema = schemas.get(record.schema_id, 0)
                    channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schema)
                elif isinstance(record, DataEnd):
                    return None
        except Exception as error:  # as the library happens to meet the damage
            return str(error) or "it ends in the middle of a record"
        finally:
            writer.finish()
    return "it has no end"


def _fold(file: Path, beside: Sequence[Path], whole: Path) -> None:
    """Copy an SQLite file with what a recorder that was killed left beside it, and fold that in."""
    for each in (file, *beside):
        shutil.copyfile(each, f"{whole}{str(each).removeprefix(str(file.resolve())) if each in beside else ''}")
    with closing(sqlite3.connect(whole)) as database:
        database.execute("PRAGMA journal_mode = DELETE")


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
    packed, to = not inside and any(path.glob("*.zstd")), f"zstd -d {path}/*.zstd"
    if text:
        from ruamel.yaml import YAML

        try:
            told = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
            packed = told.get("compression_mode", "").lower() == "file"
            inside = [path / Path(name).name for name in told.get("relative_file_paths", [])]
        except Exception as error:  # the library's, or those of another shape
            raise FormatError(f"{about} is not that of a bag ({type(error).__name__}: {error})") from error
        to = f"rosbags-convert --src {path} --dst {path.name}-unpacked"
    if packed:
        raise FormatError(f"{path} is compressed by file; unpack it: {to}")
    if missing := [file.name for file in inside if not file.is_file()]:
        raise FormatError(f"{path} lacks {', '.join(missing)}, which {about.name} names; copy the whole folder")
    if not inside:
        raise FormatError(f"{path} holds no bag: no metadata.yaml, no {' or '.join(SUFFIXES)} file")
    return inside


def _decoder(path: Path, connection: Any) -> Any:
    """What decodes the messages of a topic: our types where they are the same, else those that the bag defines."""
    from rosbags.interfaces import MessageDefinitionFormat as Format
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    known, kind, text = store(), connection.msgtype, connection.msgdef.data
    if not text and kind not in known.fielddefs:
        raise FormatError(
            f"{path}: {connection.topic} is of type {kind}, which neither the bag nor ROS 2 Humble defines; record it "
            "as MCAP, which keeps the definitions"
        )
    types: dict[str, Any] = {}
    try:
        if text and connection.msgdef.format == Format.IDL:
            for part in filter(None, text.split("=" * 80 + "\n")):
                types |= get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part)
        elif text:
            types = get_types_from_msg(text, kind)
        if all(name in known.fielddefs and known.fielddefs[name][1] == about[1] for name, about in types.items()):
            return known.deserialize_cdr
        for name, about in types.items() if kind in (*PICTURES, *MOTION, CAMERA_INFO) else ():
            for field, wanted in known.fielddefs.get(name, ((), ()))[1]:
                if (field, wanted) not in about[1]:
                    raise ValueError(f"it has not the {field} of ROS 2's {name}")
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
        require_extra("recording", "robot", "rosbags")
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
        nanos = nanoseconds(stamp)
        try:
            data = store().serialize_cdr(message, kind)
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
            with self._writing():
                self._writer.write(connection, nanos, data)
                self._fresh = True
        if time.monotonic() - self._kept >= self._at_risk:
            self.flush()

    def flush(self) -> None:
        """Hand all that was written over to the system: no crash of this process takes it then."""
        with self._lock, self._writing():
            if self._writer is not None and self._fresh:
                self._writer.storage.close_chunk()
                self._writer.storage.bio.flush()
            self._kept, self._fresh = time.monotonic(), False

    def close(self) -> None:
        """Write the index. May be called twice."""
        with self._lock:
            if self._writer is not None:
                with self._writing():
                    self._writer.close()
                self._writer = None

    @contextmanager
    def _writing(self) -> Iterator[None]:
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
    topics: Mapping[str, str], kinds: Sequence[str], asked: str | None, *, where: str, option: str
) -> tuple[str, str]:
    """The topic `asked` for, or the only one of the first of `kinds` that there is; with its type.

    Of an Image and a CompressedImage with the same pictures (``name``, ``name/compressed``) the first kind is taken.
    `where` ("the bag x.mcap") and `option` ("--image-topic") are for the text of the `FormatError`: the topic is not
    there, has another type, or there are several.
    """
    has = f"{where} has {listed(topics)}"
    if asked is not None:
        name = asked if asked.startswith("/") else f"/{asked}"
        if name not in topics:
            raise FormatError(f"{where} has no topic {name}; it has {listed(topics)}")
        if topics[name] not in kinds:
            raise FormatError(f"{name} is of type {topics[name]}; wanted {' or '.join(kinds)}. {has}")
        return name, topics[name]
    others = (TF_STATIC, "/compressedDepth", "/goal_pose", "/initialpose")  # none by itself: what it is not about
    fit = {name: kind for name, kind in topics.items() if kind in kinds and not name.endswith(others)}
    if not fit:
        raise FormatError(f"{where} has no topic of type {' or '.join(kinds)}; it has {listed(topics)}")
    kind = min(fit.values(), key=kinds.index)
    found = [name for name, its in fit.items() if its == kind]
    if set(kinds) == set(PICTURES) and len(base := {name.removesuffix("/compressed") for name in fit}) > 1:
        found = sorted(base)
    if len(found) > 1:
        raise FormatError(f"{where} has several topics that fit: {', '.join(found)}; say which one with {option}")
    return found[0], kind
