"""The studio's server, measured from outside: updates per second, how old they are, the first picture, many pages.

    python benchmarks/studio.py                            one page
    python benchmarks/studio.py --pages 20 --seconds 300   twenty pages, one of which reads one message in two seconds
    python benchmarks/studio.py --apartments 12 --seconds 10   one page, and the memory after each apartment in a row

Each page walks in the built-in apartment, steered by the policy or turned by the person. Ages are from the moment at
which the server makes a step to the moment at which this program has it, on one clock. CPU times are of the processes
of the server, so they hold on a busy machine, too. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

TICKS = os.sysconf("SC_CLK_TCK")
NARROW = 8192  # bytes that wait in the network for the slow page
SLOW = 2.0  # seconds between two messages that the slow page reads
PROBE = 0.5  # seconds between two questions to the server's loop


class Seen:
    """What one page has received."""

    def __init__(self) -> None:
        self.arrivals: list[float] = []
        self.ages: list[float] = []
        self.numbers: list[int] = []
        self.beliefs = self.pictures = self.looks = self.bytes = 0
        self.first: float | None = None
        self.problems: list[str] = []


async def page(address: str, opening: dict[str, Any], until: float, seen: Seen, rest: float = 0.0) -> None:
    """Open a view and read until a time; `rest`: seconds between two messages."""
    # A slow page keeps its messages in the network, too: small buffers make it slow for the server.
    place = urlsplit(address)
    pipe = socket.socket()
    if rest:
        pipe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, NARROW)
    pipe.connect((place.hostname, place.port))
    async with connect(address, sock=pipe, max_size=None, max_queue=1 if rest else 16, compression=None,
                       ping_interval=None) as line:  # fmt: skip
        begun = time.monotonic()
        await line.send(json.dumps(opening))
        while (left := until - time.monotonic()) > 0:
            try:
                frame = await asyncio.wait_for(line.recv(), left)
            except TimeoutError:
                return
            except ConnectionClosed as closed:
                seen.problems.append(f"the connection was closed: {closed}")
                return
            assert isinstance(frame, bytes)
            (length,) = struct.unpack("<I", frame[:4])
            header = json.loads(frame[4 : 4 + length])
            seen.bytes += len(frame)
            if header["type"] == "problem":
                seen.problems.append(header["problem"])
            if header["type"] == "scene" and opening["drive"] == "person":
                await line.send(json.dumps({"type": "drive", "by": "person", "turn": 0.5}))
            if header["type"] != "step":
                continue
            seen.arrivals.append(time.monotonic())
            seen.ages.append(time.time() - header["sent"])
            seen.numbers.append(header["number"])
            seen.beliefs += "belief" in header
            seen.looks += header["look"]["fresh"]
            if "panorama" in header:
                seen.pictures += 1
                seen.first = seen.first or time.monotonic() - begun
            if rest:
                await asyncio.sleep(rest)


async def in_row(address: str, apartments: int, seconds: float, drive: str, server: int) -> list[dict[str, float]]:
    """One page after the other, each so long in an apartment of its own: megabytes of each process after each."""
    found = []
    for seed in range(1, apartments + 1):
        seen = Seen()
        opening = {"type": "open", "view": "walk", "drive": drive, "seed": seed}
        while not seen.pictures:  # building takes some seconds
            await page(address.replace("http:", "ws:") + "ws", opening, time.monotonic() + seconds, seen)
        await asyncio.sleep(1.0)  # the page is closed
        found.append({"apartment": seed, **{name: round(mb) for name, (_, mb) in named(cost(server)).items()}})
    return found


async def probe(address: str, until: float, found: list[float]) -> None:
    """How long the server's loop takes to answer, again and again."""
    while time.monotonic() < until:
        begun = time.monotonic()
        await asyncio.to_thread(lambda: urlopen(f"{address}api/state").read())
        found.append(time.monotonic() - begun)
        await asyncio.sleep(PROBE)


async def measure(address: str, pages: int, seconds: float, drive: str) -> dict[str, Any]:
    """So many pages at once; the last of several reads slowly."""
    line = address.replace("http:", "ws:") + "ws"
    opening = {"type": "open", "view": "walk", "drive": drive}
    seen = [Seen() for _ in range(pages)]
    answers: list[float] = []
    until = time.monotonic() + seconds
    slow = pages > 1
    tasks = [
        page(line, opening, until, each, SLOW if slow and index == pages - 1 else 0.0)
        for index, each in enumerate(seen)
    ]
    await asyncio.gather(*tasks, probe(address, until, answers))
    quick = seen[:-1] if slow else seen
    ages = np.concatenate([each.ages for each in quick])
    gaps = np.concatenate([np.diff(each.arrivals) for each in quick])
    found = {
        "pages": pages,
        "seconds": seconds,
        "drive": drive,
        "updates_per_second": spread([len(each.arrivals) / seconds for each in quick]),
        "beliefs_per_second": spread([each.beliefs / seconds for each in quick]),
        "looks_per_second": spread([each.looks / seconds for each in quick]),
        "pictures_per_second": spread([each.pictures / seconds for each in quick]),
        "kilobytes_per_second": spread([each.bytes / seconds / 1e3 for each in quick]),
        "first_picture_s": spread([seconds if each.first is None else each.first for each in quick]),
        "age_ms": quantiles(1e3 * ages),
        "gap_ms": quantiles(1e3 * gaps),
        "loop_answers_ms": quantiles(1e3 * np.array(answers)),
        "steps": sum(each.numbers[-1] - each.numbers[0] for each in seen if each.numbers),
        "looks": sum(each.looks for each in seen),
        "problems": sorted({text for each in seen for text in each.problems}),
    }
    if slow:
        last = seen[-1]
        skipped = int(np.sum(np.diff(last.numbers) - 1)) if len(last.numbers) > 1 else 0
        found["slow_page"] = {"messages": len(last.arrivals), "steps_skipped": skipped, "age_ms": quantiles(
            1e3 * np.array(last.ages))}  # fmt: skip
    return found


def spread(values: list[float]) -> dict[str, float]:
    """Least, mean and most."""
    return {"least": round(min(values), 2), "mean": round(float(np.mean(values)), 2), "most": round(max(values), 2)}


def quantiles(values: np.ndarray) -> dict[str, float]:
    """Median, 95 % and worst."""
    if not len(values):
        return {}
    return {name: round(float(np.quantile(values, q)), 1) for name, q in (("p50", 0.5), ("p95", 0.95), ("worst", 1.0))}


def family(process: int) -> list[int]:
    """A process and all that it has started."""
    found = [process]
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += family(child)
    return found


def cost(process: int) -> dict[int, tuple[float, float]]:
    """CPU seconds and megabytes in memory of each process of a family, by its number."""
    found = {}
    for each in family(process):
        if b"resource_tracker" in Path(f"/proc/{each}/cmdline").read_bytes():
            continue
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        found[each] = (int(fields[11]) + int(fields[12])) / TICKS, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return found


def named(costs: dict[int, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """The processes by their names: they are started in this order."""
    return dict(zip(("server", "engine", "eye", "runs"), (costs[each] for each in sorted(costs)), strict=False))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pages", type=int, default=1)
    parser.add_argument("--apartments", type=int, default=0, help="in a row, on one page, for --seconds each")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--drive", choices=("policy", "person"), default="person", help="person: it turns all the time")
    options = parser.parse_args()
    command = [sys.executable, "-m", "eagor", "studio", "--port", "0", "--json"]
    begun = time.monotonic()
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = json.loads(server.stdout.readline())["address"]
        while not json.load(urlopen(f"{address}api/state"))["ready"]:
            time.sleep(0.1)
        warm, before, load = time.monotonic() - begun, cost(server.pid), os.getloadavg()[0]
        if options.apartments:
            told = in_row(address, options.apartments, options.seconds, options.drive, server.pid)
            print(json.dumps({"memory_mb": asyncio.run(told)}, indent=1))
            return
        found = {"warm_s": round(warm, 1), "load_before": round(load, 1)}
        found |= asyncio.run(measure(address, options.pages, options.seconds, options.drive))
        after = cost(server.pid)
        begun_with = named(before)
        spent = {name: each[0] - begun_with.get(name, (0.0, 0.0))[0] for name, each in named(after).items()}
        steps, looks = found.pop("steps"), found.pop("looks")
        found["cpu_share"] = {name: round(seconds / options.seconds, 3) for name, seconds in spent.items()}
        found["cpu_ms"] = {
            "server, per update": round(1e3 * spent["server"] / max(steps, 1), 2),
            "engine, per update": round(1e3 * spent["engine"] / max(steps, 1), 2),
            "eye, per look": round(1e3 * spent["eye"] / max(looks, 1), 1),
        }
        found["memory_mb"] = {name: round(each[1]) for name, each in named(after).items()}
        print(json.dumps(found, indent=1))
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(60)


if __name__ == "__main__":
    main()
