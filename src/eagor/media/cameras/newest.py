"""The newest frame of a source: a slow reader never works through a queue."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import suppress

from eagor.media.frames import CameraSource, Frame

__all__ = ["Newest"]

PATIENCE = 5.0  # seconds that `close` waits for the thread; one that hangs in a driver is left behind


class Newest:
    """A thread reads `source`; `take` gives the newest frame that was not taken yet.

    Of a live source, frames that came meanwhile are skipped and counted in `skipped`. A source that keeps only the
    newest itself (its attribute `keeps_newest`; its `dropped` counts) is asked when somebody wants a frame: what nobody
    takes is not even stitched. Of a file, nothing is skipped: the next picture is read once the last one was taken.

    `problem`: what is wrong with the source now, in words, or None; `ended`: whether no frame can come any more. A
    context manager; `close` also closes the source, and may be called twice.
    """

    def __init__(self, source: CameraSource) -> None:
        self.source = source
        self.skipped = 0
        self._eager = source.live and not getattr(source, "keeps_newest", False)
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._wanted = self._closed = self._ended = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="eagor-newest-frame", daemon=True)
        self._thread.start()

    def __enter__(self) -> Newest:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def ended(self) -> bool:
        """Whether the source has ended, or was closed, and its last frame was taken."""
        with self._changed:
            return (self._ended or self._closed) and self._frame is None

    @property
    def problem(self) -> str | None:
        """What is wrong right now, in words; None if nothing is."""
        with self._changed:
            if self._error is not None:
                return str(self._error)
        return getattr(self.source, "problem", None)

    @property
    def dropped(self) -> int:
        """Frames of the source that nobody got: skipped here, or dropped by the source itself."""
        return self.skipped + self.source.dropped

    def take(self, timeout: float | None = None) -> Frame | None:
        """The newest frame that was not taken yet; waits for one up to `timeout` seconds (None: for ever).

        None if none came in time, or none can come any more (`ended`). Raises the source's error, once, if it ended in
        one.
        """
        end = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            self._wanted = True
            self._changed.notify_all()
            while self._frame is None and not (self._ended or self._closed):
                left = None if end is None else end - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._changed.wait(left)
            frame, self._frame = self._frame, None
            if frame is not None:
                self._wanted = False
                self._changed.notify_all()
            elif self._error is not None and not self._closed:
                error, self._error = self._error, None
                raise error
            return frame

    def close(self) -> None:
        """Close the source and end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self.source.close()
        if self._thread is not threading.current_thread():
            self._thread.join(PATIENCE)

    def _read(self) -> None:
        frames: Iterator[Frame] | None = None
        try:
            frames = iter(self.source)
            while self._asked():
                frame = next(frames, None)
                if frame is None:
                    break
                with self._changed:
                    self.skipped += self._frame is not None
                    self._frame = frame
                    self._changed.notify_all()
        except Exception as error:  # whoever takes the next frame is told
            with self._changed:
                self._error = error
        finally:
            if frames is not None and hasattr(frames, "close"):
                with suppress(Exception):
                    frames.close()  # type: ignore[attr-defined]
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _asked(self) -> bool:
        """Wait until the next frame is to be read; False after `close`."""
        with self._changed:
            while not self._closed and not self._eager and (self._frame is not None or not self._wanted):
                self._changed.wait()
            return not self._closed
