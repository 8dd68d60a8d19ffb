"""All commands, by name.

What is heavy is imported by the function of a command: help and usage errors come at once.
"""

from __future__ import annotations

from typing import Annotated

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

Command = (
    Annotated[Locate, subcommand("locate")]
    | Annotated[Look, subcommand("look")]
    | Annotated[Track, subcommand("track")]
    | Annotated[Live, subcommand("live")]
    | Annotated[Ros, subcommand("ros")]
    | Annotated[Robot, subcommand("robot")]
    | Annotated[Demo, subcommand("demo")]
    | Annotated[Studio, subcommand("studio")]
    | Annotated[Bench, subcommand("bench")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Calibrate, subcommand("calibrate")]
    | Annotated[Camera, subcommand("camera")]
    | Annotated[Models, subcommand("models")]
    | Annotated[Doctor, subcommand("doctor")]
)
