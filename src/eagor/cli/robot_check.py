"""``eagor robot check``: whether a Go2 can be heard and spoken to."""

from __future__ import annotations

from dataclasses import asdict

from eagor._checks import within
from eagor.cli import terminal
from eagor.cli.robot_options import RobotCheck
from eagor.robots.dds import Link
from eagor.robots.go2.check import Report, examine
from eagor.robots.ros.graph import default_domain


def check(options: RobotCheck) -> int:
    """Run the command; exit code 1 if something is wrong."""
    if not within(options.seconds, 0.5, 600):
        raise terminal.UsageError(f"--seconds {options.seconds:g}: wanted 0.5 to 600")
    domain = default_domain() if options.domain is None else options.domain
    with Link(domain, options.interface) as link:
        report = examine(link, options.seconds)
    if options.json:
        terminal.emit(asdict(report) | {"usable": not report.problems})
    else:
        terminal.facts(_words(report))
        for problem in report.problems:
            terminal.say(f"problem: {problem}")
        print("it cannot be used like this" if report.problems else "a Go2 that can be used")
    return terminal.FAILED if report.problems else terminal.OK


def _words(report: Report) -> dict[str, str]:
    """The report in words; only what was heard."""
    found = {"topics": ", ".join(report.topics)}
    if report.rates:
        found["messages per second"] = ", ".join(f"{topic} {rate:g}" for topic, rate in report.rates.items())
    if report.firmware is not None:
        found["firmware"] = report.firmware
    if report.mode is not None:
        found["robot"] = report.mode + (f", error {report.error_code}" if report.error_code else "")
    if report.clock is not None:
        way = "ahead of" if report.clock > 0 else "behind"
        found["its clock"] = f"{abs(report.clock):.3f} s {way} this machine's, or less by the time that messages take"
    if report.lateness is not None:
        found["lateness of states"] = "median {:.1f} ms, one in a hundred {:.1f} ms".format(
            *(1000 * part for part in report.lateness)
        )
    if report.battery is not None:
        found["battery"] = f"{report.battery} %, {report.volts:.1f} V"
    if report.sport_version is not None and report.answer is not None:
        found["walking service"] = f"version {report.sport_version}, answers in {1000 * report.answer:.1f} ms"
    if report.commands:
        found["commands of others"] = str(report.commands)
    found["cameras"] = ", ".join(report.cameras) or "none on DDS"
    return found
