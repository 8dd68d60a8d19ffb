"""Talking models (any `Chat`) for the ``vlm`` agents of the benchmarks: named by text, made once per process."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.perception import local_model, parse_options
from eagor.perception.vlm.prompts import IMAGE, Chat, ChatReply, Message

__all__ = ["IMAGE", "Chat", "ChatReply", "Message", "digest", "load_chat", "shared_chat"]


def load_chat(spec: str) -> Chat:
    """The model that `spec` names. Raises `EagorError` if it cannot be made.

    - ``MODEL@ADDRESS[?option=value&...]``: on an OpenAI-compatible server (`ServedChat`). The model defaults to the
      server's only one, the address to ``http://localhost:8000/v1``.
    - ``FOLDER[?option=value&...]`` with ``config.json``, or a hub name: on this machine (`LocalChat`).
    - ``package.module:function``: the `Chat` that ``function()`` returns.
    """
    module, colon, name = spec.partition(":")
    named = module.replace(".", "").isidentifier() and name.isidentifier()
    if colon and named and not {"@", "/"} & set(spec):
        try:
            make = getattr(importlib.import_module(module), name)
        except Exception as error:  # a broken module may raise anything
            raise EagorError(
                f"the model {spec!r} cannot be imported ({type(error).__name__}: {error}); wanted "
                f"package.module:function, or {spec}@http://localhost:11434 for a model on a server"
            ) from error
        return _made(spec, make)
    place, _, written = spec.partition("?")
    here = os.path.isfile(os.path.join(os.path.expanduser(place), "config.json"))
    if here or ("/" in place and "@" not in place and "://" not in place):
        from eagor.perception.transformers.chat import LocalChat

        return local_model(LocalChat, place, parse_options(written))
    from eagor.perception.endpoint.server import chat_from_text

    return chat_from_text(spec)


def _made(spec: str, make: Any) -> Chat:
    """The result of `make`. Raises `EagorError` if it takes arguments, as a model itself does."""
    try:
        inspect.signature(make).bind()
    except (TypeError, ValueError) as error:  # ValueError: it has no signature
        raise EagorError(
            f"the model {spec!r} cannot be made ({error}); wanted a function without arguments that returns the model"
        ) from error
    return make()


@lru_cache(maxsize=1)
def shared_chat(spec: str) -> Chat:
    """The model that `spec` names, made once per process for all callers; `eagor.tasks.eyes.release` frees it.

    Raises as `load_chat`, errors of its server, and `EagorError` for anything that is not a `Chat`.
    """
    made = load_chat(spec)
    if not callable(made):
        raise EagorError(f"the model {spec!r} is a {type(made).__name__}; wanted a callable that takes messages")
    if not inspect.signature(made).parameters:
        raise EagorError(f"the model {spec!r} takes no argument; wanted the messages of a conversation")
    check = getattr(made, "check", None)
    if check is not None:
        check()
    return made


def digest(messages: Sequence[Message]) -> str:
    """A short hash of a conversation, text and pictures."""
    found = hashlib.sha256()
    for message in messages:
        found.update(f"{message.role}\0{message.text}\0".encode())
        for image in message.images:
            found.update(np.ascontiguousarray(image).tobytes())
    return found.hexdigest()[:16]
