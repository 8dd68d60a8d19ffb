"""DDS: what one process writes, another reads; and a camera there."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
import warnings

import pytest
from processes import wait_for

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from eagor.errors import DeviceError
from eagor.lab.worlds.painted import painted_room
from eagor.robots.dds import Participant, free_domain
from eagor.robots.go2.camera import PICTURE, DdsCamera, picture_message
from eagor.robots.go2.state import RequestIdentity, Response, ResponseHeader, ResponseStatus
from eagor.sources import check_camera, live_camera

pytestmark = pytest.mark.xdist_group("real time")


def numbered(number):
    return Response(ResponseHeader(RequestIdentity(number, 1), ResponseStatus(0)), "é", [])


OTHER = """
import sys, time
from eagor.robots.dds import Participant, raw
from eagor.robots.go2.state import Response
with Participant(int(sys.argv[1]), "lo") as link:
    writer = link.publish("back", raw(Response))
    link.subscribe("there", raw(Response), lambda m, when: writer.write(m), reliable=True)
    while not writer.readers: time.sleep(0.01)
    sys.stdin.read()
"""


def test_another_process_gets_every_message_unchanged_until_the_link_is_closed():
    domain, got = free_domain(), []
    with Participant(domain, "lo") as link:
        writer = link.publish("there", Response)
        reader = link.subscribe("back", Response, lambda m, when: got.append((m, when)), reliable=True)
        with subprocess.Popen([sys.executable, "-c", OTHER, str(domain)], stdin=subprocess.PIPE) as peer:
            wait_for(lambda: writer.readers == 1 and len(reader.matched) == 1)
            for number in range(20):
                writer.write(numbered(number))
                wait_for(lambda: len(got) == number + 1)  # noqa: B023
            assert link.topics(0.3).keys() == {"there", "back"}
            peer.communicate(timeout=20)
    assert [message for message, _ in got] == [numbered(number) for number in range(20)]
    with pytest.raises(DeviceError, match="a message of there cannot be sent: its link is closed"):
        writer.write(numbered(20))
    assert (writer.readers, reader.matched) == (0, frozenset())


def test_a_callback_that_raises_is_told_once_and_counted():
    got = []

    def received(m, when):
        got.append(m.header.identity.id)
        raise RuntimeError("no")

    with warnings.catch_warnings(record=True) as said, Participant(free_domain(), "lo") as link:
        warnings.simplefilter("always")
        reader = link.subscribe("a", Response, received, reliable=True)
        writer = link.publish("a", Response)
        wait_for(lambda: writer.readers == 1 and reader.matched)
        for number in range(3):
            writer.write(numbered(number))
        wait_for(lambda: len(got) == 3)
    assert (got, reader.problem) == ([0, 1, 2], "no")
    assert [str(warning.message) for warning in said] == [
        "a: a message cannot be used (RuntimeError: no); it is left out, and others like it"
    ]


def test_domains_and_interfaces_that_cannot_be():
    for domain, interface, said in (
        (233, "lo", "DDS domain 233; wanted a whole number from 0 to 232"), (True, "lo", "DDS domain True"),
        (3, "wlan77", "there is no network interface 'wlan77'; this machine has .*lo"),
    ):  # fmt: skip
        with pytest.raises(DeviceError, match=said):
            Participant(domain, interface)
    domain = free_domain()
    with Participant(domain, "lo"), pytest.raises(DeviceError, match="is already used on lo in this process"):
        Participant(domain)  # on any interface


def test_a_camera_gives_the_newest_picture_with_its_time_of_capture():
    domain, ended, room = free_domain(), threading.Event(), painted_room(16, 32)
    with Participant(domain, "lo") as link:
        writer = link.publish("rt/image", PICTURE)

        def send(stamp, rows=16, good=9999):
            data = picture_message(room[:rows], stamp, "x3").data
            writer.write(PICTURE(data[:good].ljust(len(data), b"\0")))

        def film():
            while not ended.wait(0.05):
                send(time.time() - 1)

        thread = threading.Thread(target=film)
        thread.start()
        try:
            check_camera(DdsCamera("rt/image", domain, "lo", rows=8))
            camera = DdsCamera("rt/image", domain, "lo")
        finally:
            ended.set()
            thread.join()
        with contextlib.closing(camera), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            frames = iter(camera)
            assert 1.0 <= time.time() - next(frames).stamp < 20
            # Too old, damaged, no panorama, good.
            for number, each in enumerate(((1e9,), (2.0e9, 16, 100), (2.0e9, 8), (2.1e9,)), start=1):
                threading.Timer(0.3 * number, send, each).start()
            frame = next(frames)
        assert (frame.stamp, frame.picture.shape, camera.problem) == (2.1e9, (16, 32, 3), None)
        assert camera.dropped >= 3
        assert sum("a picture is left out" in str(each.message) for each in said) == 2


def test_without_pictures_there_is_no_camera(monkeypatch):
    monkeypatch.setattr(live_camera, "PATIENCE", 0.2)
    with pytest.raises(DeviceError, match=r"rt/none: no picture came within 0 s. Is something sending pictures there?"):
        DdsCamera("rt/none", free_domain(), "lo")
