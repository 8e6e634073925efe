"""A machine class as its texts, to be looked at: also one of which no bundle can be made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..bundles.model import CLASS, Bundle, BundleState, BundleTransition, Fragment
from ..engine.machine import Machine
from ..engine.ports import Actuator, Sensor
from ..engine.source_text import body_of
from ..engine.table import Table

__all__ = ["class_outline", "declared_lines"]


def class_outline(cls: type[Machine]) -> Bundle:
    """Return the states, transitions and texts of a class, without a layout."""
    table = cls.table
    states = tuple(
        BundleState(
            state.name,
            {key: Fragment(body_of(code) or repr(code)) for key, code in state.sections.items()},
            tuple(
                BundleTransition(
                    each.target.name, None if each.unconditional else Fragment(each.label)
                )
                for each in state.transitions
            ),
        )
        for state in table.states
    )
    suspend = table.suspend.name if table.suspend else None
    declared = "".join(f"{line}\n" for line in declared_lines(table))
    variables = Fragment(declared) if declared else None
    return Bundle(cls.__name__, states, CLASS, suspend, variables=variables)


def declared_lines(table: Table) -> Iterator[str]:
    """Give a line for each port and variable."""
    yield from (_port(name, port) for name, port in table.sensors.items())
    yield from (_port(name, port) for name, port in table.actuators.items())
    for variable in table.variables.values():
        yield f"{variable.name}: {variable.type_text} = {variable.default!r}"


def _port(name: str, port: Sensor[Any, Any] | Actuator[Any]) -> str:
    slot = port.slot
    return f"{name} = {type(port).__name__}({slot.name!r}, {slot.type.__name__})"
