"""All commands, by name.

What is heavy is imported by the function of a command: help and usage errors come at once.
"""

from __future__ import annotations

from typing import Annotated, Union

from tyro.conf import subcommand

from eagor.cli.bench import Bench
from eagor.cli.calibrate import Calibrate
from eagor.cli.camera import Camera
from eagor.cli.demo import Demo
from eagor.cli.export import Export
from eagor.cli.live import Live
from eagor.cli.locate import Locate
from eagor.cli.look import Look
from eagor.cli.models import Doctor, Models
from eagor.cli.robot import Robot
from eagor.cli.ros import Ros
from eagor.cli.studio import Studio
from eagor.cli.track import Track

_ALL = (
    Locate, Look, Track, Live, Ros, Robot, Demo, Studio, Bench, Export, Calibrate, Camera, Models, Doctor
)  # fmt: skip
Command = Union[tuple(Annotated[each, subcommand(each.__name__.lower())] for each in _ALL)]  # noqa: UP007
