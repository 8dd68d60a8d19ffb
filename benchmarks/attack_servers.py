"""Hostile servers against the client: how long, how much memory, and what of the key is left behind.

    python benchmarks/attack_servers.py [--timeout SECONDS]

Each server does its worst in a process of its own that is watched: seconds until it answers, the highest memory beyond
that of the same process with an honest server, seconds that Ctrl-C takes, and whether the key stands in anything
that it said. Exits with 1 if a bound is broken.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from hostile_server import OK, HostileServer, completion, whole

KEY = "sk-live-7c2e91f0d4"
MOST_MEGABYTES = 250
ASK = """
import sys, time
import numpy as np
from eagor.perception.endpoint import EndpointPerception
look = EndpointPerception("m", (sys.argv[1],), pixels=6272, seam=False, timeout=float(sys.argv[2]), retries=0, key="K")
began = time.monotonic()
try:
    print("fine", look(np.zeros((56, 112, 3), np.uint8), "red chair").source)
except ValueError as error:
    print(type(error).__name__, error)
except KeyboardInterrupt:
    print("interrupted", flush=True)
most = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(time.monotonic() - began, int(most.split()[1]) / 1024)
"""

Answer = Callable[..., None]


def forever(head: bytes, piece: bytes, pause: float) -> Answer:
    def answer(connection, _, gone) -> None:
        connection.sendall(head)
        while not gone.wait(pause):
            connection.sendall(piece)

    return answer


def once(reply: bytes | Callable[[bytes], bytes]) -> Answer:
    def answer(connection, request, _) -> None:
        connection.sendall(reply(request) if callable(reply) else reply)

    return answer


def echo(status: bytes) -> Answer:
    def reply(request: bytes) -> bytes:
        said = {"error": {"message": request.partition(b"\r\n\r\n")[0].decode("latin-1")}}
        return whole(json.dumps(said).encode(), b"HTTP/1.1 " + status + b"\r\ncontent-type: application/json\r\n")

    return once(reply)


def packed(size: int) -> bytes:
    return whole(gzip.compress(b" " * size, 1), OK + b"content-encoding: gzip\r\n")


def hostile() -> dict[str, Answer]:
    """The servers by name; the first is honest."""
    megabyte = b"x" * (1 << 20)
    deep = b"[" * 2_000_000
    servers: dict[str, Answer] = {
        "honest": once(completion("[]")),
        "silent": lambda _, __, gone: gone.wait(),
        "a byte now and then": forever(OK + b"content-length: 99999\r\n\r\n", b" ", 0.5),
        "headers without end": forever(OK, b"x: y\r\n", 0.2),
        "one header without end": forever(OK + b"x: ", megabyte, 0.0),
        "a status without end": forever(b"HTTP/1.1 2", b"0", 0.2),
        "chunks without end": forever(
            OK + b"transfer-encoding: chunked\r\n\r\n", b"100000\r\n" + megabyte + b"\r\n", 0
        ),
        "10 GB": forever(OK + b"content-length: 10000000000\r\n\r\n", megabyte, 0.0),
        "10 GB of an error": forever(b"HTTP/1.1 500 No\r\ncontent-length: 10000000000\r\n\r\n", megabyte, 0.0),
        "gzip of 1 GB": once(packed(1 << 30)),
        "nests": once(whole(deep)),
        "closed at once": once(b""),
        "no HTTP": once(megabyte),
        "to another host": once(b"HTTP/1.1 307 Go\r\nlocation: http://192.0.2.1/v1\r\ncontent-length: 0\r\n\r\n"),
    }
    for what in ('{"a":1,', '"a":1,', "[", '["', "no a ", "(1,2),", "{a=", "\\u0041", "<think>"):
        servers[f"4 MB of {what}"] = once(completion("{" + what * ((4 << 20) // len(what))))
    for status in (b"400 No", b"401 No", b"403 No", b"404 No", b"429 No", b"500 No"):
        servers[f"echo, {status.decode()}"] = echo(status)
    return servers


def attacked(answer: Answer, timeout: float) -> tuple[float, float, str]:
    """Seconds and megabytes that a look at such a server takes, and what came of it."""
    with HostileServer(answer) as server:
        done = subprocess.run(
            [sys.executable, "-c", ASK, server.url, str(timeout)],
            capture_output=True, text=True, env=os.environ | {"K": KEY}, timeout=600, check=False,
        )  # fmt: skip
    said = done.stdout + done.stderr
    *_, last = done.stdout.splitlines() or ["nan nan"]
    seconds, megabytes = map(float, last.split())
    return seconds, megabytes, said


def interrupted(answer: Answer) -> float:
    """Seconds from Ctrl-C in the middle of a call until that has ended. (Then Python has its modules to tidy up.)"""
    came = threading.Event()

    def told(connection, request, gone) -> None:
        came.set()
        answer(connection, request, gone)
        gone.wait()

    with HostileServer(told) as server:
        process = subprocess.Popen(
            [sys.executable, "-c", ASK, server.url, "600"], env=os.environ | {"K": KEY}, stderr=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )  # fmt: skip
        came.wait(60)
        time.sleep(0.2)
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        said = process.stdout.readline()
        seconds = time.monotonic() - began
        process.communicate(timeout=600)
        assert said == b"interrupted\n", said
        return seconds


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--timeout", type=float, default=3.0)
    timeout = options.parse_args().timeout
    servers = hostile()
    _, usual, _ = attacked(servers["honest"], 60.0)
    broken = 0
    print(f"{'server':28s} {'seconds':>8s} {'MB more':>8s}  said")
    for name, answer in servers.items():
        seconds, megabytes, said = attacked(answer, timeout)
        wrong = [] if seconds < timeout + 10 else ["TIME"]
        wrong += ["MEMORY"] if megabytes - usual > MOST_MEGABYTES else []
        wrong += ["KEY"] if KEY in said else []
        wrong += ["BUG"] if "Traceback" in said else []
        broken += bool(wrong)
        print(f"{name:28s} {seconds:8.2f} {megabytes - usual:8.0f}  {' '.join(wrong)} {said.splitlines()[0][:90]}")
    for name in ("silent", "a byte now and then", "headers without end"):
        seconds = interrupted(servers[name])
        broken += seconds > 1
        print(f"Ctrl-C, {name:20s} {seconds:8.2f}  {'TIME' if seconds > 1 else ''}")
    print(f"{broken} bounds broken")
    return min(broken, 1)


if __name__ == "__main__":
    sys.exit(main())
