"""A studio in a process of its own, for tests: started as people start it, spoken to as its page does."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from websockets.sync.client import ClientConnection, connect

PATIENCE = 300.0  # seconds: machines of continuous integration are slow


class Served:
    """A studio that listens at `address`, which may hold a token; its `socket` does then, too."""

    def __init__(self, address: str, process: subprocess.Popen[str]) -> None:
        self.address, self.process = address, process
        told = httpx.URL(address)
        self.host = f"127.0.0.1:{told.port}"
        self.http = httpx.Client(base_url=f"http://{self.host}/", timeout=PATIENCE)
        self.socket = f"ws://{self.host}/ws" + (f"?{told.query.decode()}" if told.query else "")

    def ready(self) -> Served:
        """Itself, once it is warm."""
        end = time.monotonic() + PATIENCE
        while not self.http.get("/api/state").json()["ready"]:
            assert time.monotonic() < end, "the studio is not ready"
            time.sleep(0.1)
        return self

    @contextmanager
    def page(self, **headers: str) -> Iterator[Page]:
        """A page that has connected."""
        with connect(self.socket, max_size=None, additional_headers=headers or None) as line:
            yield Page(line)


class Page:
    """One page's socket."""

    def __init__(self, line: ClientConnection) -> None:
        self.line = line
        self.blobs: dict[str, bytes] = {}

    def say(self, **message: Any) -> None:
        self.line.send(json.dumps(message))

    def hear(self) -> dict[str, Any]:
        """The header of the next message; its blobs are in `blobs`."""
        frame = self.line.recv(timeout=PATIENCE)
        assert isinstance(frame, bytes)
        (length,) = struct.unpack("<I", frame[:4])
        header, rest = json.loads(frame[4 : 4 + length]), frame[4 + length :]
        self.blobs = {}
        for each in header["blobs"]:
            self.blobs[each["name"]], rest = rest[: each["bytes"]], rest[each["bytes"] :]
        assert not rest
        return header

    def until(self, wanted: Any) -> dict[str, Any]:
        """The first message that is `wanted`: of a type, or as a function says."""
        fits = (lambda header: header["type"] == wanted) if isinstance(wanted, str) else wanted
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            header = self.hear()
            if fits(header):
                return header
            assert header["type"] != "problem", header
        raise AssertionError("waited in vain")


def children(process: int) -> list[int]:
    """All processes that a process has started, and they have. Linux."""
    found: list[int] = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += [child, *children(child)]
    return found


@contextmanager
def studio(*options: str | Path) -> Iterator[Served]:
    """A studio with these options of its command, at a free port."""
    command = [sys.executable, "-W", "error", "-m", "eagor", "studio", "--port", "0", "--json", *map(str, options)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, "the studio has not started"
        served = Served(json.loads(line)["address"], process)
        yield served
        served.http.close()
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
