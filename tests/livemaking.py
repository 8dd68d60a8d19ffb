"""Cameras, odometry and perceptions for tests of the live loop: each does exactly what its name says."""

from __future__ import annotations

import itertools
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from eagor import ErpGrid, Evidence
from eagor.errors import DeviceError, QueryError
from eagor.sources import Frame, Pose
from eagor.sphere import world_R_body

GRID = ErpGrid(16, 32)
BLANK = np.full((16, 32, 3), 90, dtype=np.uint8)


def yawed(angle):
    return world_R_body(angle, 0.0, 0.0)


class Camera:
    """A live camera of `rate` pictures per second. `stamps` changes each stamp; it ends after `count` pictures.

    All is grey, with the noise of a sensor while it is `changing`.
    """

    latency, dropped, live, grid = 0.0, 0, True, GRID

    def __init__(self, rate=50.0, count=None, stamps=lambda stamp: stamp, changing=True):
        self.rate, self.count, self.stamps, self.changing = rate, count, stamps, changing
        self.closed = threading.Event()

    def __iter__(self):
        for number in itertools.count() if self.count is None else range(self.count):
            if self.closed.wait(1 / self.rate):
                return
            picture = BLANK + np.uint8(number % 2) if self.changing else BLANK
            yield Frame(self.stamps(time.time()), picture, f"{number}")

    def close(self):
        self.closed.set()


class Unplugged(Camera):
    """A camera that raises once it is `pulled`."""

    def __init__(self, **options):
        super().__init__(**options)
        self.pulled = threading.Event()

    def __iter__(self):
        for frame in super().__iter__():
            if self.pulled.is_set():
                break
            yield frame
        raise DeviceError("/dev/video7 is gone; plug it in")


class Stalled(Unplugged):
    """A camera that gives no more pictures once it is `pulled`, but does not end."""

    def __iter__(self):
        with suppress(DeviceError):
            yield from super().__iter__()
        self.closed.wait()


class Film:
    """A recording: `count` pictures, `rate` per second of its own clock, which begins at 100 s."""

    latency, dropped, live, grid = 0.0, 0, False, GRID

    def __init__(self, count=10, rate=10.0, start=100.0):
        self.count, self.rate, self.start = count, rate, start

    def __iter__(self):
        for number in range(self.count):
            yield Frame(self.start + number / self.rate, BLANK, f"{number}")

    def close(self):
        pass


class Odometry:
    """Live poses at `rate`, turning by `turn` radians per second, until it is `pulled`: then it says nothing more."""

    def __init__(self, rate=100.0, turn=0.0):
        self.rate, self.turn = rate, turn
        self.closed, self.pulled = threading.Event(), threading.Event()

    def __iter__(self):
        while not self.pulled.is_set():
            if self.closed.wait(1 / self.rate):
                return
            now = time.time()
            yield Pose(now, yawed(self.turn * now))
        self.closed.wait()

    def close(self):
        self.closed.set()


class Track:
    """Recorded poses."""

    def __init__(self, poses):
        self.poses = poses

    def __iter__(self):
        return iter(self.poses)

    def close(self):
        pass


class Seeing:
    """A perception that always sees the thing ahead, after `seconds`. Pictures and their stamps are noted in `log`."""

    def __init__(self, seconds=0.0, log=None, direction=(1.0, 0.0, 0.0)):
        self.seconds, self.log, self.direction = seconds, log, direction

    def __call__(self, panorama, query, *, stamp=None):
        if self.log is not None:
            with Path(self.log).open("a") as file:
                file.write(f"{stamp!r} {query} {os.getpid()}\n")
        self.work(query)
        return Evidence.from_points(np.array([self.direction]), scores=np.array([0.9]), stamp=stamp)

    def work(self, query):
        time.sleep(self.seconds)


class Here(Seeing):
    """Cannot be sent to another process: the loop calls it in a thread of this one, which starts at once."""

    def __reduce__(self):
        raise TypeError("it stays here")


class LoadedSlowly(Seeing):
    """Needs 2 seconds to be there."""

    def __setstate__(self, state):
        time.sleep(2.0)
        self.__dict__.update(state)


class Raising(Seeing):
    """A perception that raises at its first `times` looks, then sees."""

    def __init__(self, times, **options):
        super().__init__(**options)
        self.left = times

    def work(self, query):
        self.left -= 1
        if self.left >= 0:
            raise RuntimeError("out of memory")


class Once(Seeing):
    """A perception that does something fatal in its first process only, marked by the file `mark`."""

    def __init__(self, mark, **options):
        super().__init__(**options)
        self.mark = mark

    def work(self, query):
        if not Path(self.mark).exists():
            Path(self.mark).touch()
            self.fate()

    def fate(self):
        raise NotImplementedError


class Hanging(Once):
    """Hangs, deaf to everything but SIGKILL."""

    def fate(self):
        import signal

        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(3600)


class Dying(Once):
    """Its process dies."""

    def fate(self):
        os._exit(7)


class AlwaysDying(Seeing):
    """Its process dies at each look."""

    def work(self, query):
        os._exit(7)


class Ignorant(Seeing):
    """Knows only one query."""

    def work(self, query):
        if query != "red chair":
            raise QueryError(f"{query!r} is not known; ask for a red chair")
