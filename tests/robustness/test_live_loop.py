"""Promised: nothing that fails holds up the answers of the live loop; it is said in words, and mended where it can be.

Waits are for events, with generous limits; no time is asserted.
"""

import json
import math
import multiprocessing
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from livemaking import (
    AlwaysDying,
    Camera,
    Dying,
    Film,
    Hanging,
    Here,
    Ignorant,
    Odometry,
    Raising,
    Seeing,
    Stalled,
    Track,
    Unplugged,
    yawed,
)
from PIL import Image
from processes import alive, sessions_of, wait_for

from eagor.errors import DeviceError, EagorError, QueryError, TimeError
from eagor.lab.worlds.painted import painted_room
from eagor.live import loop as looping
from eagor.live.events import ObservationReceived, Tick
from eagor.live.loop import Loop
from eagor.live.recording import Replay
from eagor.sources import Pose
from eagor.sources.bags import Bag, read_bag
from eagor.sources.ros_messages import image_from_msg, pose_from_msg, stamp_of
from eagor.tracking import TrackerConfig

pytestmark = [
    pytest.mark.xdist_group("real time"),
    pytest.mark.filterwarnings("ignore:.*works in this process"),  # where the camera or the odometry is what fails
]

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes as Linux shows them")
CONFIG = TrackerConfig(degree=7)
LONGEST = 180.0  # seconds that anything may take


def followed(loop, *phases):
    """The answers until each of the phases, a function of an answer, has been true, one after the other."""
    answers, end, left = [], time.monotonic() + LONGEST, [*phases]
    for answer in loop:
        answers.append(answer)
        while left and left[0](answer):
            left.pop(0)
        if not left:
            loop.stop()
        assert time.monotonic() < end, [*map(str, {a.status_words for a in answers})]
    assert not left, [*{a.status_words for a in answers}]
    return answers


def says(*words):
    return lambda answer: all(word in answer.status_words for word in words)


def known(answer):
    return answer.direction is not None and answer.look_age < 5


def well(answer):
    return known(answer) and not answer.faults


def loop_of(camera, perception, queries=("red chair",), poses=None, realtime=True, sinks=(), **options):
    return Loop(camera, poses, perception, queries, realtime, sinks, **{"config": CONFIG, "rate": 50.0} | options)


@pytest.fixture(autouse=True)
def _nobody_is_left():
    before = {*threading.enumerate()}  # what an earlier test may have left is not ours
    yield
    wait_for(lambda: not multiprocessing.active_children())
    wait_for(lambda: not [each for each in {*threading.enumerate()} - before if each.name.startswith("eagor ")])


def test_answers_do_not_wait_for_a_model_that_takes_1600_ms(tmp_path):
    """Dozens of answers come between a picture and what the model says about it."""
    loop = loop_of(Camera(), Seeing(1.6), poses=Odometry(turn=0.5))
    answers = followed(
        loop, lambda answer: not says("being loaded")(answer), known, lambda a: a.look_age < 2 and a.image_age < 1
    )
    loading = [answer for answer in answers if says("being loaded")(answer)]
    before = [answer for answer in answers if not says("being loaded")(answer) and not known(answer)]
    assert loading
    assert len(before) >= 16  # 80 on an idle machine
    late = next(answer for answer in answers if known(answer))
    assert late.look_age > 1.5
    assert late.image_age < late.look_age


def test_answers_do_not_wait_for_a_perception_that_is_quicker_than_the_tracker(monkeypatch):
    """Each look takes the tracker longer than the next one needs to come: few wait, and answers come between them."""
    loop, run = loop_of(Camera(), Here(), ["red chair", "blue ball"]), 0
    take = loop.core.take

    def slow(event):
        nonlocal run
        run = 0 if isinstance(event, Tick) else run + isinstance(event, ObservationReceived)
        assert run < 20  # looks without an answer
        time.sleep(0.05 * isinstance(event, ObservationReceived))
        return take(event)

    monkeypatch.setattr(loop.core, "take", slow)
    followed(loop, known, lambda answer: loop.counts.looks > 30)
    assert loop.counts.skipped > 0


@linux
def test_a_picture_for_which_the_shared_memory_has_no_room_is_looked_at(monkeypatch):
    """As in a container with its 64 MB: a write there would end the process."""

    def full(file, begin, size):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    followed(loop_of(Camera(), Seeing()), known)


def test_the_newest_picture_is_looked_at_and_the_others_are_counted(tmp_path):
    log = tmp_path / "log"
    loop = loop_of(Camera(rate=100), Seeing(0.3, log=log))
    ages = []
    done = followed(loop, known, lambda answer: ages.append(answer.look_age) or loop.counts.looks >= 5)
    stamps = [float(line.split()[0]) for line in log.read_text().splitlines()]
    assert np.median(np.diff(stamps)) > 0.25  # not the next picture, but the newest: a busy machine may be late once
    assert loop.counts.skipped > loop.counts.looks
    assert done


def pulled(camera):
    """A phase that pulls the plug."""

    def pull(_):
        camera.pulled.set()
        return True

    return pull


def test_a_camera_that_is_unplugged_comes_back():
    opened, first = [], Unplugged()

    def opens():
        opened.append(1)
        if len(opened) == 2:
            raise DeviceError("there is no /dev/video7; plug a camera in")
        return first if len(opened) == 1 else Camera()

    loop = loop_of(opens, Here())
    phases = says("/dev/video7 is gone", "opened again"), says("there is no /dev/video7"), well
    followed(loop, well, pulled(first), *phases)
    assert len(opened) == 3


def test_a_stream_that_stalls_is_said_and_opened_again(monkeypatch):
    monkeypatch.setattr(looping, "STALLED", 3.0)
    opened, first = [], Stalled()

    def opens():
        opened.append(1)
        return first if len(opened) == 1 else Camera()

    loop = loop_of(opens, Here())
    followed(loop, well, pulled(first), says("no picture for 1."), says("opened again"), well)
    assert len(opened) == 2


def test_a_perception_that_raises_is_said_and_goes_on():
    loop = loop_of(Camera(), Raising(3, seconds=0.1))
    followed(loop, says("RuntimeError: out of memory"), well)


def test_a_perception_that_hangs_is_ended_and_started_anew(tmp_path):
    log = tmp_path / "log"
    loop = loop_of(Camera(), Hanging(tmp_path / "mark", log=log), patience=2.0)
    answers = followed(loop, says("did not look within 2 s", "starts anew"), well)
    processes = [int(line.split()[-1]) for line in log.read_text().splitlines()]
    assert len({*processes}) == 2
    during = [answer for answer in answers if not known(answer)]
    assert len(during) > 20


def test_a_perception_whose_process_dies_is_started_anew(tmp_path):
    loop = loop_of(Camera(), Dying(tmp_path / "mark"))
    followed(loop, says("died (exit code 7)", "after 0.5 s"), well)


@pytest.mark.slow
def test_a_perception_that_always_dies_is_started_ever_more_rarely():
    loop = loop_of(Camera(), AlwaysDying())
    followed(loop, says("after 0.5 s"), says("after 1 s"), says("after 2 s"))


def test_a_cameras_clock_that_jumps_is_said_and_followed():
    ahead = [0.0]

    def jump(_):
        ahead[0] = 3600.0
        return True

    loop = loop_of(Camera(stamps=lambda stamp: stamp + ahead[0]), Here())
    answers = followed(loop, well, jump, says("the clock of the camera jumped forward by 3600."), well)
    assert all(answer.image_age > -0.1 for answer in answers)


def test_poses_that_stop_are_said():
    odometry = Odometry()
    loop = loop_of(Camera(), Here(), poses=odometry)
    answers = followed(loop, well, pulled(odometry), says("no pose for 1."))
    assert answers[-1].pose_age > 0.99


def test_poses_that_end_are_asked_for_again():
    opened = []

    def opens():
        opened.append(1)
        return Broken() if len(opened) == 1 else Odometry()

    class Broken(Odometry):
        def __iter__(self):
            yield Pose(time.time(), yawed(0.0))
            raise DeviceError("the robot is gone")

    loop = loop_of(Camera(), Here(), poses=opens)
    followed(loop, says("the robot is gone"), well)


def test_a_query_that_is_not_understood_is_said_and_the_other_goes_on():
    loop = loop_of(Camera(), Ignorant(), ["red chair", "pet snail"])
    answers = followed(loop, says("'pet snail' is not known"), lambda a: a.query == "red chair" and known(a))
    assert all(answer.direction is None for answer in answers if answer.query == "pet snail")


def test_queries_that_nobody_understands_end_the_loop():
    with pytest.raises(QueryError, match="pet snail"):
        followed(loop_of(Camera(), Ignorant(), ["pet snail"]), lambda _: False)


def test_a_perception_that_cannot_be_loaded_ends_the_loop_in_words():
    with pytest.raises(EagorError, match="nowhere"):
        followed(loop_of(Camera(), "onnx:/nowhere.onnx"), lambda _: False)


def test_a_perception_that_cannot_be_sent_to_a_process_works_in_this_one_and_that_is_said():
    eyes = Seeing()
    with pytest.warns(UserWarning, match="works in this process"):
        loop = loop_of(Camera(), lambda panorama, query, stamp=None: eyes(panorama, query, stamp=stamp))
    followed(loop, well)


def test_a_camera_that_is_not_there_is_an_error_at_once():
    def opens():
        raise DeviceError("there is no /dev/video9")

    with pytest.raises(DeviceError, match="video9"):
        loop_of(opens, Here())


@pytest.mark.parametrize(("name", "value"), [("rate", 0.0), ("rate", math.nan), ("patience", -1.0)])
def test_wrong_numbers_are_refused(name, value):
    with pytest.raises(TimeError, match=name):
        loop_of(Camera(), Here(), **{name: value})


@pytest.mark.slow
def test_a_recording_is_played_at_its_own_speed_with_its_poses():
    """The loop waits for the perception, and ends with the film; stamps are of now."""
    poses = [Pose(95 + k / 20, yawed(0.2 * (95 + k / 20))) for k in range(160)]
    loop = loop_of(Film(count=20), Seeing(), poses=Track(poses))
    began = time.time()
    answers = list(loop)
    assert loop.counts.frames == 20
    assert answers[-1].stamp - answers[0].stamp > 1.8
    assert abs(answers[0].stamp - began) < LONGEST
    # The camera has turned since the last look, by what the poses tell.
    assert known(answers[-1])


def test_in_turn_every_picture_is_looked_at_and_gives_the_same_each_time(tmp_path):
    log = tmp_path / "log"
    poses = [Pose(99 + k / 20, yawed(0.2 * (99 + k / 20))) for k in range(100)]
    runs = [
        [a.as_dict() for a in loop_of(Film(count=20), Seeing(log=log), poses=Track(poses), realtime=False)]
        for _ in range(2)
    ]
    assert runs[0] == runs[1]
    assert len(log.read_text().splitlines()) == 40
    assert [round(a["stamp"], 6) for a in runs[0]][:3] == [100.0, 100.1, 100.2]
    assert runs[0][-1]["faults"] == []


def played_torn(record):
    """A recording that was cut off, and its answers; it is said that it was."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        replay = Replay(record)
        answers = list(replay)
    assert any("cut off" in str(warning.message) for warning in said)
    return answers


SCRIPT = """
import sys, time
sys.path[:0] = {paths!r}
from pathlib import Path
from livemaking import Camera, Odometry, Seeing
from eagor.live.loop import Loop

if __name__ == "__main__":
    loop = Loop(Camera(), Odometry(), Seeing(), "red chair", record=Path({record!r}), rate=20.0)
    for answer in loop:
        if answer.direction is not None:
            Path({mark!r}).touch()
"""


@linux
def test_a_run_that_is_killed_leaves_nobody_and_its_recording_can_be_played(tmp_path):
    pytest.importorskip("rosbags")
    record, mark, script = tmp_path / "run", tmp_path / "mark", tmp_path / "script.py"
    paths = [entry for entry in sys.path if entry]
    script.write_text(SCRIPT.format(paths=paths, record=str(record), mark=str(mark)))
    run = subprocess.Popen([sys.executable, str(script)], start_new_session=True)
    wait_for(lambda: any("spawn_main" in each for each in alive(sessions_of(run.pid)).values()))
    file = record / "run.mcap"
    wait_for(lambda: file.exists() and file.stat().st_size > 50_000 and mark.exists())
    written = file.stat().st_size
    wait_for(lambda: file.stat().st_size > written)  # what has been answered is on the disk
    sessions = sessions_of(run.pid)
    run.send_signal(signal.SIGKILL)
    run.wait()
    wait_for(lambda: not alive(sessions))
    answers = played_torn(record)
    assert len(answers) > 10
    assert any(answer.direction is not None for answer in answers)


UNGUARDED = """
import sys
sys.path[:0] = {paths!r}
from livemaking import Camera, Seeing
from eagor import Loop

class Own(Seeing):
    pass

for answer in Loop(Camera(), None, {perception}, "red chair", realtime=True):
    if answer.direction is not None:
        print("seen")
        break
"""


@pytest.mark.parametrize(("perception", "said"), [("Seeing()", ""), ("Own()", 'lacks if __name__ == "__main__"')])
@pytest.mark.parametrize("piped", [False, True])
def test_a_script_without_a_guard_does_not_run_again_in_the_perceptions_process(tmp_path, perception, said, piped):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED.format(paths=[entry for entry in sys.path if entry], perception=perception))
    command, given = ([sys.executable, "-"], script.read_text()) if piped else ([sys.executable, str(script)], None)
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=300)
    assert (done.stdout, done.returncode) == ("seen\n", 0), done.stderr
    assert said in done.stderr if said else not done.stderr


LIMITED = """
import resource, sys
sys.path[:0] = {paths!r}
from pathlib import Path
from livemaking import Camera, Odometry, Seeing
from eagor.live.loop import Loop

if __name__ == "__main__":
    import signal
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    record, said, limit = Path({record!r}), 0, None
    loop = Loop(Camera(), Odometry(), Seeing(), "red chair", record=record, rate=50.0)
    for answer in loop:
        if limit is None:  # some seconds more: the first answer is among what is written
            limit = (record / "run.mcap").stat().st_size + 300_000
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        said += "the recording has ended early" in answer.status_words
        if said > 30:  # also on a machine that is too busy for a direction
            loop.stop()
    print(loop.recording_problem)
"""


@linux
def test_a_full_disk_ends_the_recording_in_words_and_not_the_loop(tmp_path):
    pytest.importorskip("rosbags")
    script, record = tmp_path / "script.py", tmp_path / "run"
    script.write_text(LIMITED.format(paths=[entry for entry in sys.path if entry], record=str(record)))
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "the recording has ended early" in done.stdout
    assert "File too large" in done.stdout
    assert played_torn(record)


def test_a_recording_is_played_again_with_the_same_answers_and_is_a_ros_bag(tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    queries, odometry = ["red chair", "blue ball"], Odometry(turn=0.5)
    loop = loop_of(Camera(), Seeing(0.05), queries, poses=odometry, record=tmp_path / "run", pictures="png")
    answers = followed(loop, well, lambda _: loop.counts.looks > 10)
    wanted = [answer.as_dict() for answer in answers]
    assert [answer.as_dict() for answer in Replay(tmp_path / "run")] == wanted
    assert Bag(tmp_path / "run").topics == {
        "/eagor/answers": "std_msgs/msg/String",
        "/eagor/direction/blue_ball": "geometry_msgs/msg/Vector3Stamped",
        "/eagor/direction/red_chair": "geometry_msgs/msg/Vector3Stamped",
        "/eagor/events": "std_msgs/msg/UInt8MultiArray",
        "/eagor/image/compressed": "sensor_msgs/msg/CompressedImage",
        "/eagor/odom": "nav_msgs/msg/Odometry",
    }
    found = {}
    for _, topic, _, message in read_bag(tmp_path / "run"):
        found.setdefault(topic, []).append(message)
    assert [json.loads(each.data) for each in found["/eagor/answers"]] == wanted
    assert np.array_equal(image_from_msg(found["/eagor/image/compressed"][0]), np.full((16, 32, 3), 90))
    pose = pose_from_msg(found["/eagor/odom"][-1])
    assert np.allclose(pose.world_R_body, yawed(0.5 * stamp_of(found["/eagor/odom"][-1])), atol=1e-6)
    last = found["/eagor/direction/red_chair"][-1].vector
    (red,) = (answer for answer in answers[-2:] if answer.query == "red chair")
    assert np.allclose([last.x, last.y, last.z], red.direction)
    with rosbag2.Reader(tmp_path / "run") as reader:  # as others read it, by its metadata.yaml
        assert reader.message_count == sum(map(len, found.values()))


def test_a_camera_that_hangs_at_one_picture_while_it_turns_is_told():
    """Stamps are fresh and pictures come; only that nothing in them changes tells. One that stands still is fine."""
    camera = Camera(changing=True)

    def hangs(_):
        camera.changing = False
        return True

    def lives(_):
        camera.changing = True
        return True

    answers = followed(
        loop_of(camera, Here(), poses=Odometry(turn=0.5)),
        well,
        hangs,
        says("the picture stays the same"),
        lives,
        well,
    )
    fault = next(fault for answer in answers for fault in answer.faults if "stays the same" in fault.text)
    assert fault.part == "camera"
    still = followed(loop_of(Camera(changing=False), Here(), poses=Odometry(turn=0.0)), well, *[well] * 100)
    assert not any("stays the same" in answer.status_words for answer in still)


def test_the_pictures_tell_how_the_camera_turns(tmp_path):
    pytest.importorskip("cv2")
    room = painted_room(64, 128)
    for number in range(8):
        Image.fromarray(np.roll(room, 4 * number, axis=1)).save(tmp_path / f"{number / 10:.2f}.png")
    told, still = ([*Loop(str(tmp_path), poses, "colour", "red")][-1] for poses in ("auto", None))
    assert told.pose_age is not None
    assert still.pose_age is None
    assert told.estimate.credible_angle < still.estimate.credible_angle


def test_what_the_camera_and_the_odometry_say_of_themselves_is_a_fault_as_long_as_they_do():
    camera, odometry = Camera(), Odometry()
    camera.problem, odometry.problem = "it tells no times", "nothing tells where the camera is"

    def mended(answer):
        camera.problem = odometry.problem = None
        return True

    loop = loop_of(camera, Here(), poses=odometry)
    followed(loop, says(camera.problem, odometry.problem), mended, lambda answer: not says("tells")(answer))
