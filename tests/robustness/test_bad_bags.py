"""Bags that are none, or not whole: a sentence that says what to change, never a traceback."""

from __future__ import annotations

import errno
import math
import sqlite3
import struct
import tempfile
import warnings
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from mutations import damaged, reads
from rosmaking import cdr, random_message
from strategies import HOSTILE

from eagor.errors import FormatError, StorageError, TimeError
from eagor.sources import ros_messages as m
from eagor.sources.bags import MAGIC, Bag, BagWriter, is_bag, read_bag
from eagor.sources.ros_sources import BagCamera, BagPoses


def small(path, count=20):
    rng = np.random.default_rng(0)
    with BagWriter(path) as bag:
        for i in range(count):
            bag.write("/odom", m.ODOMETRY, random_message(m.ODOMETRY, rng, 100.0 + i), 100.0 + i)
            bag.write("/image", m.IMAGE, random_message(m.IMAGE, rng, 100.0 + i), 100.0 + i)
    return path


def test_a_topic_that_is_not_there_names_those_that_are(tmp_path):
    with pytest.raises(FormatError, match=r"has no topic /x; it has /image \(sensor_msgs/msg/Image\), /odom \(nav_m"):
        read_bag(small(tmp_path / "bag"), ["/x"])


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("old.bag", b"#ROSBAG V2.0\n" + bytes(99), "is a bag of ROS 1; convert it: rosbags-convert --src .*old.bag"),
        ("renamed.mcap", b"#ROSBAG V2.0\n" + bytes(99), "is a bag of ROS 1"),
        ("empty.mcap", b"", "is empty"),
        ("text.mcap", b"hello, world" * 99, "does not begin as an MCAP file does"),
        ("head.mcap", b"\x89MCAP0\r\n", "holds no message"),
        ("text.db3", b"hello, world" * 99, "cannot be read as a bag"),
        ("empty.db3", b"", "is empty"),
        ("clip.mp4", b"hello", "is no bag of ROS 2; wanted a folder, or a file that ends in .mcap or .db3"),
    ],
)
def test_files_that_are_no_bags(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FormatError, match=said):
        Bag(tmp_path / name)


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ("{", "is not that of a bag"),
        ("[]", "is not that of a bag"),
        ("rosbag2_bagfile_information: 3", "is not that of a bag"),
        ("rosbag2_bagfile_information: {relative_file_paths: [a.mcap]}", "lacks a.mcap"),
        ("rosbag2_bagfile_information: {compression_mode: FILE}", "is compressed by file; unpack it: rosbags-convert"),
    ],
)
def test_folders_whose_description_is_wrong(tmp_path, metadata, said):
    (tmp_path / "metadata.yaml").write_text(metadata)
    assert is_bag(tmp_path)
    with pytest.raises(FormatError, match=said):
        Bag(tmp_path)


@pytest.mark.parametrize("odd", ["uint32 high\nstring frame_id\n", "string height\nuint32 width\n"])
def test_a_type_that_the_bag_defines_otherwise_is_said(tmp_path, odd):
    """What reads pictures would look for fields in vain, or find another kind of value."""
    schema = struct.pack("<H", 1) + text(m.IMAGE) + text("ros2msg") + text(odd)
    named = record(4, struct.pack("<HH", 1, 1) + text("/a") + text("cdr") + text(""))
    (tmp_path / "a.mcap").write_bytes(
        MAGIC + record(1, text("ros2") + text("")) + record(3, schema) + named + message(1, 99)
    )
    with (
        pytest.warns(UserWarning, match="cut off"),
        pytest.raises(FormatError, match=r"has not the h.* of ROS 2's sensor_msgs/msg/Image"),
    ):
        list(read_bag(tmp_path / "a.mcap"))


def test_files_of_a_bag_that_is_compressed_by_file(tmp_path):
    """Copied without its description."""
    (tmp_path / "bag_0.db3.zstd").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"is compressed by file; unpack it: zstd -d"):
        Bag(tmp_path)


def test_what_is_not_there(tmp_path):
    with pytest.raises(FormatError, match=r"cannot be read .No such file"):
        Bag(tmp_path / "none")
    with pytest.raises(FormatError, match="holds no bag"):
        Bag(tmp_path)
    assert not is_bag(tmp_path)
    assert not is_bag("x" * 5000)


def samples():
    """The bytes of small bags: MCAP with an index and cut off before it, and SQLite."""
    with tempfile.TemporaryDirectory() as place:
        whole = (small(Path(place, "bag"), 3) / "bag.mcap").read_bytes()
        told = [(t, topic, kind, message) for t, topic, kind, message in read_bag(Path(place, "bag"))]
        with closing(sqlite3.connect(Path(place, "bag.db3"))) as bag:
            bag.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
            bag.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
            topics = sorted({(topic, kind) for _, topic, kind, _ in told})
            bag.executemany("INSERT INTO topics(name, type, serialization_format) VALUES (?, ?, 'cdr')", topics)
            rows = [
                (topics.index((topic, kind)) + 1, m.nanoseconds(t), cdr(kind, each)) for t, topic, kind, each in told
            ]
            bag.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
            bag.commit()
        return [whole, whole[: 2 * len(whole) // 3], Path(place, "bag.db3").read_bytes()]


@pytest.fixture(scope="module")
def damage(tmp_path_factory):
    return tmp_path_factory.mktemp("damage")


@HOSTILE
@given(damaged(samples()))
def test_damage_gives_messages_a_warning_or_an_error_of_ours(damage, blob):
    """Of the pictures and poses in it, too."""
    path = damage / ("bag.mcap" if blob[:1] == MAGIC[:1] else "bag.db3")
    path.write_bytes(blob)
    for stamp, *_ in reads(lambda: list(read_bag(path))) or ():
        assert math.isfinite(stamp)
    for pose in reads(lambda: list(BagPoses(path))) or ():
        assert np.allclose(pose.world_R_body @ pose.world_R_body.T, np.eye(3), atol=1e-6)
    for picture in reads(lambda: [make() for _, make in BagCamera(path).pictures()]) or ():
        assert (picture.dtype, picture.ndim) == (np.uint8, 3)


def test_recordings_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="is there already; name a new folder"):
        BagWriter(tmp_path)
    with pytest.raises(StorageError, match="cannot be made"):
        BagWriter(tmp_path / "file" / "bag")
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/a", m.TEXT, m.message(m.TEXT, data="x"), 1.0)
        with pytest.raises(FormatError, match="/a was recorded as std_msgs/msg/String, and now as"):
            bag.write("/a", m.IMU, random_message(m.IMU, np.random.default_rng(0), 1.0), 2.0)
        with pytest.raises(FormatError, match="'my/msg/Own' is no known ROS 2 type"):
            bag.write("/b", "my/msg/Own", None, 2.0)
        with pytest.raises(FormatError, match="/c: the message is no std_msgs/msg/String"):
            bag.write("/c", m.TEXT, 7, 2.0)
        with pytest.raises(TimeError):
            bag.write("/a", m.TEXT, m.message(m.TEXT, data="x"), math.nan)
    with pytest.raises(StorageError, match="is closed"):
        bag.write("/a", m.TEXT, m.message(m.TEXT, data="x"), 3.0)
    bag.close()
    assert len(list(read_bag(tmp_path / "bag"))) == 1


def test_an_exception_in_the_block_keeps_the_recording(tmp_path):
    def record():
        with BagWriter(tmp_path / "bag") as bag:
            bag.write("/a", m.TEXT, m.message(m.TEXT, data="x"), 1.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert [each[3].data for each in read_bag(tmp_path / "bag")] == ["x"]


def record(operation, body):
    return struct.pack("<BQ", operation, len(body)) + body


def text(said):
    return struct.pack("<I", len(said)) + said.encode()


def channel(number=1):
    schema = struct.pack("<H", 1) + text(m.TEXT) + text("ros2msg") + text("string data\n")
    return record(3, schema) + record(4, struct.pack("<HH", number, 1) + text("/a") + text("cdr") + text(""))


def message(time, size):
    """A string of zeros, `size` bytes with its head."""
    cdr = b"\0\1\0\0" + struct.pack("<I", size - 8) + bytes(size - 8)
    return record(5, struct.pack("<HIQQ", 1, 0, time, time) + cdr)


def chunk(size, content, compression, time=1):
    return record(
        6, struct.pack("<QQQI", time, time, size, 0) + text(compression) + struct.pack("<Q", len(content)) + content
    )


def test_records_that_claim_more_than_there_is(tmp_path):
    head = MAGIC + record(1, text("ros2") + text("")) + channel()
    for name, each in (("record", record(5, b"")[:1] + struct.pack("<Q", 1 << 60)), ("chunk", chunk(1 << 60, b"", ""))):
        (tmp_path / f"{name}.mcap").write_bytes(head + message(1, 100) + each)
        with pytest.warns(UserWarning, match="cut off"):
            assert len(list(read_bag(tmp_path / f"{name}.mcap"))) == 1


class Filling:
    """A file on a disk that is full after so many writes, in the middle of one, and has room again later."""

    def __init__(self, file, left):
        self._file, self._left = file, left

    def write(self, data):
        self._left -= 1
        if self._left == 0:
            self._file.write(bytes(data)[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return self._file.write(data)

    def __getattr__(self, name):
        return getattr(self._file, name)


@pytest.mark.parametrize("left", range(1, 40, 2))
def test_a_disk_that_is_full_for_a_moment_ends_the_recording_where_it_was(tmp_path, left):
    """Chunks that are written after half a one would be read as part of it."""
    rng = np.random.default_rng(0)
    sent = [random_message(m.ODOMETRY, rng, 100.0 + number) for number in range(30)]
    bag = BagWriter(tmp_path / "bag", at_risk=0)
    bag._writer.storage.bio = Filling(bag._writer.storage.bio, left)
    with suppress(StorageError):
        for number, each in enumerate(sent):
            bag.write("/odom", m.ODOMETRY, each, 100.0 + number)
        bag.close()
    with pytest.raises(StorageError, match="is closed"):
        bag.write("/odom", m.ODOMETRY, sent[0], 200.0)
    bag.close()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = list(read_bag(tmp_path / "bag"))
        except FormatError:  # not one message is whole
            found = []
    assert [stamp for stamp, *_ in found] == [100.0 + number for number in range(len(found))]
    assert len(found) >= (left - 12) // 8
    for (*_, one), other in zip(found, sent, strict=False):
        assert cdr(m.ODOMETRY, one) == cdr(m.ODOMETRY, other)
