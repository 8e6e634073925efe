"""A machine on the whiteboard: its slots, the name that it has there, and its last will.

Beside its status, a machine publishes its *definition* once, from which a viewer makes a table
again to draw it, and, while somebody looks, the values of its *variables* and *why* it is in its
state. Each of them has a limit: whatever a machine holds, publishing it must not stop a robot.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

import msgspec

from llfsm.errors import one_line
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.source_text import TextOnly, body_of
from llfsm.runtime.engine.state import SECTIONS, State, Transition
from llfsm.runtime.engine.table import (
    DrawnRuns,
    MachineLayout,
    StateBox,
    Table,
    TransitionPath,
    numbered_names,
    run_by,
    run_names,
)
from llfsm.runtime.log import logger
from llfsm.runtime.presence.remote import is_live
from llfsm.runtime.presence.will import Will, vacate_executed
from llfsm.runtime.value_text import ValueText
from llfsm.whiteboard.errors import BoardFullError, MessageError, SlotError
from llfsm.whiteboard.messages.llfsm import (
    MACHINES,
    VIEWER,
    DefinedBox,
    DefinedSection,
    DefinedState,
    DefinedTransition,
    InnerDefinition,
    MachineDefinition,
    MachineRequest,
    MachineStatus,
    MachineVariables,
    MachineWhy,
    VariableValue,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
    why_slot,
    will_slot,
)

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.seat import Failure
    from llfsm.whiteboard import Board, BoundSlot, Message, Slot


_RUNS: Final = "Runs"  # published as a section: what the state runs, a line each
_TEXT: Final = 200  # characters of a value that is published
_VARIABLES: Final = 12 << 10  # bytes of all of a machine's values: what is more is left out
_MOST: Final = {  # drawn in seconds
    "inner machines": 50,
    "states": 250,
    "transitions": 800,
    "characters": 1_000_000,
}


def definition_of(table: Table, *, sections: bool = True, inner: bool = True) -> MachineDefinition:
    """Describe a machine by its states and transitions, with or without its code and inner ones."""
    return MachineDefinition(
        table.path,
        tuple(_state(state, table.layout, sections) for state in table.states),
        "" if table.suspend is None else table.suspend.name,
        tuple(islice(_inner(table, "", (table,)), _MOST["inner machines"])) if inner else (),
    )


def _inner(table: Table, outer: str, around: tuple[Table, ...]) -> Iterator[InnerDefinition]:
    """Describe the machines that the states of a table may run, but those they are inside of."""
    for state in table.states:
        for number, runs in enumerate(state.runs):
            for cls in run_by(runs):
                if cls.table in around:
                    continue
                name = outer + table.inner_name(state, number, cls.__name__)
                within = definition_of(cls.table, sections=False, inner=False)
                yield InnerDefinition(
                    name, state.name, number, within.path, within.states, within.suspend
                )
                yield from _inner(cls.table, f"{name}/", (*around, cls.table))


def _state(state: State, layout: MachineLayout | None, sections: bool) -> DefinedState:
    drawn = None if layout is None else layout.states.get(state.name)
    paths = () if layout is None else layout.transitions.get(state.name, ())
    box = None
    if drawn is not None:
        x, y, w, h = map(float, drawn[:4])
        box = DefinedBox(x, y, w, h, drawn.expanded)
    return DefinedState(
        state.name,
        tuple(_sections(state, sections=sections)),
        tuple(
            DefinedTransition(t.target.name, t.label, _path(paths[i]) if i < len(paths) else ())
            for i, t in enumerate(state.transitions)
        ),
        box,
    )


def _sections(state: State, *, sections: bool) -> Iterator[DefinedSection]:
    if state.runs:
        yield DefinedSection(_RUNS, "\n".join(run_names(state)))
    for name in SECTIONS if sections else ():
        if name in state.sections:
            yield DefinedSection(name, body_of(state.sections[name]) or "")


def _path(path: TransitionPath) -> tuple[float, ...]:
    points = (path.src, path.dst, path.control1, path.control2)
    return tuple(float(number) for point in points for number in point)


def table_of(definition: MachineDefinition) -> Table:
    """Return a machine's table, to be drawn and not to be run, from its definition.

    Raise `DefinitionError` if it contradicts itself or is too large to be drawn: any process that
    may write to a board may have written it.
    """
    _check(definition, definition.inner)
    table = _table(definition)
    tables = {"": table}
    for each in definition.inner:
        outer, _, name = each.name.rpartition("/")
        states = {state.name: state for state in tables[outer].states} if outer in tables else {}
        runs = states[each.state].runs if each.state in states else ()
        if each.name in tables or each.number not in range(len(runs)):
            raise DefinitionError(f"{definition.path}: no state of it runs {each.name!r}")
        inner = tables[each.name] = _table(each)
        place: Any = runs[each.number]
        place.tables = (*place.tables, (name, inner))
    return table


def _table(definition: MachineDefinition | InnerDefinition) -> Table:
    states = {defined.name: State(defined.name) for defined in definition.states}
    if len(states) < len(definition.states) or not states:
        raise DefinitionError(f"{definition.path}: no states, or two of the same name")
    boxes: dict[str, StateBox] = {}
    drawn: dict[str, tuple[TransitionPath, ...]] = {}
    for defined in definition.states:
        state = states[defined.name]
        state.suspend = defined.name == definition.suspend
        for section in defined.sections:
            if section.name in SECTIONS:
                state.sections[section.name] = TextOnly(section.text)
            elif section.name == _RUNS:
                state.runs = tuple(map(DrawnRuns, section.text.splitlines()))
        for transition in defined.transitions:
            if transition.target not in states:
                raise DefinitionError(
                    f"{definition.path}: state {defined.name!r} has a transition to "
                    f"{transition.target!r}, which is not a state of it"
                )
            state.transitions.append(
                Transition(state, states[transition.target], ("", 0), None, None, transition.label)
            )
        if defined.box is not None:
            boxes[defined.name] = StateBox(*_finite(msgspec.structs.astuple(defined.box)))
        paths = [transition.path for transition in defined.transitions]
        whole = paths[: next((i for i, path in enumerate(paths) if len(path) != 8), len(paths))]
        drawn[defined.name] = tuple(_drawn(path) for path in whole)
    table = Table(definition.path, tuple(states.values()), {}, {}, {})
    table.layout = MachineLayout(boxes, drawn) if boxes else None
    return table


def _drawn(path: tuple[float, ...]) -> TransitionPath:
    x0, y0, x1, y1, x2, y2, x3, y3 = _finite(path)
    return TransitionPath((x0, y0), (x1, y1), (x2, y2), (x3, y3))


def _finite(numbers: tuple[Any, ...]) -> tuple[Any, ...]:
    if not all(math.isfinite(number) and abs(number) < 1e6 for number in numbers):
        raise DefinitionError(f"a layout has impossible coordinates: {numbers}")
    return numbers


def _check(definition: MachineDefinition, inner: Sequence[InnerDefinition]) -> None:
    parts: list[MachineDefinition | InnerDefinition] = [definition, *inner]
    states = [state for each in parts for state in each.states]
    transitions = [t for state in states for t in state.transitions]
    texts = [section.text for state in states for section in state.sections]
    texts += [text for t in transitions for text in (t.label, t.target)]
    texts += [definition.path, *(state.name for state in states)]
    texts += [text for each in inner for text in (each.path, each.name)]
    sizes = {
        "inner machines": len(inner),
        "states": len(states),
        "transitions": len(transitions),
        "characters": sum(map(len, texts)),
    }
    for what, size in sizes.items():
        if size > _MOST[what]:
            raise DefinitionError(f"it has {size} {what}; up to {_MOST[what]} are drawn")


_texts: Final = ValueText(_TEXT)


def variables_of(machine: Machine) -> MachineVariables:
    """Return the values of a machine's variables and sensors; this never raises."""
    table = type(machine).table
    variables, left = _values(machine, table.variables, _VARIABLES)
    sensors, _ = _values(machine, table.sensors, left)
    return MachineVariables(variables, sensors)


def _values(
    machine: Machine, names: Iterable[str], left: int
) -> tuple[tuple[VariableValue, ...], int]:
    """Return the values that fit into so many bytes, and how many are left."""
    values = []
    for name in names:
        value = _plain(getattr(machine, name, None))
        left -= 4 * (len(name) + (len(value) if isinstance(value, str) else 2)) + 8
        if left < 0:
            break
        values.append(VariableValue(name, value))
    return tuple(values), left


def _plain(value: Any) -> bool | int | float | str | None:
    kind = type(value)
    if value is None or kind in (bool, float) or (kind is int and -(2**63) <= value < 2**63):
        return value  # type: ignore[no-any-return]
    if kind is not str:
        return _texts.text(value)
    text = value if len(value) <= _TEXT else f"{value[: _TEXT - 1]}…"
    try:
        text.encode()
    except UnicodeError:
        return _texts.text(value)
    return text


class PublishedMachine:
    """The slots of one machine. The machine of another process may have its name there."""

    def __init__(
        self,
        board: Board,
        name: str,
        machine: Machine,
        safe_values: list[tuple[Slot[Any], Message]],
        silent_ms: int,
    ):
        self._board = board
        self._machine = machine
        self._safe_values = safe_values
        self._silent_ms = silent_ms
        self.name = self.published_name = name
        self.rival: MachineStatus | None = None  # of the live machine that has the name
        self._will: Will | None = None
        self._take()

    def _take(self) -> None:
        """Claim a name that no live machine has: `P`, else `P.0`, `P.1` …, as in an arrangement."""
        for names in numbered_names(self.name):
            self._slot = self._board[status_slot(names)]
            sample = self._slot.sample()
            if sample is None or not is_live(sample):
                break
            self.rival = self.rival or sample.message
        self.published_name = names
        if self._will is not None:  # under the name that another process has claimed, too
            self._will.withdraw()
            self._will = None
        self._requests: BoundSlot[MachineRequest] = self._board[request_slot(names)]
        self._requests.reserve()  # it is read here, and only an add or this keeps the name
        self._will = self._leave_will(names)
        self.obeyed = self._requests.count  # those were for an earlier process
        self._count = 0
        self.published: MachineStatus | None = None
        self.beat_ns = 0
        self._variables = variables_slot(names)
        self._why = why_slot(names)
        self._define(names)

    def exchange(self, machine: Machine, safe_values: list[tuple[Slot[Any], Message]]) -> None:
        """Publish the definition of the machine, if it is another one, and leave its last will."""
        if machine is self._machine:
            return
        self._machine, self._safe_values = machine, safe_values
        before, self._will = self._will, self._leave_will(self.published_name)
        if before is not None:
            before.withdraw()  # which does nothing where the new one has replaced it
        self._define(self.published_name)

    def _leave_will(self, names: str) -> Will | None:
        if not self._safe_values:
            return None
        try:
            will = Will(self._board, names, self._safe_values, self._silent_ms)
            will.leave()
        except BoardFullError as error:
            logger().warning("%s has no last will: %s", names, error)
            return None
        return will

    def _define(self, names: str) -> None:
        """Post the definition; without code or inner machines if it is too large or not text."""
        for sections, inner in ((True, True), (False, True), (False, False)):
            table = type(self._machine).table
            definition = definition_of(table, sections=sections, inner=inner)
            with suppress(MessageError):
                try:
                    self._board[definition_slot(names)].add(definition)
                except BoardFullError as error:
                    logger().warning("%s is published without its diagram: %s", names, error)
                return

    def post_variables(self) -> None:
        """Post the values of the machine's variables and sensors, if it has any."""
        table = type(self._machine).table
        if table.variables or table.sensors:
            self._board[self._variables].add(variables_of(self._machine))

    def post_why(self, why: MachineWhy) -> None:
        """Post why the machine is in its state; without what was before if that is too large."""
        for each in (why, MachineWhy(why.state, ())):
            with suppress(MessageError):
                self._board[self._why].add(each)
                return

    def keep(self) -> None:
        """Keep the name, or claim another one if another process claimed it at the same moment.

        Leave the last will again if a guard has executed it.
        """
        if self._count and self._slot.count != self._count:
            sample = self._slot.sample()
            if sample is not None and is_live(sample):
                self._take()
        with suppress(BoardFullError):
            self._requests.reserve()
        if self._will is not None:
            self._will.keep()

    def post(self, status: MachineStatus, now_ns: int) -> None:
        """Post the status."""
        self._count = self._slot.add(status)
        self.published, self.beat_ns = status, now_ns

    def request(self) -> MachineRequest | None:
        """Return the request that came since the last call: the latest replaces the others."""
        sample = self._requests.sample()
        if sample is None or sample.count == self.obeyed:
            return None
        self.obeyed = sample.count
        return sample.message

    def leave(self, failure: Failure | None = None) -> None:
        """Post that the machine is gone, and give up its name; the status of a failure stays."""
        if self._will is not None:
            self._will.withdraw()
        if self.published is None or self._slot.count != self._count:
            return
        status = MachineStatus(self.published.state, loaded=False)
        if failure is None:
            self._slot.add(status)
            _vacate(self._board, self.published_name)
        else:  # who looks once a second, as a host's daemon, finds it as one that has died
            error = one_line(failure.error)
            self._slot.add(msgspec.structs.replace(status, failed=True, error=error))


def vacate_dead(board: Board, *, after_s: float = 60.0) -> None:
    """Give up the names of machines whose processes died so long ago; till then they are shown."""
    listed = [info.name for info in board.slots()]
    for machine in [name.removeprefix(MACHINES) for name in listed if name.startswith(MACHINES)]:
        with suppress(SlotError, MessageError):  # not a machine's slots, whatever their names
            sample = board.present(status_slot(machine)).sample()
            if sample is None or time.monotonic_ns() - sample.stamp_ns < after_s * 1e9:
                continue
            if not is_live(sample):
                _vacate(board, machine)
                if will_slot(machine).name in listed:
                    vacate_executed(board, machine)


def _vacate(board: Board, machine: str) -> None:
    for slot in (status_slot, request_slot, definition_slot, variables_slot, why_slot):
        board.vacate(slot(machine))


_VIEW_NS = 2_000_000_000  # a viewer that has posted its presence looks for so long
_PERIOD_NS = 100_000_000


class Viewing:
    """Post the variables of an arrangement's machines, and why they are in their states.

    `tolerating` is entered for each post: what it raises must not stop a robot.
    """

    def __init__(
        self,
        arrangement: Arrangement,
        board: Board,
        now_ns: int,
        machine_now: Callable[[], int],
        tolerating: AbstractContextManager[object],
    ):
        self._arrangement = arrangement
        self._machine_now = machine_now
        self._tolerating = tolerating
        self._viewer = board[VIEWER]
        self._seen = self._viewer.count
        self._ends_ns = self._why_ends_ns = self._due_ns = now_ns
        self._is_sampled = False  # whether a round was to be seen since somebody asks why

    @property
    def due_ns(self) -> int | None:
        """When there is something to post; None while nobody looks."""
        return self._due_ns if self._due_ns < self._ends_ns else None

    def hurry(self, now_ns: int) -> None:
        """Post at the next look, though time may stand still."""
        self._due_ns = now_ns

    def look(self, entries: Collection[PublishedMachine], now_ns: int) -> None:
        """Post what is due."""
        if self._viewer.count != self._seen:
            self._seen = self._viewer.count
            self._ends_ns = now_ns + _VIEW_NS
            viewer = self._viewer.get()
            if viewer is not None and viewer.why:
                self._is_sampled = self._is_sampled and now_ns < self._why_ends_ns
                self._why_ends_ns = self._ends_ns
        if not self._due_ns <= now_ns < self._ends_ns:
            return
        self._due_ns = now_ns + _PERIOD_NS
        for entry in entries:
            with self._tolerating:
                entry.post_variables()
        if now_ns < self._why_ends_ns:
            self._post_whys(entries)

    def _post_whys(self, entries: Collection[PublishedMachine]) -> None:
        """Post what the machines saw in a round since the last time, and have the next one seen."""
        # here, because few look
        from llfsm.runtime.debugging.debugger import Debugger
        from llfsm.runtime.debugging.obeying import why_of

        is_paused = bool(self._arrangement.kernel.paused)  # then no round comes
        is_ready, self._is_sampled = self._is_sampled or is_paused, not is_paused
        for entry in entries if is_ready else ():
            with self._tolerating:
                entry.post_why(why_of(self._arrangement, entry.name, self._machine_now()))
        Debugger.of(self._arrangement).turns.sample()
