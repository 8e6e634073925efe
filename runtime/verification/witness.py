"""Ways through the states, as data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias

from ..engine.events import Request
from .values import message_text

__all__ = ["ChosenTurn", "LastAsk", "Witness"]

LastAsk: TypeAlias = Literal["suspend", "stop"]


class ChosenTurn(NamedTuple):
    """A turn of a machine, and what its environment did just before.

    `found` is what the environment put into the slots that it writes, by name (None: no message),
    `request` what was asked of the machine from outside, and `stop` whether a stop came. The time
    is that of the round, in milliseconds; the first round is number 1, one period after 0.
    """

    round: int
    time_ms: float
    machine: str
    found: Mapping[str, Any]
    request: Request | None
    stop: bool
    withdraws: bool = False
    """Whether a suspend was asked for before the request: a resume alone replaces no restart."""


class Witness(NamedTuple):
    """A way from the initial state: `turns`, and those that complete the last round, or the first.

    With a `loop`, the turns from that index on can repeat for ever. Where the machines end instead,
    `at_end` has what is asked of them, by name, when the last round is over.
    """

    turns: tuple[ChosenTurn, ...]
    rest: tuple[ChosenTurn, ...]
    loop: int | None = None
    at_end: Mapping[str, tuple[LastAsk, ...]] = MappingProxyType({})

    def lines(self) -> Iterator[str]:
        """Return what is new in the environment before each turn, in a line."""
        contents: dict[str, Any] = {}
        for turn in self.turns:
            news = [
                message_text(slot, message)
                for slot, message in turn.found.items()
                if slot not in contents or contents[slot] is not message  # equal ones are one
            ]
            contents.update(turn.found)
            if turn.withdraws:
                news.append("suspend is asked for")
            if turn.request is not None:
                news.append(f"{turn.request.value} is asked for")
            if turn.stop:
                news.append("stop is asked for")
            if news:
                where = f"round {turn.round}, {turn.time_ms:.10g} ms, {turn.machine}"
                yield f"{where}: {', '.join(news)}"
        yield from self.end_lines()

    def end_lines(self) -> Iterator[str]:
        """Return what is asked when the last round is over, in a line for each machine."""
        for name, asks in self.at_end.items():
            news = ", ".join(f"{ask} is asked for" for ask in asks)
            yield f"at the end of the round, {name}: {news}"
