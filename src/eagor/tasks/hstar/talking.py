"""The model alone: shown view after view, it answers with actions, as the benchmark means it."""

from __future__ import annotations

from typing import Any

import numpy as np

from eagor.tasks.chat import Chat, Message, digest
from eagor.tasks.hstar.agents import Turn
from eagor.tasks.hstar.camera import View, render_view
from eagor.tasks.hstar.data import Episode
from eagor.tasks.hstar.files import open_panorama
from eagor.tasks.hstar.prompts import Exchange, conversation, first_text, next_text, system_text
from eagor.tasks.hstar.rules import Action, parse_action
from eagor.tasks.hstar.search import Answer


class VlmAgent:
    """Asks a `Chat`. What it would submit before it does is where the camera looks: that is what it turned it to."""

    def __init__(self, episode: Episode, chat: Chat, form: str, window: int, resolution: int) -> None:
        self._episode, self._chat, self._form, self._window = episode, chat, form, window
        self._resolution = resolution
        self._past: list[Exchange] = []
        self._last: tuple[Action | None, str] = (None, "")

    def step(self, view: View, last: bool) -> Turn:
        image = render_view(open_panorama(self._episode.panorama), view.yaw, view.pitch, self._resolution)
        text = self._text(view)
        messages = conversation(system_text(self._episode.kind, self._form), self._past, text, image, self._window)
        said = self._chat(messages)
        reply = parse_action(said.text, self._form)
        action = reply.action
        self._past.append(Exchange(Message("user", text, (image,)), said.text))
        self._last = (action, reply.actions[0] if reply.actions else "")
        notes: dict[str, Any] = {
            "raw": said.text,
            "prompt": digest(messages),
            "format": reply.format_correct,
            "valid": action is not None,
            "pixels": [int(side) for side in np.shape(image)[:2]],
        }
        if said.prompt_tokens is not None:
            notes["tokens"] = [said.prompt_tokens, said.completion_tokens]
        if action is not None and action.kind == "submit":
            return Turn(action, Answer(action.yaw, action.pitch, float("nan")), notes)
        return Turn(action, Answer(round(view.yaw) % 360, round(view.pitch), float("nan")), notes)

    def _text(self, view: View) -> str:
        if not self._past:
            return first_text(self._episode.task, self._form)
        action, text = self._last
        return next_text(self._episode.task, self._form, action, text, view.yaw, view.pitch)
