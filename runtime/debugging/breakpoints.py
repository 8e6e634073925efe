"""Breakpoints: where, and under which condition, machines are to be paused.

The text of one is ``Wall:STOP`` (entering the state STOP), ``Wall:STOP->`` (leaving it by any
transition), ``Wall:STOP->TURN`` (by those to TURN), ``Wall!`` (its code raises), or
``@turtle1/pose`` (a machine has another message of the slot). ``#3`` after it means from the third
time on, and ``if x > 9`` an expression over the machine's variables and sensors, or the message.

Breakpoints can be set in machines that are called later, so these are known before they run: see
`callable_machines`.

They are tested by probes (`Probes`), which wrap sections and sensors in machines' bound tables:
what has no breakpoint is not wrapped, and costs nothing. A state is entered after a transition to
it has fired, so its probe is in the OnExit of the states before it: machines are paused before
OnEntry runs. Where a request or the start leads to the state, the probe is in its OnEntry, and the
pause comes after that turn.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.errors import BreakpointError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.table import run_by
from llfsm.runtime.expressions.evaluation import Evaluator
from llfsm.runtime.expressions.purity import EvaluationError

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import Read
    from llfsm.runtime.engine.ringlet import BoundState
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.engine.state import SectionCode


def callable_machines(classes: Mapping[str, type[Machine]]) -> dict[str, type[Machine]]:
    """Add to machines, by name, those that their code may call, which may never have been loaded.

    These are the classes of their modules and, for bundles, the bundles beside them that their code
    names, which are loaded. Raise what `load_bundle` raises.
    """
    from llfsm.runtime.bundles import load_bundle  # here, as few processes debug machines

    found = {**classes, **_in_modules_of(classes.values()), **classes}  # in the order of `classes`
    waiting = [*classes.values()]
    while waiting:
        for folder in _bundles_named_by(waiting.pop()):
            if folder.stem not in found:
                found[folder.stem] = load_bundle(folder)
                waiting.append(found[folder.stem])
    return found | _inner_of(classes)


def _inner_of(classes: Mapping[str, type[Machine]]) -> dict[str, type[Machine]]:
    """Find the classes of what states of machines run, by the names that they will have."""
    found: dict[str, type[Machine]] = {}
    todo = [(name, [cls]) for name, cls in classes.items()]
    while todo:
        name, above = todo.pop()
        table = above[-1].table
        for state in table.states:
            for number, runs in enumerate(state.runs):
                for cls in run_by(runs):
                    if cls not in above:
                        inner = f"{name}/{table.inner_name(state, number, cls.__name__)}"
                        found[inner] = cls
                        todo.append((inner, [*above, cls]))
    return found


def _in_modules_of(classes: Iterable[type[Machine]]) -> dict[str, type[Machine]]:
    modules = {cls.__module__: sys.modules.get(cls.__module__) for cls in classes}
    return {
        each.__name__: each
        for module in filter(None, modules.values())
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Machine) and each is not Machine
    }


def _bundles_named_by(cls: type[Machine]) -> Iterator[Path]:
    """Give the folders of bundles beside a bundle that are named by texts in its code."""
    from llfsm.runtime.bundles import SUFFIX

    folder = Path(cls.table.path)
    if folder.suffix != SUFFIX:
        return
    for state in cls.table.states:
        for code in state.sections.values():
            for text in code.__code__.co_consts if isinstance(code, FunctionType) else ():
                if isinstance(text, str) and text.isidentifier():
                    other = folder.with_name(f"{text}{SUFFIX}")
                    if other.is_dir():
                        yield other


_TEXT: Final = re.compile(
    r"(?:@(?P<slot>[^\s#]+)"
    r"|(?P<machine>[^\s:@#!]+)(?:(?P<failure>!)"
    r"|:(?P<state>[^\s#]+?)(?:(?P<leave>->)(?P<target>[^\s#]*))?))"
    r"(?:#(?P<count>[1-9]\d*))?(?:\s+if\s+(?P<condition>.+))?"
)


class Breakpoint(NamedTuple):
    """One breakpoint, as its text says; without a machine, it is one of a slot's messages."""

    text: str
    machine: str = ""
    state: str = ""
    leaves: bool = False
    target: str = ""
    slot: str = ""
    least: int = 1
    """The number of the first hit at which to pause."""
    condition: ast.expr | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a breakpoint's text; raise `BreakpointError`."""
        found = _TEXT.fullmatch(text.strip())
        if found is None:
            raise BreakpointError(
                f"{text!r} is not a breakpoint; write Machine:STATE, Machine:STATE->, "
                f"Machine:STATE->TARGET, Machine! or @slot, then #2 and ` if CONDITION` as needed"
            )
        condition = None
        if found["condition"]:
            try:
                condition = ast.parse(found["condition"].strip(), mode="eval").body
            except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
                raise BreakpointError(f"{text!r}: its condition is wrong: {error}") from error
        return cls(
            text.strip(),
            found["machine"] or "",
            found["state"] or "",
            bool(found["leave"]),
            found["target"] or "",
            found["slot"] or "",
            int(found["count"] or 1),
            condition,
        )

    @property
    def fails(self) -> bool:
        """True if it is one of a failure, as ``Wall!``."""
        return bool(self.machine) and not self.state

    def holds(self, owner: Any) -> bool:
        """Evaluate its condition for a machine or message; raise what that raises."""
        return self.condition is None or bool(Evaluator(owner).value(self.condition))


def check_breakpoints(
    breakpoints: Iterable[Breakpoint], machines: Mapping[str, type[Machine]], slots: Iterable[str]
) -> None:
    """Raise `BreakpointError` for one whose machine, state, transition or slot does not exist.

    `machines` are those that run, and others that they may load, by name: those beside them in
    their modules are known, too. `slots` are what they read.
    """
    known = {**_in_modules_of(machines.values()), **_inner_of(machines), **machines}
    for each in breakpoints:
        if each.slot:
            sensors = (port for cls in known.values() for port in cls.table.sensors.values())
            read = {*slots, *(sensor.slot.name for sensor in sensors)}
            _require(each, "slot that a machine reads", each.slot, read)
            continue
        cls = known.get(each.machine)
        if cls is None:
            _require(each, "machine", each.machine, machines)
            continue
        states = {state.name: state for state in cls.table.states}
        if each.state and (each.leaves or each.state != "Suspended"):
            _require(each, f"state of {each.machine}", each.state, states)
        if each.target:
            targets = {transition.target.name for transition in states[each.state].transitions}
            _require(each, f"transition from {each.state} to", each.target, targets)


def _require(breakpoint: Breakpoint, what: str, name: str, known: Iterable[str]) -> None:
    if name not in (names := sorted(known)):
        raise BreakpointError(
            f"breakpoint {breakpoint.text!r}: no {what} {name!r}; there are: "
            f"{', '.join(names) or 'none'}{did_you_mean(name, names)}"
        )


class Probes:
    """The breakpoints of an arrangement; those that were there `before` go on counting hits.

    `hit` is called with a breakpoint, what was wrong with its condition, its machine, and the state
    that this has left, if any.
    """

    def __init__(
        self,
        breakpoints: Iterable[Breakpoint],
        hit: Callable[[Breakpoint, str, Seat, str], None],
        before: Probes | None = None,
    ):
        self.breakpoints = tuple(breakpoints)
        self._hit = hit
        known = {} if before is None else before._hits
        self._hits: dict[str, int] = {
            each.text: known.get(each.text, 0) for each in self.breakpoints
        }

    def wrap(self, seat: Seat) -> None:
        """Wrap sections of a machine that has just been bound."""
        mine = [each for each in self.breakpoints if each.machine == seat.name and each.state]
        entered = {each.state for each in mine if not each.leaves}
        for state in (*seat.states.values(), seat.suspension) if mine else ():
            if state.name in entered:
                code = None if state.name not in seat.states else state.on_entry
                here = [each for each in mine if not each.leaves and each.state == state.name]
                state.on_entry = self._probe(seat, code, partial(_reached_by_entering, seat, here))
            targets = {target.name for *_, target in state.transitions if target is not state}
            if entered & targets or any(each.leaves and each.state == state.name for each in mine):
                reached = partial(_reached_by_leaving, seat, state, mine)
                state.on_exit = self._probe(seat, state.on_exit, reached, state.name)

    def reading(self, seat: Seat, slot: str, read: Read) -> Read:
        """Wrap the reading of a sensor of `slot` so that each new message is tested."""
        here = [each for each in self.breakpoints if each.slot == slot]
        latest: object = None

        def read_and_test() -> object:
            nonlocal latest
            message = read()
            if message is not latest:
                latest = message
                for each in here:
                    if message is not None:
                        self.test(each, seat, message, "")
            return message

        return read_and_test if here else read

    def test_failures(self, seat: Seat) -> None:
        """Test the breakpoints of a failure of a machine, whose code has raised."""
        for each in self.breakpoints:
            if each.fails and each.machine == seat.name:
                self.test(each, seat, seat.machine, "")

    def test(self, breakpoint: Breakpoint, seat: Seat, owner: object, source: str) -> None:
        """Count a hit, if the condition holds; one that cannot be evaluated is one, too."""
        try:
            if not breakpoint.holds(owner):
                return
        except Exception as error:
            kind = "" if isinstance(error, EvaluationError) else f"{type(error).__name__}: "
            problem = f": its condition cannot be evaluated: {kind}{error}"
            self._hit(breakpoint, problem, seat, source)
            return
        self._hits[breakpoint.text] += 1
        if self._hits[breakpoint.text] >= breakpoint.least:
            self._hit(breakpoint, "", seat, source)

    def _probe(
        self,
        seat: Seat,
        code: SectionCode | None,
        reached: Callable[[], Iterable[Breakpoint]],
        source: str = "",
    ) -> SectionCode:
        """Test the breakpoints that are reached where a section begins, and run its code."""

        def test_and_run(machine: Any) -> None:
            for each in reached():
                self.test(each, seat, machine, source)
            if code is not None:
                code(machine)

        return test_and_run


def _reached_by_entering(seat: Seat, breakpoints: Iterable[Breakpoint]) -> Iterable[Breakpoint]:
    return () if seat.arrival().source else breakpoints  # else announced by a probe in an OnExit


def _reached_by_leaving(
    seat: Seat, state: BoundState, breakpoints: Iterable[Breakpoint]
) -> Iterator[Breakpoint]:
    target = seat.current
    for each in breakpoints:
        if each.leaves:
            hits = each.state == state.name and each.target in ("", target.name)
        else:
            hits = each.state == target.name and target is not state
        if hits:
            yield each
