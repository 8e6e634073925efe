"""What machines did, as a table: a row for each turn in which one learnt or did something new."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from ..testing.playback import journal_of
from ..verification.values import message_text

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot

    from ..journal.entries import Entry
    from ..testing.playback import Playback
    from ..testing.scripted import Step
    from ..verification.members import Member

__all__ = ["TurnRow", "rows_of", "table_of"]

_HEAD = ("round", "time", "machine", "saw", "did", "posted")
_REQUESTED = {
    "suspend": "suspended",
    "hold": "suspended",
    "resume": "resumed",
    "restart": "restarted",
}


class TurnRow(NamedTuple):
    """A turn: what is new of what the machine read, what it did, and what it posted."""

    round: int
    time_ns: int
    """When its round began; the clock begins at 0."""
    machine: str
    saw: str
    """What is new in its sensors, and what was asked of it."""
    did: str
    posted: str
    quiet: bool
    """Whether the machine neither saw nor did anything new."""


def rows_of(
    members: Iterable[Member], script: Sequence[Step], *, unload_accepting: bool = True
) -> list[TurnRow]:
    """Play a script, and return each turn."""
    playback, entries = journal_of(members, script, unload_accepting=unload_accepting)
    slots = _slots_of(playback)
    rows: list[TurnRow] = []
    turn: list[Entry] = []
    for entry in entries:
        if entry["event"] in ("Turn", "RoundEnd") and turn:
            rows.append(_row(turn, slots))
            turn = []
        if entry["event"] == "Turn" or turn:
            turn.append(entry)
    if playback.error is not None:  # in the last turn, which no other entry has ended
        last, error = _row(turn, slots), playback.error
        did = f"{last.did}, fails in {error.step}: {error.__cause__!r}"
        rows.append(last._replace(did=did, quiet=False))
    return rows


def table_of(rows: Sequence[TurnRow], marked: int | None = None) -> str:
    """Return a table of the turns that are not quiet; `marked` is the number of one that is shown.

    Rounds in which every turn is quiet are counted in one line.
    """
    cells: list[tuple[str, ...]] = [_HEAD]
    last = 0  # the round shown last
    for number, row in enumerate(rows):
        if row.quiet and number != marked:
            continue
        if row.round > last + 1:
            cells.append(("", "", _quiet_rounds(row.round - last - 1)))
        new = row.round != last
        last = row.round
        cells.append(
            (
                str(row.round) if new else "",
                f"{row.time_ns / 1e6:.10g} ms" if new else "",
                row.machine,
                row.saw,
                row.did,
                row.posted,
            )
        )
    if rows and rows[-1].round > last:
        cells.append(("", "", _quiet_rounds(rows[-1].round - last)))
    table = [row for row in cells if len(row) == len(_HEAD)]
    widths = [max(len(row[column]) for row in table) for column in range(len(_HEAD))]
    lines = []
    for line_cells in cells:
        padded = zip(line_cells, widths, strict=False)
        line = "  ".join(f"{cell:{width}}" for cell, width in padded)
        lines.append(line.rstrip())
    return "\n".join(lines)


def _quiet_rounds(number: int) -> str:
    return f"({number} more round{'s' if number > 1 else ''} in which nothing new happens)"


def _row(turn: Sequence[Entry], slots: Mapping[str, Slot[Any]]) -> TurnRow:
    first = turn[0]
    saw: list[str] = []
    posted: list[str] = []
    did: list[str] = []
    fired, request = "", first["request"]
    for entry in turn[1:]:
        match entry["event"]:
            case "Asked":
                saw.append(f"{entry['action'].replace('hold', 'suspend')} is asked for")
                request = entry["action"] if entry["action"] in _REQUESTED else request
            case "Sensed":
                saw.append(_message(entry["sensor"], entry, slots))
            case "Posted":
                posted.append(_message(entry["slot"], entry, slots))
            case "Eval" if entry["value"]:
                fired = f"{entry['state']} -> {entry['target']}"
            case "Accepting" if entry["action"] == "unloaded":
                did.append("accepts and leaves")
            case "Failed":
                did.append(f"fails: {entry['error']}")
    new = bool(saw or did or posted or fired or request) or first["previous"] != first["state"]
    if request is not None:
        did.insert(0, f"is {_REQUESTED[request]}")
    if fired or request is None:
        did.insert(0, fired or f"in {first['state']}")
    return TurnRow(
        first["round"],
        first["time_ns"],
        first["machine"],
        ", ".join(saw),
        ", ".join(did),
        ", ".join(posted),
        not new,
    )


def _slots_of(playback: Playback) -> dict[str, Slot[Any]]:
    """Return the slots that the machines use, by their names on the board."""
    slots: dict[str, Slot[Any]] = {}
    for machine in playback.scripted.machines.values():
        table = type(machine).table
        ports: list[Any] = [*table.sensors.values(), *table.actuators.values()]
        for port in ports:
            slot = machine._seat.slot_of(port)
            slots[slot.name] = slot
    return slots


def _message(name: str, entry: Entry, slots: Mapping[str, Slot[Any]]) -> str:
    data = entry["message"]
    return message_text(name, None if data is None else slots[entry["slot"]].decoder.decode(data))
