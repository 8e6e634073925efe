"""What an exploration found."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .breadth_first import Search
from .errors import VerificationError
from .exporting import export, nodes_of
from .members import Member
from .passing import Periods
from .properties import Verdict
from .system import System

__all__ = ["Progress", "Space"]

_MANY = 1_000
"""Values of a variable, or periods of a wait, that make for many states."""


class Progress(NamedTuple):
    """How far an exploration has come; `depth` counts turns from the initial state."""

    states: int
    transitions: int
    depth: int
    seconds: float


class Space:
    """What an exploration found; `verdicts` are those of the properties, in their order.

    A state is whose turn is next, at the beginning of a round the first machine's, and: of each
    machine its current, previous and remembered state, its pending request, whether it has accepted
    and is still loaded, its variables, and for how many periods it has been in its state (0 if it
    has had no turn there), counted until the longest time that is asked about in that state is
    over; of each slot that a machine posts to and some machine reads, or a property names, its
    content; whether a stop has come. Of a slot that the environment writes, the content is part of
    a state only if a property names it, or in a round that has begun if choices are made by rounds.

    There is a transition for each state and all that the environment may do at its turn. A round
    begins with a period that passes. A state has no transitions if code has raised, or if all
    machines accept or are suspended when a round would begin, and no request from outside may
    change that.
    """

    def __init__(
        self,
        system: System,
        search: Search,
        members: tuple[Member, ...],
        verdicts: tuple[Verdict, ...],
        seconds: float,
        *,
        ringlets: int,
        complete: bool,
        cut: bool,
    ):
        self.states = search.states
        """The number of states that can be reached."""
        self.transitions = search.transitions
        """The number of transitions between them."""
        self.ringlets = ringlets
        """How many ringlets were run; the others were looked up."""
        self.depth = len(search.levels) - 1
        """The number of turns after which no state is new."""
        self.seconds = seconds
        self.complete = complete
        """Whether all states were found, and each ringlet does the same again."""
        self.cut = cut
        """Whether Ctrl-C or `max_seconds` has ended it before all was decided."""
        self.verdicts = verdicts
        self.unreached = tuple(system.unreached())
        """The states that no machine comes into, as "Machine.STATE"."""
        self.untaken = tuple(system.untaken())
        """The transitions that never fire, as "Machine.STATE -> TARGET: label"."""
        self.values = system.values()
        """How many values each variable has had, as "Machine.variable", the most first."""
        self.members = members
        """The machines in their order, and those that watch them."""
        self.slots = system.slots
        """The slots that they use, by name."""
        self.suspend = system.suspend
        """The names of the machines that anybody may suspend, resume or restart."""
        self.unload_accepting = system.ringlets.unload_accepting
        self.search = search
        """The states themselves, packed, and what leads from one to the next."""
        self._system = system

    def hints(self) -> Iterator[str]:
        """Return what makes many states, and what to do about it, a line each."""
        variable, number = next(iter(self.values.items()), ("", 0))
        if number >= _MANY:
            yield (
                f"{variable} has had {number:,} values: bound it, or replace it after each turn "
                f"(--abstract, abstract=)"
            )
        passing = self._system.passing
        if not isinstance(passing, Periods):
            return
        place, limit_ns = self._system.longest_wait()
        if limit_ns // passing.period_ns >= _MANY:
            yield (
                f"{place} asks whether {limit_ns / 1e6:,.10g} ms have passed, which is "
                f"{limit_ns // passing.period_ns:,} periods: give a longer period, "
                f"let any time pass (--any-time, any_time=True), or let the machine wait less"
            )

    def export(self, file: Path) -> None:
        """Write all states to a file: .drn for Storm, .pml for SPIN, .aut for Aldebaran.

        Raise `VerificationError` if not all were found, and `ConfigurationError` if the file has
        another suffix or cannot be written.
        """
        if not self.complete:
            raise VerificationError(f"{file}: nothing was written, as not all states were found")
        export(file, nodes_of(self.search, [each.property for each in self.verdicts]))
