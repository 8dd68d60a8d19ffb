"""Logs for the Rerun viewer: they hold what was answered, and the viewer opens them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerunreading import read

from eagor.cli import main
from eagor.lab.worlds.painted import painted_room
from eagor.sphere import azimuth_elevation

VIEWER = Path(sys.executable).with_name("rerun")


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """A red ball followed through six turned pictures, with a log and the answers."""
    folder = tmp_path_factory.mktemp("rerun")
    room = painted_room(128, 256)
    lines = ["stamp,yaw_deg,pitch_deg,roll_deg,x,y,z,frame"]
    (folder / "frames").mkdir()
    for k in range(6):
        Image.fromarray(np.roll(room, 16 * k, axis=1)).save(folder / "frames" / f"{k}.png")
        lines.append(f"{k / 2},{22.5 * k},0,0,{0.1 * k},0,1,{k}.png")
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    words = ["track", folder / "frames", "red", "--poses", folder / "poses.csv"]
    words += ["--out", folder / "found.jsonl", "--rerun", folder / "run.rrd"]
    assert main([str(word) for word in words]) == 0
    return folder


def test_the_viewers_own_check_finds_no_fault(followed):
    run = subprocess.run([VIEWER, "rrd", "verify", followed / "run.rrd"], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert "verified without error" in run.stdout + run.stderr


def test_a_log_holds_the_answers_of_the_table(followed):
    rows = [json.loads(line) for line in (followed / "found.jsonl").read_text().splitlines()]
    log = read(followed / "run.rrd")

    def plotted(what: str) -> list[float]:
        (name,) = (key for key in log if key.startswith(f"/plots/{what} ") and "scalars" in key)
        assert [at for at, _ in log[name]] == [row["stamp"] for row in rows]
        return [float(value[0]) for _, value in log[name]]

    np.testing.assert_allclose(plotted("angles/red/azimuth"), [row["azimuth_deg"] for row in rows], atol=0.01)
    np.testing.assert_allclose(plotted("presence/red"), [row["presence"] for row in rows], atol=1e-6)
    (vectors,) = (value for key, value in log.items() if key.startswith("/world/body/red") and "vectors" in key)
    last = np.array(vectors[-1][1].tolist(), dtype=float)[-1]
    azimuth, elevation = azimuth_elevation(last / np.linalg.norm(last))
    assert abs(np.degrees(float(azimuth)) - rows[-1]["azimuth_deg"]) < 0.1
    assert abs(np.degrees(float(elevation)) - rows[-1]["elevation_deg"]) < 0.1
    (places,) = (value for key, value in log.items() if key.startswith("/world/body Transform3D:translation"))
    np.testing.assert_allclose(
        [np.array(v.tolist(), float).ravel()[0] for _, v in places], 0.1 * np.arange(6), atol=1e-6
    )
    assert any("TextLog:text" in key for key in log)


@pytest.mark.slow
def test_the_viewer_shows_it(followed):
    """A picture of the viewer without a screen; it is not blank, and the belief glows on the panorama."""
    if shutil.which("xvfb-run") is None:
        pytest.skip("needs xvfb and mesa-vulkan-drivers (apt-get install): a screen and a GPU in software")
    picture = followed / "shown.png"
    command = ["xvfb-run", "-a", VIEWER, followed / "run.rrd", "--screenshot-to", picture, "--window-size", "1000x700"]
    env = {**os.environ, "XDG_RUNTIME_DIR": str(followed), "HOME": str(followed), "RERUN_ANALYTICS_ENABLED": "false"}
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=env)
    if not picture.exists() and "Vulkan" in run.stderr and "llvmpipe" not in run.stderr:
        pytest.skip("no Vulkan driver (apt-get install mesa-vulkan-drivers)")
    assert picture.exists(), run.stderr[-2000:]
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    height, width = pixels.shape[:2]
    left = pixels[: height // 2, : width // 2]
    cyan = (left[..., 0] < 60) & (left[..., 1] > 190) & (left[..., 2] > 210)
    assert cyan.sum() > 30  # the arrow and the answer
    assert len(np.unique(left.reshape(-1, 3), axis=0)) > 1000  # a panorama, not a plain ground
