"""Plays a recording of the live loop again: the same events, the same answers, bit for bit."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import FormatError
from eagor.live.answers import Answer
from eagor.live.core import LiveCore, Settings
from eagor.live.events import Event, EvidenceCame, FrameCame, Trouble
from eagor.live.keeper import PATIENCE, Failed, Keeper, Looked
from eagor.live.packing import event_from, settings_from
from eagor.live.recorder import ANSWERS, EVENTS, IMAGES
from eagor.media.bags.messages import panorama_of
from eagor.media.bags.reader import bag_topics, read_bag
from eagor.perception import Perception

__all__ = ["Compared", "Replay"]


@dataclass
class Compared:
    """Answers played again: how many, how many of them equal the recorded ones, and the first that does not.

    A recording that was cut off may end between an event and the answers to it: these are not `recorded`.
    """

    answers: int = 0
    equal: int = 0
    recorded: int = 0
    first: tuple[dict[str, Any], dict[str, Any]] | None = field(default=None, repr=False)

    def as_text(self) -> str:
        """How many are the same, and how many cannot be compared."""
        found = f"{self.answers} answers, {self.equal} of them equal to the recorded ones bit for bit"
        lost = self.answers - self.recorded
        return found + (f"; {lost} cannot be compared, because the recording ends before them" if lost else "")

    def add(self, played: dict[str, Any], recorded: dict[str, Any] | None) -> None:
        """One answer, and the recorded one in its place, if there is one."""
        self.answers += 1
        self.recorded += recorded is not None
        if played == recorded:
            self.equal += 1
        elif recorded is not None and self.first is None:
            self.first = played, recorded


class Replay:
    """A recording in the folder `path`: iterate for the answers that it gives again; `compared` tells how they differ.

    `perception`: look at the recorded pictures anew with this one instead of taking the recorded evidence; each look
    comes when the recorded one came, and takes `patience` seconds at most. A recording that was cut off is played as
    far as it goes, with a `UserWarning`. Raises `FormatError` for a folder that is no recording of the live loop.
    """

    def __init__(
        self, path: str | Path, perception: str | Perception | None = None, *, patience: float = PATIENCE
    ) -> None:
        self.path, self.perception, self.patience = Path(path), perception, patience
        topics = bag_topics(self.path)
        if EVENTS not in topics:
            raise FormatError(
                f"{path} has no topic {EVENTS}: it is no recording of eagor live --record; it has {', '.join(topics)}"
            )
        if perception is not None and IMAGES not in topics:
            raise FormatError(f"{path} was recorded without pictures: play it with its own evidence")
        self.compared = Compared()
        self.settings = self._settings()

    def __iter__(self) -> Iterator[Answer]:
        core, self.compared = LiveCore(self.settings), Compared()
        anew = None if self.perception is None else _Anew(self.perception, self.patience, core, self._looked_at())
        written = self._answers() if anew is None else iter(())
        try:
            for event in self.events(pictures=anew is not None):
                for each in (event,) if anew is None else anew.instead(event):
                    for answer in core.take(each):
                        self.compared.add(answer.as_json(exact=True), next(written, None))
                        yield answer
        finally:
            if anew is not None:
                anew.close()

    def _settings(self) -> Settings:
        for _, _, _, found in read_bag(self.path, [EVENTS]):
            return settings_from(found.data.tobytes())
        raise FormatError(f"{self.path} holds no event: the run was ended before its first")

    def events(self, pictures: bool) -> Iterator[Event]:
        """The recorded events in order, with their pictures if wanted (where they were recorded)."""
        held: FrameCame | None = None
        for _, topic, _, found in read_bag(self.path, [EVENTS, IMAGES] if pictures else [EVENTS]):
            if topic == IMAGES:
                if held is not None:
                    yield replace(held, panorama=panorama_of(found))
                    held = None
                continue
            if held is not None:
                yield held
                held = None
            content = found.data.tobytes()
            if content[:1] == b"S":
                continue
            event = event_from(content)
            if pictures and isinstance(event, FrameCame):
                held = event
            else:
                yield event
        if held is not None:
            yield held

    def _looked_at(self) -> list[float]:
        """The stamps of the pictures that were looked at, each once per look."""
        events = (found.data.tobytes() for _, _, _, found in read_bag(self.path, [EVENTS]))
        return [event_from(content).stamp for content in events if content[:1] == b"E"]  # type: ignore[union-attr]

    def _answers(self) -> Iterator[dict[str, Any]]:
        if ANSWERS not in bag_topics(self.path):
            return
        for _, _, _, found in read_bag(self.path, [ANSWERS]):
            yield json.loads(found.data)


class _Anew:
    """In place of recorded evidence: looks of another perception at the same pictures."""

    def __init__(self, perception: str | Perception, patience: float, core: LiveCore, wanted: list[float]) -> None:
        self._keeper, self._core = Keeper(perception, patience=patience), core
        self._left = Counter(wanted)  # looks at the picture of each stamp
        self._pictures: dict[float, np.ndarray] = {}

    def instead(self, event: Event) -> Iterator[Event]:
        """What comes in place of an event."""
        if isinstance(event, FrameCame) and event.panorama is not None and self._left[event.stamp]:
            self._pictures[event.stamp] = event.panorama
        if not isinstance(event, EvidenceCame):
            yield event
            return
        panorama = self._pictures.get(event.stamp)
        self._left[event.stamp] -= 1
        if not self._left[event.stamp]:
            self._pictures.pop(event.stamp, None)
        if panorama is None:  # it was left out of the recording
            return
        pose = self._core.orientation(event.stamp)
        for said in self._keeper.look(panorama, [event.query], event.told, pose):
            if isinstance(said, Looked):
                yield replace(event, looks=said.looks, seconds=said.seconds)
            elif isinstance(said, Failed):
                yield Trouble(event.arrival, "perception", said.text, said.query or "")

    def close(self) -> None:
        self._keeper.close()
