"""All commands, by name; and a usage error in one line, with the nearest command or option.

What is heavy is imported by the function of a command: help and usage errors come at once. The text that tyro prints
for a mistake shows the help of every option that it might have been. `mistake` reads commands and options from their
dataclasses instead, and explains the first mistake that it finds.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from tyro.conf import Positional, subcommand

from eagor.cli.bench import Bench
from eagor.cli.calibrate import Calibrate
from eagor.cli.camera import Camera
from eagor.cli.checks import in_quotes
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


# --- a usage error in one line, with the nearest command or option ---------------------------------------------------

_NUMBER = re.compile(r"-(?:[0-9.]|inf|nan)", re.IGNORECASE)  # a value, although it begins with a dash
_FOR_TRACK = (".mp4", ".mkv", ".webm", ".mov", ".insv", ".jsonl")
_NUMBERS = {int: "a whole number", float: "a number"}


def mistake(arguments: Sequence[str]) -> str | None:
    """What is wrong with `arguments`, which tyro has refused, and what to change; None if that is not found."""
    rest, path, table = list(arguments), "eagor", _commands(Command)
    while True:
        if not rest:
            return f"{path} needs a command: {_either(table)}; {path} --help describes them"
        if rest[0] not in table:
            return _wrong_command(path, rest, table)
        path = f"{path} {rest[0]}"
        found = table[rest.pop(0)]
        if not isinstance(found, dict):
            return _wrong_option(path, found, rest)
        table = found


@dataclass(frozen=True)
class _Option:
    """An option or a positional argument, as its dataclass declares it."""

    name: str  # "--out", or the metavar of a positional argument
    metavar: str
    kind: Any  # bool, int, a Literal, ...
    positional: bool
    required: bool
    many: bool


@cache
def _commands(union: Any) -> dict[str, Any]:
    """The commands of a union of dataclasses by name: the options of each, or a dictionary of commands below it."""
    found = {}
    for member in get_args(union):
        kind, *about = get_args(member)
        name = next(each.name for each in about if hasattr(each, "name"))
        hints = get_type_hints(kind, include_extras=True)
        inside = get_args(hints["action"])[0] if "action" in hints else None
        found[name] = tuple(_options(kind, hints)) if inside is None else _commands(inside)
    return found


def _options(command: Any, hints: Mapping[str, Any]) -> Iterator[_Option]:
    for field in fields(command):
        kind, about = hints[field.name], ()
        if get_origin(kind) is Annotated:
            kind, *about = get_args(kind)
        if get_origin(kind) in (Union, UnionType):
            (kind,) = (each for each in get_args(kind) if each is not NoneType)
        many = get_origin(kind) is tuple
        wanted = next((each for each in about if getattr(each, "metavar", None)), None)
        metavar = wanted.metavar if wanted else field.name.upper()
        name = next((each.name for each in about if getattr(each, "name", None)), field.name)
        names = [f"--{name.replace('_', '-')}", *(getattr(wanted, "aliases", None) or ())]
        positional = Positional in about
        required = field.default is MISSING and field.default_factory is MISSING
        for name in [metavar] if positional else names:
            yield _Option(name, metavar, kind, positional, required and name in (metavar, names[0]), many)


def _wrong_command(path: str, rest: list[str], table: Mapping[str, Any]) -> str:
    word = rest[0]
    if word.startswith("-"):
        command = next((each for each in rest if each in table), None)
        if command is None:
            return f"{word} is no command; wanted {_either(table)}, then its options: {path} --help"
        return f"{word} stands before the command; options follow it: {path} {command} ... {word}"
    if near := get_close_matches(word.lower(), table, 1):
        return f"unknown command {word!r}; did you mean {near[0]}? {path} --help describes all"
    if path == "eagor" and os.path.exists(word):
        what = "track" if os.path.isdir(word) or word.lower().endswith(_FOR_TRACK) else "locate"
        return f"unknown command {word!r}, which is a file or folder; did you mean {path} {what} {word} ...?"
    return f"unknown command {word!r}; wanted {_either(table)}; {path} --help describes them"


def _wrong_option(path: str, options: Sequence[_Option], rest: list[str]) -> str | None:
    named = {option.name: option for option in options if not option.positional}
    places = [option for option in options if option.positional]
    see = f"{path} --help"
    words: list[str] = []
    given: set[str] = set()
    values: list[tuple[_Option, str]] = []
    literal = False
    while rest:
        token = rest.pop(0)
        if token == "--" and not literal:
            literal = True
            continue
        if literal or not token.startswith("-") or token == "-" or _NUMBER.match(token):
            words.append(token)
            continue
        name, equals, value = token.partition("=")
        name = name.replace("_", "-")
        if name in ("-h", "--help"):  # tyro refuses this only for a reason of its own
            return None
        if (option := named.get(name)) is None:
            return _unknown_option(path, name, named, see)
        given.add(name)
        if option.kind is bool:
            continue
        taken = [value] if equals else []
        while not equals and rest and (option.many or not taken) and (_NUMBER.match(rest[0]) or rest[0][:1] != "-"):
            taken.append(rest.pop(0))
        if not taken:
            return f"{name} needs a value: {name} {option.metavar}; {see}"
        values += [(option, each) for each in taken]
    for option, value in values:
        if wanted := _wanted(option, value):
            return f"{option.name} {value}: wanted {wanted}; {see}"
    if wrong := _wrong_places(path, places, words):
        return wrong
    lacking = [f"{o.name} {o.metavar}" for o in named.values() if o.required and o.name not in given]
    return f"{path} needs {' and '.join(lacking)}; {see}" if lacking else None


def _unknown_option(path: str, name: str, named: Mapping[str, _Option], see: str) -> str:
    if near := get_close_matches(name, named, 1, 0.75):
        return f"{path} has no option {name}; did you mean {near[0]}? {see} describes all"
    everywhere = _leaves("eagor", _commands(Command))
    if others := [other for other, options in everywhere if name in options and other != path]:
        return f"{path} has no option {name}: it belongs to {', '.join(others)}; {see} lists its own"
    near = get_close_matches(name, named, 1, 0.55)
    return f"{path} has no option {name}{f'; did you mean {near[0]}?' if near else ';'} {see} describes all"


def _leaves(path: str, table: Mapping[str, Any]) -> Iterator[tuple[str, set[str]]]:
    """Each command with the names of its options."""
    for name, found in table.items():
        if isinstance(found, dict):
            yield from _leaves(f"{path} {name}", found)
        else:
            yield f"{path} {name}", {option.name for option in found}


def _wanted(option: _Option, value: str) -> str | None:
    """What `option` takes instead of `value`; None if the value fits."""
    if get_origin(option.kind) is Literal:
        choices = get_args(option.kind)
        return None if value in choices else _either(choices)
    if option.kind in _NUMBERS:
        try:
            option.kind(value)
        except ValueError:
            return _NUMBERS[option.kind]
    return None


def _wrong_places(path: str, places: Sequence[_Option], words: Sequence[str]) -> str | None:
    """What is wrong with the positional arguments."""
    wanted = " ".join(option.metavar for option in places)
    if len(words) > len(places) and not any(option.many for option in places):
        surplus = words[len(places)]
        if not places:
            return f"{path} takes no {surplus!r}, only options; {path} --help"
        quotes = ""
        if places[-1].metavar == "QUERY":
            quotes = f". {in_quotes(' '.join(words[len(places) - 1 :]))}"
        return f"{path} takes {wanted}, and got {surplus!r} too{quotes}; {path} --help"
    for option, word in zip(places, words, strict=False):
        if says := _wanted(option, word):
            return f"{option.metavar} {word!r}: wanted {says}; {path} --help"
    if lacking := [option.metavar for option in places[len(words) :] if option.required]:
        lacks = "" if len(lacking) == len(places) else f", and lacks {' and '.join(lacking)}"
        return f"{path} needs {wanted}{lacks}; {path} --help"
    return None


def _either(names: Sequence[str] | Mapping[str, Any]) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last
