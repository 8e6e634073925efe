"""Commands that say who has given them, and a list of them."""

from __future__ import annotations

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.local import LocalBoard

__all__ = ["ARM", "LAMP", "WHEEL", "Heard", "Speed"]


class Speed(Message):
    """A command, and who has given it."""

    by: str = ""
    value: int = 0


WHEEL, ARM, LAMP = (Slot(name, Speed) for name in ("wheel", "arm", "lamp"))


class Heard:
    """Keeps what is posted to a slot, in a list that several may share."""

    def __init__(self, board: LocalBoard, slot: Slot[Speed], posts: list[str]):
        self._bound, self._posts = board[slot], posts
        self._bound.on_add(self.note)

    def note(self, _: int) -> None:
        found = self._bound.get()
        assert found is not None
        self._posts.append(f"{found.by} {found.value}")
