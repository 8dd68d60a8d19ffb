"""Bags: what `rosbags` and what we write comes back equal, from every form in which a bag can lie on a disk."""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosmaking import READ, cdr, random_message

from eagor.sources import ros_messages as m
from eagor.sources.bags import Bag, BagWriter, is_bag, read_bag
from eagor.sources.ros_messages import store

MANY = 250
START = 1_700_000_000


def stamps(count):
    return START + np.sort(np.random.default_rng(0).uniform(0, 100, count))


@pytest.fixture(scope="module")
def sent():
    """Many messages of each type that we read, interleaved, with their times."""
    rng, times = np.random.default_rng(1), stamps(MANY)
    return [(float(t), topic, kind, random_message(kind, rng, float(t))) for t in times for topic, kind in READ.items()]


def written_by_rosbags(path, sent, plugin, version=9, compression=None):
    writer = Writer(path, version=version, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        known = {topic: writer.add_connection(topic, kind, typestore=store()) for topic, kind in READ.items()}
        for stamp, topic, kind, message in sent:
            writer.write(known[topic], m.nanoseconds(stamp), store().serialize_cdr(message, kind))


def check_equal(found, sent):
    found = list(found)
    assert len(found) == len(sent)
    for (t1, topic1, kind1, one), (t2, topic2, kind2, two) in zip(
        sorted(found, key=lambda x: x[:2]), sorted(sent, key=lambda x: x[:2]), strict=True
    ):
        assert (t1, topic1, kind1) == (t2, topic2, kind2)
        assert type(one) is type(two)
        assert cdr(kind1, one) == cdr(kind2, two)


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_messages_of_each_type_written_by_rosbags(tmp_path, sent, plugin, version):
    written_by_rosbags(tmp_path / "bag", sent, plugin, version)
    assert Bag(tmp_path / "bag").topics == dict(sorted(READ.items()))
    check_equal(read_bag(tmp_path / "bag"), sent)
    (file,) = (tmp_path / "bag").glob("bag.*")
    check_equal(read_bag(file), sent)


def test_messages_of_each_type_written_by_us(tmp_path, sent):
    with BagWriter(tmp_path / "bag") as bag:
        for stamp, topic, kind, message in sent:
            bag.write(topic, kind, message, stamp)
    check_equal(read_bag(tmp_path / "bag"), sent)
    with Reader(tmp_path / "bag") as reader:  # as others read it
        assert reader.message_count == len(sent)
        theirs = [
            (nanos / 10**9, c.topic, c.msgtype, store().deserialize_cdr(data, c.msgtype))
            for c, nanos, data in reader.messages()
        ]
    check_equal(theirs, sent)


@pytest.mark.parametrize("mode", [CompressionMode.STORAGE, CompressionMode.MESSAGE])
def test_compressed_bags_are_read(tmp_path, sent, mode):
    written_by_rosbags(tmp_path / "bag", sent[:800], StoragePlugin.MCAP, compression=mode)
    check_equal(read_bag(tmp_path / "bag"), sent[:800])
    whole = (tmp_path / "bag" / "bag.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[:-100])  # the index is damaged, and all messages are there
    check_equal(read_bag(cut), sent[:800])


def test_only_the_topics_asked_for(tmp_path, sent):
    written_by_rosbags(tmp_path / "bag", sent[:800], StoragePlugin.MCAP)
    some = [each for each in sent[:800] if each[1] in ("/odom", "/imu")]
    check_equal(read_bag(tmp_path / "bag", ["/odom", "/imu"]), some)
    assert list(read_bag(tmp_path / "bag", [])) == []


def test_messages_that_were_recorded_late_come_in_order(tmp_path):
    """A slow recorder: the stamps of a chunk, and of several, overlap."""
    times = np.random.default_rng(2).permutation(300) + float(START)
    with BagWriter(tmp_path / "bag", at_risk=0) as bag:  # every message in a chunk of its own
        for t in times:
            bag.write("/a", m.TEXT, m.message(m.TEXT, data=str(t)), float(t))
    assert [each[0] for each in read_bag(tmp_path / "bag")] == sorted(times)
    file = tmp_path / "bag" / "bag.mcap"
    file.write_bytes(file.read_bytes()[:-20])  # without the index
    assert [each[0] for each in read_bag(file)] == sorted(times)


RECORD = """
import sys, time
import numpy as np
from eagor.sources import ros_messages as m
from eagor.sources.bags import BagWriter
bag = BagWriter(sys.argv[1], at_risk=0)
picture = np.zeros((100, 200, 3), np.uint8)
for i in range(10**6):
    bag.write("/n", m.TEXT, m.message(m.TEXT, data=str(i)), 1000.0 + i)
    if i % 100 == 0:
        bag.write("/image", m.IMAGE, m.image_message(picture, 1000.0 + i, "x3"), 1000.0 + i)
    if i % 50 == 49:
        print(i, flush=True)
"""


def test_what_was_written_before_a_kill_is_read(tmp_path):
    with subprocess.Popen([sys.executable, "-c", RECORD, tmp_path / "bag"], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        told = [int(process.stdout.readline()) for _ in range(40)]
        process.send_signal(signal.SIGKILL)
        told += [int(line) for line in process.stdout]
    with pytest.warns(UserWarning, match="was cut off"):
        bag = Bag(tmp_path / "bag")
    numbers = [int(message.data) for _, _, _, message in bag.messages(["/n"])]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= told[-1] + 1
    assert len(list(bag.messages(["/image"]))) >= told[-1] // 100 + 1


def test_every_cut_is_read_up_to_it(tmp_path, sent):
    """A file that ends anywhere, in a chunk or between chunks, gives the whole chunks of what was written."""
    with BagWriter(tmp_path / "bag", at_risk=0) as bag:
        for stamp, topic, kind, message in sent[:64]:
            bag.write(topic, kind, message, stamp)
    whole, cut = (tmp_path / "bag" / "bag.mcap").read_bytes(), tmp_path / "cut.mcap"
    end, lengths = whole.rindex(b"\x0f\x04\0\0\0\0\0\0\0"), []  # where its DataEnd is
    for size in range(end // 2, end, 501):
        cut.write_bytes(whole[:size])
        with pytest.warns(UserWarning, match="was cut off"):
            found = list(read_bag(cut))
        check_equal(found, sent[: len(found)])
        lengths.append(len(found))
    assert lengths == sorted(lengths)
    assert lengths[0] < 40
    assert lengths[-1] >= 62


def test_a_bag_of_several_files(tmp_path, sent):
    """As `ros2 bag record` splits them: by size or duration."""
    for number, part in enumerate([sent[:80], sent[80:160]]):
        written_by_rosbags(tmp_path / f"part_{number}", part, StoragePlugin.MCAP)
    folder = tmp_path / "split"
    folder.mkdir()
    for number in range(2):
        (tmp_path / f"part_{number}" / f"part_{number}.mcap").rename(folder / f"split_{number}.mcap")
    check_equal(read_bag(folder), sent[:160])  # without metadata.yaml
    assert is_bag(folder)
    assert Bag(folder).counts["/odom"] == sum(topic == "/odom" for _, topic, _, _ in sent[:160])


def test_a_type_of_its_own_is_read_by_the_definition_in_the_bag(tmp_path):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    own = get_typestore(Stores.ROS2_HUMBLE)
    own.register(get_types_from_msg("float32 volts\nuint8[] cells\n", "robot_msgs/msg/Battery"))
    kind = "robot_msgs/msg/Battery"
    message = own.types[kind](volts=28.5, cells=np.arange(3, dtype=np.uint8))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/battery", kind, typestore=own)
        writer.write(connection, 5, own.serialize_cdr(message, kind))
    ((_, topic, found, battery),) = read_bag(tmp_path / "bag")
    assert (topic, found, battery.volts, battery.cells.tolist()) == ("/battery", kind, 28.5, [0, 1, 2])


def databased(path, sent, journal="DELETE", late=()):
    """As ROS 2 Foxy to Humble wrote it, without definitions; `late` is written by a recorder that is killed then."""
    path.parent.mkdir(exist_ok=True)
    rows = [
        [(topic, kind, m.nanoseconds(t), cdr(kind, each)) for t, topic, kind, each in part] for part in (sent, late)
    ]
    subprocess.run([sys.executable, "-c", KILLED, path, journal], input=pickle.dumps(rows), check=True)


KILLED = """
import os, pickle, sqlite3, sys
rows, late = pickle.load(sys.stdin.buffer)
bag, topics = sqlite3.connect(sys.argv[1]), sorted({row[:2] for row in rows + late})
bag.executescript("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);")
bag.executemany("INSERT INTO topics(name, type, serialization_format) VALUES (?, ?, 'cdr')", topics)
put = lambda some: bag.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
    [(topics.index(row[:2]) + 1, *row[2:]) for row in some])
put(rows); bag.commit()
bag.execute(f"PRAGMA journal_mode = {sys.argv[2]}")
bag.executescript("PRAGMA wal_autocheckpoint = 0; PRAGMA cache_size = 1; PRAGMA cache_spill = 1")
put(late)
if sys.argv[2] == "WAL":
    bag.commit()
os._exit(0)
"""


def content(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize("lacking", ["", "-shm", "-wal"])
def test_a_database_whose_recorder_was_killed_is_read_and_not_touched(tmp_path, sent, lacking):
    """What is in the write-ahead log counts, also where SQLite's index of it was not copied along."""
    file = tmp_path / "bag" / "bag_0.db3"
    databased(file, sent[:30], "WAL", sent[30:90])
    if lacking:
        file.with_name(f"{file.name}{lacking}").unlink()
    before = content(file.parent)
    check_equal(read_bag(file.parent), sent[: 30 if lacking == "-wal" else 90])
    assert content(file.parent) == before


def test_a_transaction_that_was_cut_off_is_taken_back_in_a_copy(tmp_path, sent):
    file = tmp_path / "bag" / "bag_0.db3"
    databased(file, sent[:30], "DELETE", sent[30:])
    before = content(file.parent)
    assert before[f"{file.name}-journal"]
    check_equal(read_bag(file), sent[:30])
    assert content(file.parent) == before


def test_an_old_sqlite_bag_without_definitions(tmp_path, sent):
    databased(tmp_path / "old.db3", sent[:160])
    check_equal(read_bag(tmp_path / "old.db3"), sent[:160])


def test_the_file_that_a_recorder_had_just_begun_is_left_out(tmp_path, sent):
    written_by_rosbags(tmp_path / "bag", sent[:80], StoragePlugin.MCAP)
    (tmp_path / "bag" / "metadata.yaml").write_text("")  # and it was killed while it wrote this
    (tmp_path / "bag" / "bag_1.mcap").write_bytes(b"")
    with pytest.warns(UserWarning, match="a part of .* is left out: .*bag_1.mcap is empty"):
        check_equal(read_bag(tmp_path / "bag"), sent[:80])
