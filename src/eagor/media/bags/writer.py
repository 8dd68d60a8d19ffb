"""Recording of messages: a ROS 2 bag in MCAP, by `rosbags`, of which a crash takes little.

`rosbags` keeps up to a megabyte in memory, and Python the rest of a block. So chunks are closed often here.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from eagor._extras import need
from eagor.errors import EagorError, FormatError, StorageError
from eagor.media.ros_messages import nanoseconds, store

__all__ = ["AT_RISK", "BagWriter"]

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
