"""One source that many pages watch: who comes late gets the newest scene, picture and belief at once."""

from __future__ import annotations

from dataclasses import dataclass, field

from eagor.studio.slots import Slot
from eagor.studio.wire import Message, merged

__all__ = ["Channel"]


@dataclass(eq=False)
class Channel:
    """The slots of those who watch, and what was said last."""

    slots: list[Slot] = field(default_factory=list)
    _said: dict[str, Message] = field(default_factory=dict)
    _step: Message | None = None

    def join(self, slot: Slot) -> None:
        """Watch from now on."""
        self.slots.append(slot)
        for message in self._said.values():
            slot.put(message)
        if self._step is not None:
            slot.put(self._step)

    def leave(self, slot: Slot) -> None:
        """Watch no more."""
        if slot in self.slots:
            self.slots.remove(slot)

    def put(self, message: Message) -> None:
        """Give a message to all."""
        if message.header["type"] == "step":
            self._step = merged(self._step, message)
        else:
            self._said[message.header["type"]] = message
            if message.header["type"] == "scene":
                self._step = None
                self._said.pop("status", None)  # what was said while it was being opened
        for slot in self.slots:
            slot.put(message)
