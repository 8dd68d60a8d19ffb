"""Perceptions and talking models of a run: made once per process, and adapted to one episode.

Most perceptions see the panorama. `truth` gets the instance ids instead, which only a simulator knows; no picture is
rendered for it. The ``vlm`` agents of the benchmarks talk to any `Chat`, which is named by text.
"""

from __future__ import annotations

import gc
import inspect
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np

from eagor.errors import AnswerError, EagorError
from eagor.evidence import Evidence
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.perception import Perception, infer, load
from eagor.perception.vlm import Chat
from eagor.plugins import bring
from eagor.queries import Named


class EpisodePerception:
    """A perception in the episode of a spec: it looks once per step.

    One that reads instance ids begins an episode among `things` (indexed by instance id). Its mistakes are the same
    each time, and others for another `purpose`.
    """

    def __init__(
        self, perception: Any, spec: EpisodeSpec, things: Sequence[Named], purpose: str = "perception"
    ) -> None:
        self._privileged = is_privileged(perception)
        self._sees: Callable[..., Evidence] = partial(infer, perception)
        if self._privileged:
            self._sees = perception.episode(things, int(spec.rng(purpose).integers(1 << 31)))
        self.source: dict[str, Any] = {}
        self.milliseconds, self.unread, self.looks = list[float](), list[AnswerError](), 0

    def infer(
        self, observation: Mapping[str, Any], info: Mapping[str, Any], stamp: float, query: str = ""
    ) -> Evidence | None:
        """The evidence in what an environment returned (`eagor.lab.envs.place_env`); `query`: another than its own.

        None if a model's answer could not be read: one among hundreds costs its step, not the episode.
        """
        self.looks += 1
        image = info["instances"]["ids"] if self._privileged else observation["panorama"]
        pose = info["truth"]["world_R_body"]
        try:
            evidence = self._sees(image, query or info["query"], stamp=stamp, world_R_body=pose)
        except AnswerError as error:
            self.unread.append(error)
            return None
        if evidence.source is not None:
            self.source = dict(evidence.source)
            self.milliseconds.append(float(self.source.pop("milliseconds", 0.0)))
        return evidence

    def account(self) -> dict[str, Any]:
        """Number of looks and of unreadable answers, the mean time of a look, and the source of the last one.

        Empty if the perception tells no source, or reads instance ids. Raises `AnswerError` if more than half of the
        answers could not be read: that is no result.
        """
        unread = len(self.unread)
        if 2 * unread > self.looks:
            raise AnswerError(f"{unread} of {self.looks} answers could not be read; the last: {self.unread[-1]}")
        if self._privileged or not (self.source or self.unread):
            return {}
        mean = round(float(np.mean(self.milliseconds)), 1) if self.milliseconds else None
        return {"looks": self.looks, "unread": unread, "milliseconds": mean, "source": self.source}


def is_privileged(perception: Any) -> bool:
    """Whether the perception reads instance ids."""
    return hasattr(perception, "episode")


@lru_cache(maxsize=1)
def shared(perception: str) -> Perception:
    """The perception of this name, made once per process for all callers: a model may take minutes and gigabytes.

    `release` frees it. Raises as `eagor.perception.load`, and errors of its server.
    """
    made = load(perception)
    getattr(made, "check", bool)()  # that it works, where it can tell
    return made


@lru_cache(maxsize=1)
def shared_chat(spec: str) -> Chat:
    """The model that `spec` names, made once per process for all callers; `release` frees it.

    Raises as `load_chat`, errors of its server, and `EagorError` for anything that is not a `Chat`.
    """
    made = load_chat(spec)
    if not (callable(made) and inspect.signature(made).parameters):
        raise EagorError(f"the model {spec!r} is a {type(made).__name__}; wanted a callable that takes messages")
    getattr(made, "check", bool)()
    return made


def release() -> None:
    """Free the perception of `shared`, the model of `shared_chat`, and their GPU memory."""
    shared.cache_clear()
    shared_chat.cache_clear()
    gc.collect()
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        torch.cuda.empty_cache()


def load_chat(spec: str) -> Chat:
    """The model that `spec` names. Raises `EagorError` if it cannot be made.

    - ``MODEL@ADDRESS[?option=value&...]``: on an OpenAI-compatible server (`ServedChat`). The model defaults to the
      server's only one, the address to ``http://localhost:8000/v1``.
    - ``package.module:function``: the `Chat` that ``function()`` returns.
    """
    module, colon, name = spec.partition(":")
    if colon and module.replace(".", "").isidentifier() and name.isidentifier():
        try:
            make = bring(EntryPoint(spec, spec, ""), "model")
            inspect.signature(make).bind()
        except EagorError as error:
            raise EagorError(f"{error}, or {spec}@http://localhost:11434 for a model on a server") from None
        except (TypeError, ValueError) as error:  # ValueError: it has no signature
            wanted = "a function without arguments that returns the model"
            raise EagorError(f"the model {spec!r} cannot be made ({error}); wanted {wanted}") from error
        return make()
    place = spec.partition("?")[0]
    if "@" not in place and "://" not in place and ("/" in place or os.path.isdir(os.path.expanduser(place))):
        raise EagorError(
            f"{place} is a model for this machine, which talks where it is served: `vllm serve {place}` (or "
            "transformers serve, llama.cpp, Ollama), then name it as MODEL@http://localhost:8000/v1"
        )
    from eagor.perception.endpoint import chat_from_text

    return chat_from_text(spec)
