"""Bags that are none, or not whole: a sentence that says what to change, never a traceback."""

from __future__ import annotations

import math
import warnings
from contextlib import suppress

import numpy as np
import pytest
from rosmaking import random_message

from eagor.errors import FormatError, StorageError, TimeError
from eagor.robots.ros import messages as m
from eagor.robots.ros.bags import Bag, BagWriter, is_bag, read_bag


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


def test_what_is_not_there(tmp_path):
    with pytest.raises(FormatError, match=r"cannot be read .No such file"):
        Bag(tmp_path / "none")
    with pytest.raises(FormatError, match="holds no bag"):
        Bag(tmp_path)
    assert not is_bag(tmp_path)
    assert not is_bag("x" * 5000)


def test_damage_in_the_middle_ends_or_is_told(tmp_path):
    """Every damaged byte gives messages, a warning or an error of ours; never another error."""
    whole = bytearray((small(tmp_path / "bag", 3) / "bag.mcap").read_bytes())
    file, rng = tmp_path / "damaged.mcap", np.random.default_rng(1)
    seen = 0
    for place in rng.integers(0, len(whole), 150):
        damaged = bytearray(whole)
        damaged[place] ^= int(rng.integers(1, 256))
        file.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with suppress(FormatError):
                seen += len(list(read_bag(file)))
    assert seen > 300


def test_recordings_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="is there already; name a new folder"):
        BagWriter(tmp_path)
    with pytest.raises(StorageError, match="cannot be made"):
        BagWriter(tmp_path / "file" / "bag")
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/a", m.TEXT, m.text_message("x"), 1.0)
        with pytest.raises(FormatError, match="/a was recorded as std_msgs/msg/String, and now as"):
            bag.write("/a", m.IMU, random_message(m.IMU, np.random.default_rng(0), 1.0), 2.0)
        with pytest.raises(FormatError, match="'my/msg/Own' is no known ROS 2 type"):
            bag.write("/b", "my/msg/Own", None, 2.0)
        with pytest.raises(FormatError, match="/c: the message is no std_msgs/msg/String"):
            bag.write("/c", m.TEXT, 7, 2.0)
        with pytest.raises(TimeError):
            bag.write("/a", m.TEXT, m.text_message("x"), math.nan)
    with pytest.raises(StorageError, match="is closed"):
        bag.write("/a", m.TEXT, m.text_message("x"), 3.0)
    bag.close()
    assert len(list(read_bag(tmp_path / "bag"))) == 1


def test_an_exception_in_the_block_keeps_the_recording(tmp_path):
    def record():
        with BagWriter(tmp_path / "bag") as bag:
            bag.write("/a", m.TEXT, m.text_message("x"), 1.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert [each[3].data for each in read_bag(tmp_path / "bag")] == ["x"]
