"""The memory that reading an 8K video takes: 7680 x 3840, H.264 with 8 bits and H.265 with 10 bits.

    python benchmarks/video_memory.py [--pictures 24]

Writes a clip of each kind, reads it in a process of its own, and prints the peak of that process (resident set), for
1024 rows and for all. The limit is 1.5 GB. Linux; the files and the encoders need about 3 GB of memory and a minute.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

WRITE = """
import sys
import av
import numpy as np
path, codec, format, pictures = *sys.argv[1:4], int(sys.argv[4])
base = np.random.default_rng(0).integers(0, 255, (60, 120, 3), dtype=np.uint8).repeat(64, 0).repeat(64, 1)
with av.open(path, "w") as container:
    stream = container.add_stream(codec, rate=30)
    stream.height, stream.width, stream.pix_fmt = *base.shape[:2], format
    plain = {"libx264": "rc-lookahead=0:sync-lookahead=0:bframes=3:ref=5:threads=2",
             "libx265": "rc-lookahead=4:bframes=3:ref=4:pools=2:frame-threads=1:log-level=none"}[codec]
    stream.options = {"preset": "ultrafast", codec[3:] + "-params": plain}
    for k in range(pictures):
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.roll(base, 8 * k, axis=1), format="rgb24")))
    container.mux(stream.encode())
"""
READ = """
import re, sys
from eagor.media.video import Video
video = Video(sys.argv[1], rows=int(sys.argv[2]) or None)
seen = sum(1 for _ in video)
peak = int(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1]) / 1024
print(f"{video.facts[0]}: {seen} pictures of {video.shape[1]} x {video.shape[0]}: {peak:.0f} MiB")
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=24)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for codec, kind in (("libx264", "yuv420p"), ("libx265", "yuv420p10le")):
            path = Path(folder) / f"{codec}.mp4"
            subprocess.run([sys.executable, "-c", WRITE, path, codec, kind, str(options.pictures)], check=True)
            for rows in ("1024", "0"):
                subprocess.run([sys.executable, "-c", READ, path, rows], check=True)


if __name__ == "__main__":
    main()
