"""The space of states that an exploration found, and files of it for other tools.

Storm, SPIN and readers of Aldebaran's format get one node per state, of which the initial one is
number 0. The label of an edge names the machine on turn and the choice of its environment. A state
has a set of names: of the states of the machines, and of the predicates that hold there.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from math import inf
from pathlib import Path
from typing import Final, NamedTuple, TextIO

from llfsm.runtime._values import message_text
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.verification._breadth_first import Search, Successor
from llfsm.runtime.verification._predicates import PackedSituation, UnnamedFieldError
from llfsm.runtime.verification._system import System
from llfsm.runtime.verification._tables import Tables
from llfsm.runtime.verification._time_model import timetable_of
from llfsm.runtime.verification.domains import Member
from llfsm.runtime.verification.errors import PredicateError, VerificationError
from llfsm.runtime.verification.properties import Property, Verdict, View, evaluate

VERDICTS: Final = {True: "holds", False: "violated", None: "undecided"}
_MANY = 1_000
"""Values of a variable, or periods of a wait, that make for many states by themselves."""
_OF_STATES: Final = ("never", "always", "reachable", "eventually_always", "always_possible")
"""The kinds of properties that have one function, of a state."""


class Progress(NamedTuple):
    """The progress of an exploration; `depth` counts turns from the initial state."""

    states: int
    transitions: int
    depth: int
    seconds: float


class Space:
    """The result of an exploration; `verdicts` are those of the properties, in their order.

    A state is whose turn is next, at the beginning of a round the first machine's, and: of each
    machine its current, previous and remembered state, its pending request, whether it has accepted
    and is still loaded, its variables, and for how many periods, or units of a timetable, it has
    been in its state (0 if it has had no turn there), counted until the longest time that is asked
    about in that state is over, and so for a state in which it is to go on in place; of each slot
    that a machine posts to and some machine reads, or a property names, its content; whether a stop
    has come. Of a slot that the environment writes, the content is part of a state only if a
    property names it, or in a round that has begun if choices are made by rounds.

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
        repeated: int,
        complete: bool,
        cut: bool,
        short_of_memory: bool,
    ):
        self.states = search.states
        """The number of states that can be reached."""
        self.transitions = search.transitions
        """The number of transitions between them."""
        self.ringlets = ringlets
        """The number of ringlets that were run; all others were looked up."""
        self.repeated = repeated
        """The number of these that were run again, to see whether they do the same."""
        self.depth = len(search.levels) - 1
        """The number of turns after which no state is new."""
        self.seconds = seconds
        self.complete = complete
        """True if all states were found, and each ringlet does the same again."""
        self.cut = cut
        """True if Ctrl-C, `max_seconds` or a lack of memory has ended it before all was decided."""
        self.short_of_memory = short_of_memory
        """True if it was ended because little memory was left."""
        self.verdicts = verdicts
        self.unreached, self.untaken = system.left_out()
        """The states that no machine comes into, as "Machine.STATE", and the transitions that never
        fire, as "Machine.STATE -> TARGET: label"."""
        self.values = system.values()
        """The number of values that each variable has had, by "Machine.variable", most first."""
        self.schedule = system.time_model.schedule
        """The schedule of the runs that were explored, in words."""
        self.not_covered = system.time_model.not_covered
        """Describe runs with this schedule that were not explored; "" if there are none."""
        self.timetable = timetable_of(system.time_model)
        """When each machine has its turns; None without a timetable."""
        self.members = members
        """The machines in their order, and those that watch them."""
        self.aged = frozenset(system.withheld)
        """The slots of the environment whose messages may be too old for a sensor."""
        self.slots = system.slots
        """The slots that they use, by name."""
        self.suspend = system.suspend
        """The names of the machines that anybody may suspend, resume or restart."""
        self.unload_accepting = system.ringlets.kernel.unload_accepting
        self.on_error = system.ringlets.kernel.on_error
        self.found = system.found
        """The classes that states run though nothing names them, and what code loads."""
        self.search = search
        """The states themselves, packed, and the turns from one to the next."""
        self._system = system

    def hints(self) -> Iterator[str]:
        """Give reasons for many states, and remedies, a line each.

        What has grown while the second half of the states was found will grow on; if nothing has,
        the reason is what has most values. Name the longest wait, too, if it has as many periods.
        """
        system, (states, half) = self._system, self.search.half()
        posts = {f"slot {slot}": number for slot, number in system.posts().items()}
        numbers = self.values | posts
        before = system.values(half) | {f"slot {n}": each for n, each in system.posts(half).items()}
        growth = {name: number / max(1, before.get(name, 0)) for name, number in numbers.items()}
        most = max(numbers, key=lambda name: (growth[name], numbers[name]), default="")
        number = numbers.get(most, 0)
        place, limit_ns = system.longest_wait()
        periods = limit_ns // (system.time_model.unit_ns or inf)
        if number >= _MANY or growth.get(most, 1) > 1 or number > max(1, periods):
            trend = f"; {before.get(most, 0):,} in the first {states:,} states"
            yield (
                f"{most} has had {number:,} values: bound it, or replace it after each turn "
                f"(--abstract, abstract=)" + (trend if growth[most] > 1 else "")
            )
        if periods >= _MANY or periods >= max(1, number):
            yield (
                f"{place} asks whether {limit_ns / 1e6:,.10g} ms have passed, which is "
                f"{periods:,.0f} periods: give a longer period, "
                f"let any time pass (--any-time, any_time=True), or let the machine wait less"
            )

    def _repr_html_(self) -> str:
        """Return the verdicts, and after how many turns one is violated, for a notebook."""
        from llfsm.whiteboard.message_text import html_table  # here, as few spaces are in one

        rows = [
            (each.property, VERDICTS[each.holds], len(each.witness.turns) if each.witness else "")
            for each in self.verdicts
        ]
        return html_table(("property", "verdict", "turns"), rows)

    def export(self, file: Path) -> None:
        """Write all states to a file: .drn for Storm, .pml for SPIN, .aut for Aldebaran.

        Raise `VerificationError` if not all were found, and `ConfigurationError` if the file has
        another suffix or cannot be written.
        """
        if not self.complete:
            raise VerificationError(f"{file}: nothing was written, as not all states were found")
        export(file, nodes_of(self.search, [each.property for each in self.verdicts]))


# Files for other tools


class ExportedState(NamedTuple):
    """A state of an export."""

    edges: tuple[tuple[str, int], ...]
    """The label of the edge to each next state, and that state's number."""
    holds: Collection[str] = ()
    """The names of the predicates that hold in it."""


def nodes_of(search: Search, properties: Iterable[Property]) -> Iterator[ExportedState]:
    """Yield the states that were found, the initial one first.

    In each hold the state of each machine, as "Machine.STATE", and predicates of properties, by the
    property's name.
    """
    tables = search.tables
    names = tables.system.names
    states = [(turn, s) for level in search.levels for turn, each in level.items() for s in each]
    numbers = {state: number for number, state in enumerate(states)}
    named = [each for each in properties if each.functions and each.kind in _OF_STATES]
    for turn, state in states:
        situation = PackedSituation(tables, state, set())
        view = View(situation)
        holds = {f"{name}.{situation.control(name).current}" for name in names}
        holds |= {each.name for each in named if _holds(each, view)}
        steps = search.steps(turn, state)
        yield ExportedState(
            tuple((_label(tables, s), numbers[s.turn, s.state]) for s in steps), holds
        )


def _holds(prop: Property, view: View) -> bool:
    try:
        return evaluate(prop, prop.functions[0], view)
    except UnnamedFieldError:
        raise PredicateError(
            f"property {prop.name!r} was decided before these states, and reads here what they do "
            f"not have: export without it"
        ) from None


def _label(tables: Tables, step: Successor) -> str:
    """Name the machine on turn and the choice of its environment."""
    codes = tables.system.ringlets.messages
    parts = [
        message_text(slot, codes[slot].values[number] if number else None)
        for slot, number in (*step.round_contents, *step.choice.contents)
    ]
    if step.choice.request is not None:
        parts.append(step.choice.request.value)
    if step.choice.stop:
        parts.append("stop")
    return " ".join((tables.system.names[step.place], *parts))


def export(file: Path, nodes: Iterable[ExportedState]) -> None:
    """Write the states, in the order of their numbers, to a file of the format of its suffix.

    Raise `ConfigurationError` for another suffix than those of `EXPORTS`, and for a file that
    cannot be written.
    """
    write = EXPORTS.get(file.suffix)
    if write is None:
        known = ", ".join(EXPORTS)
        raise ConfigurationError(f"the name of an export ends with one of {known}", file=file)
    found = [*nodes]
    try:
        with file.open("w", encoding="utf-8") as stream:
            write(stream, found)
    except OSError as error:
        raise ConfigurationError(f"cannot be written: {error.strerror}", file=file) from error


def _write_aldebaran(stream: TextIO, nodes: list[ExportedState]) -> None:
    """Write a labelled transition system, as CADP's `aldebaran` page defines it."""
    edges = sum(len(node.edges) for node in nodes)
    stream.write(f"des (0, {edges}, {len(nodes)})\n")
    for number, node in enumerate(nodes):
        for label, target in node.edges:
            stream.write(f'({number}, "{_quoted(label)}", {target})\n')


def _write_storm(stream: TextIO, nodes: list[ExportedState]) -> None:
    """Write a Markov decision process in which every choice has one outcome.

    A state that nothing follows gets a choice that leads to itself, because Storm wants one.
    """
    words = _words(nodes)
    following = [node.edges or (("end", number),) for number, node in enumerate(nodes)]
    stream.write("@type: MDP\n@parameters\n\n@reward_models\n\n")
    stream.write(f"@nr_states\n{len(nodes)}\n@nr_choices\n{sum(map(len, following))}\n@model\n")
    for number, (node, edges) in enumerate(zip(nodes, following, strict=True)):
        names = [*(["init"] if number == 0 else []), *(words[name] for name in sorted(node.holds))]
        stream.write(" ".join(("state", str(number), *names)) + "\n")
        for choice, (_, target) in enumerate(edges):
            stream.write(f"\taction {choice}\n\t\t{target} : 1\n")


def _write_promela(stream: TextIO, nodes: list[ExportedState]) -> None:
    """Write a process with a place for each state, whose number is in `state`.

    Predicates are macros, to use in formulas. SPIN compiles a file of some thousand states.
    """
    stream.write("int state;\nactive proctype machines() {\n")
    for number, node in enumerate(nodes):
        if not node.edges:
            stream.write(f"end{number}: S{number}: (false);\n")
            continue
        stream.write(f"S{number}: if\n")
        for label, target in node.edges:
            stream.write(f":: state = {target}; goto S{target} /* {_quoted(label)} */\n")
        stream.write("fi;\n")
    stream.write("}\n")
    for name, word in _words(nodes).items():
        held = (f"state == {number}" for number, node in enumerate(nodes) if name in node.holds)
        stream.write(f"#define {word} ({' || '.join(held)})\n")


def _words(nodes: list[ExportedState]) -> dict[str, str]:
    """Make a word of each name of a predicate: `is_` and letters, digits and _."""
    words: dict[str, str] = {}
    for name in sorted({name for node in nodes for name in node.holds}):
        word = "is_" + re.sub(r"\W", "_", name, flags=re.ASCII)
        while word in words.values():
            word += "_"
        words[name] = word
    return words


def _quoted(label: str) -> str:
    return label.replace("\\", "/").replace('"', "'").replace("*/", "* /").replace("\n", " ")


EXPORTS: Final[dict[str, Callable[[TextIO, list[ExportedState]], None]]] = {
    ".drn": _write_storm,
    ".pml": _write_promela,
    ".aut": _write_aldebaran,
}
"""The writer of each format, by the suffix of its files."""
