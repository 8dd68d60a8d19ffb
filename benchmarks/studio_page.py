"""The studio's page in a real browser: first picture, updates that arrive and are evaluated, drawings, and their age.

    python benchmarks/studio_page.py                       Debian's Chromium, which draws in software without a GPU
    python benchmarks/studio_page.py --seconds 60 --size 1920x1080

A page walks in the built-in apartment, steered by the policy. An age is from the moment at which the server makes a
step to the moment at which its drawing is finished. Times of the wall clock tell little on a busy machine: the load is
printed with them, and the CPU time that the browser's processes take for a drawing. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from typing import Any
from urllib.request import urlopen

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

STATS = "window.eagorStudio?.summary.stats ?? null"

QUANTILES = (("p50", 50), ("p95", 95), ("max", 100))


def warm(address: str) -> None:
    """Wait until the server has built its apartment."""
    while True:
        with suppress(OSError), urlopen(address + "api/state") as answer:
            if json.load(answer)["ready"]:
                return
        time.sleep(0.2)


def cpu(browser: Browser) -> dict[str, float]:
    """CPU seconds so far of the browser's kinds of processes."""
    found: dict[str, float] = {}
    for one in browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]:
        found[one["type"]] = found.get(one["type"], 0.0) + one["cpuTime"]
    return found


def since(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    """The CPU seconds between two times."""
    return {kind: time - before.get(kind, 0.0) for kind, time in after.items()}


def measured(browser: Browser, page: Page, address: str, seconds: float) -> dict[str, Any]:
    """What the page counts in so many seconds, after the first belief is drawn."""
    start = cpu(browser)
    page.goto(address)
    while not (page.evaluate(STATS) or {}).get("firstPicture"):
        page.wait_for_timeout(20)
    first, spent = page.evaluate(STATS)["firstPicture"], since(start, cpu(browser))
    while not page.evaluate("window.eagorStudio.summary.peak"):
        page.wait_for_timeout(50)
    page.wait_for_timeout(2000)  # code is compiled, the pace is found
    page.evaluate("Object.assign(window.eagorStudio.store.stats, {received: 0, evaluated: 0, drawn: 0, ages: []})")
    begun, used = time.monotonic(), cpu(browser)
    page.wait_for_timeout(1000 * seconds)
    took, used, found = time.monotonic() - begun, since(used, cpu(browser)), page.evaluate(STATS)
    ages = 1000 * np.array(found["ages"])
    return {
        "first_picture_ms": round(first),
        "cpu_ms_until_first_picture": {kind: round(1000 * time) for kind, time in spent.items()},
        "steps_per_second": round(found["received"] / took, 1),
        "beliefs_evaluated_per_second": round(found["evaluated"] / took, 1),
        "evaluation_ms": round(found["evaluation"], 1),
        "drawings_per_second": round(found["drawn"] / took, 1),
        "cpu_ms_per_drawing": {kind: round(1000 * time / max(1, found["drawn"]), 1) for kind, time in used.items()},
        "age_ms": {name: round(float(np.percentile(ages, q))) for name, q in QUANTILES} if len(ages) else None,
        "scale": page.evaluate("window.eagorStudio.summary.scale"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--size", default="1280x800", help="of the window, pixels")
    parser.add_argument("--browser", default=shutil.which("chromium"))
    options = parser.parse_args()
    if not options.browser:
        sys.exit("error: no Chromium here; name a browser: --browser PATH")
    width, height = (int(size) for size in str(options.size).split("x"))
    command = [sys.executable, "-m", "eagor", "studio", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            found = re.search(r"http://\S+", server.stdout.readline())
            assert found, "the studio does not start"
            warm(found[0])
            before = os.getloadavg()[0]
            with sync_playwright() as playwright:
                sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
                browser = playwright.chromium.launch(executable_path=options.browser, args=sandbox, timeout=120_000)
                page = browser.new_page(viewport={"width": width, "height": height})
                page.set_default_timeout(120_000)
                told = measured(browser, page, found[0], options.seconds)
                browser.close()
        finally:
            server.terminate()
    load = {"before": round(before, 1), "after": round(os.getloadavg()[0], 1), "cores": os.cpu_count()}
    print(json.dumps({"window": options.size, "seconds": options.seconds, **told, "load": load}, indent=2))


if __name__ == "__main__":
    main()
