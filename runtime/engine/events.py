"""What observers see: every step of an arrangement as a NamedTuple.

All carry the round, counted from 1, and the time of the arrangement's clock in nanoseconds.
An observer is any function of one event; with none attached no event is made. A machine's
`index` is its place in the order; that it hides `tuple.index` is what the ignored types are.

Who watches an arrangement: observers, and the one that records all that it sees.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

from llfsm.runtime.engine.errors import ObserverError

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import Read
    from llfsm.runtime.engine.errors import ExecutionError
    from llfsm.runtime.engine.seat import Seat


class Request(StrEnum):
    """What another machine, or the machine itself, asks to be done at a machine's next turn."""

    SUSPEND = "suspend"
    RESUME = "resume"
    RESTART = "restart"


class Status(IntEnum):
    """What a request returns, with clfsm's numbers: the status of the machine before it."""

    ERROR = -1
    RUNNING = 0
    SUSPENDED = 1


class Reason(StrEnum):
    """Why an arrangement ended."""

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
    """Where a machine stands; `entered_ns` is when its state clock started, None if never."""

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


class Instrument(Protocol):
    """What a debugger adds to an arrangement, where observing every event would cost too much."""

    def bound(self, seat: Seat) -> None:
        """Wrap what is of interest of a machine's table, which has just been bound."""
        ...

    def reading(self, seat: Seat, slot: str, read: Read) -> Read:
        """Return what reads a sensor of `slot`, in place of `read`."""
        ...

    def look(self) -> None:
        """Do what is due; called several times a second where requests come from outside."""
        ...

    def end_lease(self, machine: str, slot: str) -> None:
        """End the lease of what was overridden before: it does not end the override after it."""
        ...

    def left_s(self, machine: str, sensor: str) -> float | None:
        """Return how long a sensor stays overridden; None if only a release ends that."""
        ...

    def pause_left_s(self) -> float | None:
        """Return the seconds until a pause ends, unless renewed; None if only a request does."""
        ...

    def failed(self, seat: Seat, error: ExecutionError) -> None:
        """Note that code of a machine has raised; what comes of that waits for the return."""
        ...


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
