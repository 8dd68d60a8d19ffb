"""``eagor robot``: to the module of its command."""

from __future__ import annotations

from importlib import import_module

from eagor.cli.robot_options import Robot, RobotCheck, RobotSim
from eagor.cli.robot_run_options import RobotRun

RUNS = {
    RobotRun: "eagor.cli.robot_run:robot_run",
    RobotSim: "eagor.cli.robot_sim:sim",
    RobotCheck: "eagor.cli.robot_check:check",
}


def robot(options: Robot) -> int:
    """Run the command; returns its exit code."""
    module, _, function = RUNS[type(options.action)].partition(":")
    return getattr(import_module(module), function)(options.action)
