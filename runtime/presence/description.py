"""A machine as messages: its definition, and the values of its variables and sensors.

To draw a machine of another process, or of a recording, its table is made of the definition again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, Final

import msgspec

from llfsm.whiteboard.messages.llfsm import (
    DefinedBox,
    DefinedSection,
    DefinedState,
    DefinedTransition,
    MachineDefinition,
    MachineVariables,
    VariableValue,
)

from ..engine.errors import DefinitionError
from ..engine.layout import MachineLayout, StateBox, TransitionPath
from ..engine.source_text import TextOnly, body_of
from ..engine.state import SECTIONS, State, Transition
from ..engine.table import Table
from ..value_text import ValueText

if TYPE_CHECKING:
    from ..engine.machine import Machine

__all__ = ["definition_of", "table_of", "variables_of"]

_TEXT: Final = 200  # characters of a value that is published
_VARIABLES: Final = 12 << 10  # bytes of all of a machine's values: what is more is left out
_MOST: Final = {"states": 250, "transitions": 800, "characters": 1_000_000}  # drawn in seconds


def definition_of(table: Table, *, sections: bool = True) -> MachineDefinition:
    """Return what a machine consists of, with or without its code."""
    return MachineDefinition(
        table.path,
        tuple(_state(state, table.layout, sections) for state in table.states),
        "" if table.suspend is None else table.suspend.name,
    )


def _state(state: State, layout: MachineLayout | None, sections: bool) -> DefinedState:
    drawn = None if layout is None else layout.states.get(state.name)
    paths = () if layout is None else layout.transitions.get(state.name, ())
    return DefinedState(
        state.name,
        tuple(_sections(state)) if sections else (),
        tuple(
            DefinedTransition(t.target.name, t.label, _path(paths[i]) if i < len(paths) else ())
            for i, t in enumerate(state.transitions)
        ),
        None
        if drawn is None
        else DefinedBox(
            float(drawn.x), float(drawn.y), float(drawn.w), float(drawn.h), drawn.expanded
        ),
    )


def _sections(state: State) -> Iterator[DefinedSection]:
    for name in SECTIONS:
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
    _check(definition)
    states = {defined.name: State(defined.name) for defined in definition.states}
    if len(states) < len(definition.states) or not states:
        raise DefinitionError(f"{definition.path}: no states, or two of the same name")
    layout = MachineLayout()
    for defined in definition.states:
        state = states[defined.name]
        state.suspend = defined.name == definition.suspend
        for section in defined.sections:
            if section.name in SECTIONS:
                state.sections[section.name] = TextOnly(section.text)
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
            layout.states[defined.name] = StateBox(*_finite(msgspec.structs.astuple(defined.box)))
        paths = [transition.path for transition in defined.transitions]
        drawn = paths[: next((i for i, path in enumerate(paths) if len(path) != 8), len(paths))]
        layout.transitions[defined.name] = tuple(_drawn(path) for path in drawn)
    table = Table(definition.path, tuple(states.values()), {}, {}, {})
    table.layout = layout if layout.states else None
    return table


def _drawn(path: tuple[float, ...]) -> TransitionPath:
    x0, y0, x1, y1, x2, y2, x3, y3 = _finite(path)
    return TransitionPath((x0, y0), (x1, y1), (x2, y2), (x3, y3))


def _finite(numbers: tuple[Any, ...]) -> tuple[Any, ...]:
    if not all(math.isfinite(number) and abs(number) < 1e6 for number in numbers):
        raise DefinitionError(f"a layout has impossible coordinates: {numbers}")
    return numbers


def _check(definition: MachineDefinition) -> None:
    transitions = [t for state in definition.states for t in state.transitions]
    texts = [section.text for state in definition.states for section in state.sections]
    texts += [text for t in transitions for text in (t.label, t.target)]
    texts += [definition.path, *(state.name for state in definition.states)]
    sizes = {
        "states": len(definition.states),
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
    if value is None or kind is bool or kind is float:
        return value  # type: ignore[no-any-return]
    if kind is int and -(2**63) <= value < 2**63:
        return value  # type: ignore[no-any-return]
    if kind is not str:
        return _texts.text(value)
    text = value if len(value) <= _TEXT else f"{value[: _TEXT - 1]}…"
    try:
        text.encode()
    except UnicodeError:
        return _texts.text(value)
    return text
