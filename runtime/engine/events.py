"""Events: every step of an arrangement, as observers see it.

All carry the round, counted from 1, and the time of the arrangement's clock in nanoseconds.
An observer is any function of one event; with none attached no event is made. A machine's
`index` is its place in the order; that it hides `tuple.index` is what the ignored types are.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum, StrEnum
from typing import NamedTuple, TypeAlias

from llfsm.runtime.engine.errors import ObserverError


class Request(StrEnum):
    """A request of another machine, or of the machine itself, for a machine's next turn."""

    SUSPEND = "suspend"
    RESUME = "resume"
    RESTART = "restart"


class Status(IntEnum):
    """The status of a machine before a request, which returns it; with clfsm's numbers."""

    ERROR = -1
    RUNNING = 0
    SUSPENDED = 1


class Reason(StrEnum):
    """The reason for which an arrangement ended."""

    ACCEPTING = "accepting"  # every machine accepts or is suspended
    STOPPED = "stopped"  # asked to stop, and the grace period is over
    MAX_ROUNDS = "max_rounds"
    FAILED = "failed"  # code of a machine or an observer raised, and nothing can resume it
    INTERRUPTED = "interrupted"  # KeyboardInterrupt, SystemExit
    CLOSED = "closed"  # `end` was called, or its `with` block was left


class RoundBegin(NamedTuple):
    """A round begins."""

    round: int
    time_ns: int


class Turn(NamedTuple):
    """A machine has the token; its pending `request` is not applied yet.

    `previous` is None before the first ringlet and after a restart.
    """

    round: int
    time_ns: int
    index: int  # type: ignore[assignment]
    machine: str
    state: str
    previous: str | None
    request: Request | None


class Section(NamedTuple):
    """A section is about to run, also if it is empty."""

    round: int
    time_ns: int
    machine: str
    state: str
    section: str


class Eval(NamedTuple):
    """Transition number `transition` of a state was evaluated."""

    round: int
    time_ns: int
    machine: str
    state: str
    transition: int
    label: str
    target: str
    value: bool


class Call(NamedTuple):
    """A section called a control function, which has returned `result`."""

    round: int
    time_ns: int
    machine: str
    state: str
    operation: str
    argument: str | int | None
    result: object


class Accepting(NamedTuple):
    """A machine ended its ringlet in an accepting state.

    `action` is "unloaded", "kept: suspended", "kept: -u" or "kept: scheduled for <request>".
    """

    round: int
    time_ns: int
    index: int  # type: ignore[assignment]
    machine: str
    action: str


class Failed(NamedTuple):
    """Code of a machine raised `error`; it was suspended, or unloaded if it already was."""

    round: int
    time_ns: int
    index: int  # type: ignore[assignment]
    machine: str
    error: Exception


class Standing(NamedTuple):
    """The standing of a machine; `entered_ns` is when its state clock started, None if never."""

    index: int  # type: ignore[assignment]
    machine: str
    state: str
    suspended: bool
    request: Request | None
    entered_ns: int | None


class RoundEnd(NamedTuple):
    """A round is over; `machines` is in order of index, with None for each hole."""

    round: int
    time_ns: int
    fired: bool
    accepting: bool
    machines: tuple[Standing | None, ...]


class IdleSleep(NamedTuple):
    """The arrangement is about to sleep."""

    round: int
    time_ns: int
    duration_ns: int


class End(NamedTuple):
    """The arrangement has ended."""

    round: int
    time_ns: int
    reason: str


Event: TypeAlias = (
    RoundBegin | Turn | Section | Eval | Call | Accepting | Failed | RoundEnd | IdleSleep | End
)
"""What an observer is called with; each is a NamedTuple of `llfsm.runtime.engine.events`."""

Observer: TypeAlias = Callable[[Event], None]
"""A function that is called with each event; if it raises, the run ends with `ObserverError`."""


class Observers(list[Observer]):
    """The observers of an arrangement, in the order in which they are called."""

    def emit(self, event: Event) -> None:
        """Call each with an event; raise `ObserverError` if one of them raises."""
        for observer in tuple(self):
            try:
                observer(event)
            except Exception as error:
                raise ObserverError(
                    f"observer {observer!r} raised {type(error).__name__}: {error}"
                ) from error


class Trace(list[Event]):
    """Record every event: an observer that is the list of what it saw."""

    def __call__(self, event: Event) -> None:
        """Append `event`."""
        self.append(event)

    def sections(self) -> list[tuple[int, str, str, str]]:
        """Return the order alone: (round, machine, section, state) of each section run."""
        return [(e.round, e.machine, e.section, e.state) for e in self if isinstance(e, Section)]
