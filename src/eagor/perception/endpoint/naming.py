"""How an endpoint is named in one line of text."""

from __future__ import annotations

from dataclasses import fields
from typing import Any
from urllib.parse import parse_qsl

from eagor.errors import EagorError
from eagor.perception.endpoint.addresses import place_of
from eagor.perception.endpoint.perception import EndpointPerception
from eagor.perception.endpoint.servers import need_client


def from_text(text: str = "", /, **options: Any) -> EndpointPerception:
    """The perception that ``MODEL@ADDRESS[,ADDRESS...][?option=value&...]`` names.

    Model and address may be missing: the only model of the server, and ``http://localhost:8000/v1``. An address without
    a path gets ``/v1``. Options are the attributes of `EndpointPerception`; those passed by name win.

    Raises `EagorError` for options that do not exist or cannot be read, and without the openai package.
    """
    need_client()
    place, _, written = text.partition("?")
    model, addresses = place_of(place)
    known = {field.name: field.default for field in fields(EndpointPerception)}
    given: dict[str, Any] = {"model": model}
    if addresses:
        given["servers"] = addresses
    for name, value in parse_qsl(written, keep_blank_values=True):
        found = _read_option(name, value, known)
        if name in given:
            raise EagorError(f"{name} comes twice in the name of an endpoint; wanted each option once")
        given[name] = found
    given |= options
    unknown = sorted(given.keys() - known.keys())
    if unknown:
        raise EagorError(f"an endpoint has no option {', '.join(unknown)}; it has {', '.join(known)}")
    return EndpointPerception(**given)


def _read_option(name: str, value: str, known: dict[str, Any]) -> Any:
    """An option as written in the text, in the type of its default."""
    default = known.get(name)
    if name in ("servers", "calibration", "detector", "model"):
        raise EagorError(f"{name} cannot be set after the ?; the model and the addresses stand before it")
    try:
        if isinstance(default, bool):
            return {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}[value.lower()]
        return type(default)(value) if isinstance(default, int | float) else value
    except (ValueError, KeyError) as error:
        raise EagorError(f"{name}={value} in the name of an endpoint; wanted a {type(default).__name__}") from error
