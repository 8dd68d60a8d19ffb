"""The process that sees for all sessions: it builds apartments, renders and decodes pictures, runs perceptions.

It is told tuples and says tuples, each with the number of the session. Building takes seconds and has a thread of its
own, so that other sessions go on seeing meanwhile. A panorama is said before the look at it is taken. Apartments and
photographs are kept up to `HOMES` and `PHOTOS` bytes, and those that no session uses up to `SPARE`.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import EagorError, QueryError
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.lab.agents.models import is_privileged
from eagor.lab.envs.places import LOOK_ROWS, Place, load_place
from eagor.lab.worlds.render import Photograph
from eagor.media import Frame
from eagor.media.panorama import read_photograph
from eagor.media.video import Video
from eagor.odometry.visual import VisualOdometer
from eagor.perception import knows_classes, load, rows_of
from eagor.perception.replay import look_if_recorded
from eagor.studio.caching import Kept, given_back
from eagor.studio.houses import House, house_of, place_of
from eagor.studio.messages import jpeg
from eagor.studio.session import (
    LOOKS,
    Built,
    Close,
    Loaded,
    Opened,
    Panorama,
    Question,
    Refused,
    See,
    Seen,
    Turn,
    Turned,
)  # fmt: skip
from eagor.studio.steps import calibration_of, lens_of, shown_jpeg
from eagor.tracking import Around, TrackerConfig

__all__ = ["ROWS", "Reel", "serve"]

ROWS = 512  # of a frame, at most


@dataclass(eq=False)
class Reel:
    """The frames of a video from `start` on (seconds), `LOOKS` per second at most.

    The camera's rotation is that of the file's motion track, if it has one, else that of the pictures themselves.
    """

    path: Path
    start: float = 0.0
    hfov: float | None = None  # of an ordinary camera, radians
    _video: Video = field(init=False)
    _frames: Iterator[Frame] = field(init=False)
    _odometer: VisualOdometer = field(init=False)
    _found: tuple[Frame, np.ndarray, bool] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._video = Video(self.path, rate=LOOKS, start=self.start, rows=ROWS)
        self._frames, self._odometer = iter(self._video), VisualOdometer()

    def next(self, again: bool = False) -> tuple[Frame, np.ndarray, bool] | None:
        """The next frame, the camera's rotation ``(3, 3)`` there, and whether the world starts anew; None at the end.

        `again`: the one that was given last, if there is one. Raises `EagorError` for a file that is cut off.
        """
        if again and self._found is not None:
            return *self._found[:2], False
        frame = next(self._frames, None)
        if frame is None:
            return None
        if (motion := self._video.motion) is not None:
            with suppress(EagorError):  # the track may be shorter than the video
                self._found = frame, motion.world_R_body(frame.stamp), False
                return self._found
        turned = self._odometer.add(frame.picture, frame.stamp, _grid(frame.picture, self.hfov))
        self._found = frame, np.asarray(turned.world_R_body), turned.lost
        return self._found


FIRST_ROWS = 256  # of the first panorama of an apartment
PHOTO_ROWS = 768  # of a photograph that is sent, at most
LOOKED_ROWS = 512  # of a photograph that is looked at, at most
STILL = (0.0, 0.0, 0.0)
HOMES = 1 << 30  # bytes of apartments: some 20, of which each takes seconds to build
PHOTOS = 1 << 29  # bytes of photographs: two of the largest that may be dropped
SPARE = 1 << 27  # bytes of apartments, and of photographs, that wait to be used again


@dataclass(frozen=True, eq=False)
class _Home:
    """An apartment that has been rendered once, so that its light and its triangles are there."""

    place: Place
    house: House


def serve(line: Connection, perceptions: tuple[str, ...], seed: int | None) -> None:
    """The life of the process. It begins with the apartment `seed` (None: none) and the first of `perceptions`."""
    lock = threading.Lock()

    def say(item: Any) -> None:
        with lock, suppress(OSError):
            line.send(item)

    looks: queue.SimpleQueue[See | Turn | Close] = queue.SimpleQueue()
    reels: dict[int, Reel] = {}
    used: dict[int, int | Path] = {}  # the apartment or the photograph of each session
    builds: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_forever, args=(looks, lambda job: _serve(job, reels, used, say)), daemon=True).start()
    threading.Thread(target=_forever, args=(builds, lambda job: _build(job, say)), daemon=True).start()
    if seed is not None:
        builds.put(("warm", seed, perceptions[0]))
    with suppress(EOFError, OSError):
        while (job := line.recv()) is not None:
            if isinstance(job, See | Turn | Close):
                looks.put(job)
                continue
            if job[0] in ("house", "picture"):
                used[job[1]] = job[2]
            builds.put(job)


def _forever(jobs: queue.SimpleQueue[Any], work: Callable[[Any], None]) -> None:
    while True:
        work(jobs.get())


def _build(job: tuple[Any, ...], say: Callable[[Any], None]) -> None:
    """("warm", seed, perception), ("house", session, seed), ("picture", session, file), ("perception", session, it)."""
    what, *rest = job
    try:
        if what == "warm":
            seed, perception = rest
            home = _homes(seed)
            _looked(See(0, 0.0, np.eye(3), _eye(home), Question(home.house.query, perception), 0, seed))
            say(("warm",))
        elif what == "house":
            session, seed = rest
            say(Built(session, _homes(seed).house))
        elif what == "perception":
            session, perception = rest
            say(Loaded(session, perception, calibration_of(_loaded(perception), TrackerConfig())))
        elif what == "picture":
            session, path, hfov = rest
            found = _photograph(path)
            grid = _grid(found.picture, hfov)
            say(Opened(session, shown_jpeg(found.picture, grid, PHOTO_ROWS), found.facts, lens_of(grid)))
    except Exception as error:
        if what == "warm":
            say(("warm",))  # whoever opens it is told what is wrong
        else:
            of = Question("", rest[1]) if what == "perception" else None
            say(Refused(rest[0], what, _said(error), of))


def _furnished(seed: int) -> _Home:
    """The apartment, after a first picture of it (its light takes seconds), which no other thread renders meanwhile."""
    place = place_of(seed)
    home = _Home(place, house_of(seed, place))
    place.renderer.panorama(_eye(home), np.eye(3), FIRST_ROWS, range=False, ids=False)
    return home


def _eye(home: _Home) -> np.ndarray:
    return home.place.eye(home.house.start, 1.25)


_homes = Kept(_furnished, HOMES)
_photograph = Kept(partial(read_photograph, warn=False), PHOTOS)  # the page asks of what camera it is


def _serve(
    job: See | Turn | Close, reels: dict[int, Reel], used: dict[int, int | Path], say: Callable[[Any], None]
) -> None:
    if isinstance(job, Close):
        reels.pop(job.session, None)
        used.pop(job.session, None)
        _leave(list(used.values()))
    elif isinstance(job, Turn):
        _turn(job, reels, say)
    else:
        _see(job, say)


def _leave(used: Collection[Any]) -> None:
    """Forget what none of the sessions uses, but for `SPARE` bytes."""
    _homes.release(used, SPARE)
    _photograph.release(used, SPARE)
    load_place.cache_clear()
    given_back()


def _turn(job: Turn, reels: dict[int, Reel], say: Callable[[Any], None]) -> None:
    """The next frame of a video, and a look at it."""
    try:
        if job.start is not None or job.session not in reels:
            reels[job.session] = Reel(job.path, job.start or 0.0, job.hfov)
        found = reels[job.session].next(job.again)
        if found is None:
            say(Turned(job.session, 0.0, np.eye(3), b"", None, over=True))
            return
        frame, pose, lost = found
        looks, around, asked, grid = (), None, job.question, _grid(frame.picture, job.hfov)
        if asked is not None:
            try:
                looks, around = _seen_by(asked, frame.picture, frame.stamp, pose, grid)
            except EagorError as error:
                say(_refusal(job, error))
                asked = None
        small = shown_jpeg(frame.picture, grid, FIRST_ROWS)
        say(Turned(job.session, frame.stamp, pose, small, asked, looks, lost, lens=lens_of(grid), around=around))
    except Exception as error:
        say(Refused(job.session, "picture", _said(error)))


def _see(job: See, say: Callable[[Any], None]) -> None:
    """Render, say so, look, say so."""
    try:
        shown = _rendered(job, job.rows) if job.rows else None
        if shown is not None:
            say(Panorama(job.session, job.stamp, job.world_R_body, jpeg(shown)))
        if job.question is not None:
            say(Seen(job.session, job.stamp, job.question, *_looked(job, shown)))
    except Exception as error:
        say(_refusal(job, error))


def _refusal(job: See | Turn, error: Exception) -> Refused:
    return Refused(job.session, "query" if isinstance(error, QueryError) else "look", _said(error), job.question)


def _rendered(job: See, rows: int) -> np.ndarray:
    if job.seed is not None:
        assert job.position is not None
        found = (
            _homes(job.seed).place.renderer.panorama(job.position, job.world_R_body, rows, range=False, ids=False).rgb
        )
    else:
        assert job.picture is not None
        found = _small(job.picture, rows).panorama(STILL, job.world_R_body, rows).rgb
    assert found is not None
    return found


def _looked(job: See, shown: np.ndarray | None = None) -> tuple[tuple[Evidence, ...], Around | None]:
    """The looks of the question's perception at what is seen from its pose; `shown`: the panorama that was rendered."""
    asked = job.question
    assert asked is not None
    perception = _loaded(asked.perception)
    if is_privileged(perception):
        if job.seed is None:
            raise QueryError(f"{asked.perception} knows only simulated apartments; choose another perception")
        assert job.position is not None
        ids = _homes(job.seed).place.ids(job.position, job.world_R_body, LOOK_ROWS)
        return (_informed(asked.perception, job.seed)(ids, asked.query, stamp=job.stamp),), None
    rows = rows_of(perception)
    if job.picture is not None and job.hfov is not None:
        picture = _photograph(job.picture).picture
        return _seen_by(asked, picture, job.stamp, job.world_R_body, _grid(picture, job.hfov))
    if job.picture is not None:
        rows = max(128, min(rows, LOOKED_ROWS, _photograph(job.picture).picture.shape[0]))
    panorama = shown if shown is not None and len(shown) == rows else _rendered(job, rows)
    return _seen_by(asked, panorama, job.stamp, job.world_R_body, None)


def _seen_by(
    asked: Question, picture: np.ndarray, stamp: float, world_R_body: np.ndarray, grid: PerspectiveGrid | None
) -> tuple[tuple[Evidence, ...], Around | None]:
    """The looks for a question, and at all else if its perception knows its classes."""
    perception = _loaded(asked.perception)
    if not knows_classes(perception):
        return look_if_recorded(perception, picture, asked.query, stamp, world_R_body, grid), None
    (look,), around = perception.around(picture, (asked.query,), stamp, world_R_body, grid)
    if isinstance(look, QueryError):
        raise look
    return (look,), around


def _grid(picture: np.ndarray, hfov: float | None) -> PerspectiveGrid | None:
    """The pixels of an ordinary camera's picture, which looks ahead; None for a panorama."""
    return None if hfov is None else PerspectiveGrid(picture.shape[0], picture.shape[1], hfov)


@lru_cache(maxsize=4)
def _loaded(perception: str) -> Any:
    return load(perception)


@lru_cache(maxsize=64)
def _informed(perception: str, seed: int) -> Any:
    """A perception that is told the truth, with mistakes of its own in this apartment."""
    return _loaded(perception).episode(_homes(seed).house.things, seed)


@lru_cache(maxsize=16)
def _small(path: Path, rows: int) -> Photograph:
    """The photograph, shrunk once to the rows that are looked at."""
    found = Photograph(_photograph(path).picture).panorama(STILL, np.eye(3), rows).rgb
    assert found is not None
    return Photograph(found)


def _said(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, EagorError) and text else f"{type(error).__name__}: {text}".rstrip(": ")
