"""Sources of pictures: folders, videos, devices, streams, pipes; lenses, and panoramas made of their pictures.

`open_camera` reads what SOURCE on the command line names. `Newest` gives the newest frame to a slow reader. `Rig` and
`read_rig` describe lenses, `Stitcher` makes panoramas of their pictures. Packages add cameras of their own under the
entry points ``eagor.cameras``; `check_camera` tests one.
"""

from __future__ import annotations

from eagor.lenses import FisheyeLens, PinholeLens
from eagor.media.cameras.checking import check_camera
from eagor.media.cameras.newest import Newest
from eagor.media.cameras.opening import open_camera
from eagor.media.cameras.rig import Rig, dual_fisheye
from eagor.media.cameras.rig_files import read_rig, write_rig
from eagor.media.cameras.stitching import Stitcher, seen_by

__all__ = [
    "FisheyeLens", "Newest", "PinholeLens", "Rig", "Stitcher", "check_camera", "dual_fisheye", "open_camera",
    "read_rig", "seen_by", "write_rig",
]  # fmt: skip
