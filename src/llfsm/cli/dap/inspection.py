"""Paused machines as an editor shows them: a stack, variables, expressions, and lines of files.

A machine has no stack of its own between two turns. The one shown is made up from what it is about
to do, or has failed in: a section, in a state, of a machine, in the state of another one that runs
it, and so on outwards to the arrangement. A line of a file stands for the narrowest place of a
machine that is defined there: a transition, a section, a state.
"""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec.structs import asdict

from llfsm.cli.dap.framing import Message
from llfsm.cli.debug.session import Session
from llfsm.cli.requests import cause_value
from llfsm.errors import LlfsmError
from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.engine.source_text import parse_file, syntax_of
from llfsm.runtime.engine.state import State, location_of
from llfsm.runtime.expressions.evaluation import Evaluator, parsed
from llfsm.runtime.value_text import ValueText
from llfsm.whiteboard import Message as BoardMessage

if TYPE_CHECKING:
    from llfsm.runtime.debugging.causes import Cause
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.seat import Seat


_ALL: Final = 4  # the frame of the arrangement; those before it are of the innermost machine
_OUTER: Final = 5  # the first of machines around that, two for each
_END: Final = 2**31


class SourceRange(NamedTuple):
    """Lines of a file, from 1, and the breakpoint that stands for them."""

    file: str
    first: int
    last: int
    breakpoint: str


def breakpoints_at(
    machines: Mapping[str, type[Machine]], file: str, line: int
) -> list[SourceRange]:
    """Find the narrowest places on a line, of each machine that is defined there."""
    found = []
    for name, cls in machines.items():
        here = [
            place
            for place in _places(name, cls)
            if place.first <= line <= place.last
            and os.path.realpath(place.file) == os.path.realpath(file)
        ]
        narrowest = min((place.last - place.first for place in here), default=0)
        found += [place for place in here if place.last - place.first == narrowest]
    return [*dict.fromkeys(found)]


def state_at(cls: type[Machine], state: str) -> tuple[str, int] | None:
    """Return file and line of a state; of its first code if it is declared in no class body."""
    declared = _declared(cls).get(state)
    if declared is not None:
        return declared.file, declared.first
    for each in cls.table.states:
        if each.name == state:
            return next(filter(None, map(location_of, each.sections.values())), None)
    return None


def section_at(cls: type[Machine], state: str, section: str) -> tuple[str, int] | None:
    """Return file and line of a section; None if the state has none."""
    for each in cls.table.states:
        if each.name == state and section in each.sections:
            return location_of(each.sections[section])
    return None


def _places(name: str, cls: type[Machine]) -> Iterator[SourceRange]:
    declared = _declared(cls)
    for state in cls.table.states:
        if state.name in declared:
            yield declared[state.name]._replace(breakpoint=f"{name}:{state.name}")
        for section, code in state.sections.items():
            leaves = "->" if section == "OnExit" else ""
            yield from _lines(cls, code, f"{name}:{state.name}{leaves}")
        for transition in state.transitions:
            text = f"{name}:{state.name}->{transition.target.name}"
            yield SourceRange(*transition.location, transition.location[1], text)
            if transition.guard is not None:
                yield from _lines(cls, transition.guard, text)


def _lines(cls: type[Machine], code: Callable[..., Any], breakpoint: str) -> Iterator[SourceRange]:
    where, node = location_of(code), syntax_of(code)
    if where is None:
        return
    last = getattr(node, "end_lineno", None) or where[1]
    if SUFFIX in cls.table.path:  # each text of a bundle is a file of its own
        where, last = (where[0], 1), _END
    yield SourceRange(*where, last, breakpoint)


def _declared(cls: type[Machine]) -> dict[str, SourceRange]:
    """Find the lines that assign the states of a class, by name, also in the classes above."""
    found: dict[str, SourceRange] = {}
    for each in cls.__mro__:
        file = getattr(sys.modules.get(each.__module__), "__file__", None) or ""
        parsed = parse_file(file)
        for body in ast.walk(parsed[1]) if parsed else ():
            if isinstance(body, ast.ClassDef) and body.name == each.__name__:
                for node in body.body:
                    for name in _assigned(node):
                        state = vars(each).get(name)
                        if isinstance(state, State):
                            last = node.end_lineno or node.lineno
                            found.setdefault(state.name, SourceRange(file, node.lineno, last, ""))
    return found


def _assigned(node: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement assigns."""
    if isinstance(node, ast.Assign | ast.AnnAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        for each in targets:
            yield from (part.id for part in ast.walk(each) if isinstance(part, ast.Name))


_texts: Final = ValueText(1000)


class Inspection:
    """Answer requests about one pause, at a machine's breakpoint or before a machine's turn."""

    def __init__(self, session: Session):
        self._session = session
        self._referred: list[Callable[[], Iterable[tuple[str, object]]]] = []

    def stack_trace(self, arguments: Message) -> Message:
        """Return the frames of the stack, innermost first."""
        session = self._session
        name, arrangement = session.debugger.machine, session.arrangement
        frames: list[Message] = []
        if name:
            cls, state = type(arrangement.machine(name)), arrangement.state_name_of(name)
            enters = arrangement.roster.find(name).arrival().entered_ns is None
            section = "OnEntry" if enters else "transitions"
            here, fired = state_at(cls, state), session.debugger.fired
            error = fired.error if fired is not None and fired.machine == name else None
            code = section_at(cls, state, section) or here
            if error is not None and error.filename is not None and error.line is not None:
                section, state = error.step, error.state
                here, code = state_at(cls, state), (error.filename, error.line)
            frames = [
                _frame(1, f"{section} of {state}", code),
                _frame(2, f"state {state}", here),
                _frame(3, f"machine {name} ({_home(cls)})", here),
            ]
        for number, outer in enumerate(self._outer):
            cls = type(outer.machine)
            runs = (outer.remembered if outer.suspended else outer.current).name
            here = state_at(cls, runs)
            frames.append(_frame(_OUTER + 2 * number, f"state {runs}", here))
            title = f"machine {outer.name} ({_home(cls)})"
            frames.append(_frame(_OUTER + 2 * number + 1, title, here))
        frames.append(_frame(_ALL, f"arrangement, round {arrangement.rounds}", None))
        first = int(arguments.get("startFrame") or 0)
        end = first + int(arguments.get("levels") or len(frames))
        return {"stackFrames": frames[first:end], "totalFrames": len(frames)}

    @property
    def _outer(self) -> list[Seat]:
        """The machines whose states run that of the stack, from the inside outwards."""
        found: list[Seat] = []
        name = self._session.debugger.machine
        seat = self._session.arrangement.roster.find(name) if name else None
        while seat is not None and seat.inner and seat.caller is not None:
            seat = seat.caller
            found.append(seat)
        return found

    def _machine_of(self, arguments: Message) -> str:
        """Return the name of the machine of a frame, by default that of the innermost one."""
        frame = int(arguments.get("frameId") or 1)
        outer = self._outer
        number = (frame - _OUTER) // 2
        return outer[number].name if 0 <= number < len(outer) else self._session.machine

    def scopes(self, arguments: Message) -> Message:
        """Return the scopes of a frame: its machine's, or one for each machine of all."""
        session = self._session
        arrangement, machine = session.arrangement, self._machine_of(arguments)
        if arguments.get("frameId") == _ALL:
            standings = filter(None, arrangement.roster.standings())
            scopes = [
                self._scope(f"{each.machine} in {each.state}", _all_of, each.machine)
                for each in standings
            ]
        else:
            scopes = [
                self._scope("Sensors", _sensors_of, machine),
                self._scope("Variables", _variables_of, machine),
                self._scope("Transitions", self._transitions_of, machine),
            ]
            before = session.debugger.sight(machine, session.debugger.now_ns).before
            if before is not None:
                how = "was left" if before.target else "failed"
                name = f"Transitions of {before.source}, as it {how}"
                scopes.append(self._scope(name, lambda _: _texts_of(before.causes), before.machine))
        return {"scopes": scopes}

    def _scope(
        self,
        name: str,
        shown: Callable[[Machine], Iterable[tuple[str, object]]],
        machine: str,
    ) -> Message:
        found = self._session.arrangement.machine(machine)
        reference = self._refer(lambda: shown(found))
        return {"name": name, "variablesReference": reference, "expensive": False}

    def _transitions_of(self, machine: Machine) -> Iterator[tuple[str, object]]:
        return _texts_of(self._session.debugger.why(machine.name))

    def _refer(self, shown: Callable[[], Iterable[tuple[str, object]]]) -> int:
        self._referred.append(shown)
        return len(self._referred)

    def variables(self, arguments: Message) -> Message:
        """Return the variables in a scope, or the parts of a value."""
        number = int(arguments.get("variablesReference", 0))
        if not 0 < number <= len(self._referred):
            raise LlfsmError("these variables are of an earlier pause")
        return {"variables": [self._variable(*each) for each in self._referred[number - 1]()]}

    def _variable(self, name: str, value: object) -> Message:
        reference = 0
        if isinstance(value, BoardMessage):
            fields = asdict(value)
            reference = self._refer(fields.items)
        elif isinstance(value, Mapping | tuple | list) and value:
            pairs = value.items() if isinstance(value, Mapping) else enumerate(value)
            named = [(str(key), each) for key, each in pairs]
            reference = self._refer(lambda: named)
        kind = "" if isinstance(value, _Text) else type(value).__name__
        return {
            "name": name,
            "value": _texts.text(value),
            "type": kind,
            "variablesReference": reference,
        }

    def evaluate(self, arguments: Message) -> Message:
        """Return the value of an expression over the machine of a frame, without any effect."""
        text, session = str(arguments.get("expression", "")), self._session
        arrangement, name = session.arrangement, self._machine_of(arguments)
        entered_ns = arrangement.roster.find(name).arrival().entered_ns
        elapsed_ns = None if entered_ns is None else session.debugger.now_ns - entered_ns
        state = arrangement.state_name_of(name)
        try:
            evaluator = Evaluator(arrangement.machine(name), elapsed_ns, state=state)
            found = evaluator.value(parsed(text))
        except Exception as error:  # of a text that is no expression, or what operators raise
            raise LlfsmError(f"{text}: {error or type(error).__name__}") from error
        shown = self._variable(text, found)
        return {"result": shown.pop("value"), **shown}


class _Text(str):
    """A text that is shown as it is."""

    __slots__ = ()
    __repr__ = str.__str__


def _texts_of(causes: Iterable[Cause]) -> Iterator[tuple[str, object]]:
    for each in causes:
        value = cause_value(each.value, each.seen)
        shown = each.seen if each.value is None and value == "-" else f"{value}: {each.seen}"
        yield f"{each.label} -> {each.target}", _Text(shown)


def _all_of(machine: Machine) -> Iterator[tuple[str, object]]:
    yield from _sensors_of(machine)
    yield from _variables_of(machine)


def _sensors_of(machine: Machine) -> Iterator[tuple[str, object]]:
    return ((name, getattr(machine, name)) for name in type(machine).table.sensors)


def _variables_of(machine: Machine) -> Iterator[tuple[str, object]]:
    return ((name, getattr(machine, name, None)) for name in type(machine).table.variables)


def _home(cls: type[Machine]) -> str:
    """Return where a machine is defined: its module, or its bundle's folder."""
    path = cls.table.path
    return path.rpartition(":")[0] or Path(path).name


def _frame(number: int, name: str, where: tuple[str, int] | None) -> Message:
    frame: Message = {"id": number, "name": name, "line": 0, "column": 0}
    if where is None:
        return {**frame, "presentationHint": "label"}
    file, line = where
    source = {"name": Path(file).name, "path": file}
    return {**frame, "line": line, "column": 1, "source": source}
