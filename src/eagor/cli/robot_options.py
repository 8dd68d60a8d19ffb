"""The options of ``eagor robot``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import arg, subcommand

from eagor.cli.robot_run_options import RobotRun


@dataclass(frozen=True, kw_only=True)
class Robot:
    """Walk a Unitree Go2 to an object, in simulation or in earnest."""

    runs: ClassVar[str] = "eagor.cli.robot:robot"

    action: Annotated[
        Annotated[RobotRun, subcommand("run")],
        arg(name=""),  # as in `Bench`
    ]
