"""Tables as notebooks show them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

import msgspec

from .own_slots import is_own
from .poller import BoardPoller, is_data
from .schema import to_plain

if TYPE_CHECKING:
    from .board import Board

__all__ = ["board_html", "html_table"]

_LONGEST = 200  # characters of a message


def html_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return an HTML table; every cell is text, whatever it contains."""
    lines = ["<table>", _row("th", head), *(_row("td", row) for row in rows), "</table>"]
    return "\n".join(lines)


def board_html(board: Board) -> str:
    """Return the slots of a board but llfsm's own, with the latest message of each."""
    return html_table(("slot", "type", "messages", "latest"), _slots(board))


def _slots(board: Board) -> Iterator[Sequence[object]]:
    poller = BoardPoller(board, wants=lambda name: is_data(name) and not is_own(name))
    poller.poll()
    for slot in poller.slots.values():
        text = slot.problem
        if slot.sample is not None:
            text = msgspec.json.encode(to_plain(slot.sample.message)).decode(errors="replace")
        shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
        yield slot.name, slot.info.type_name, slot.count, shown


def _row(kind: str, cells: Iterable[object]) -> str:
    return f"<tr>{''.join(f'<{kind}>{escape(str(cell))}</{kind}>' for cell in cells)}</tr>"
