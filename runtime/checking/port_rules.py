"""The rules for ports: what is wrong with the values that they are declared with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ..engine.domain import messages_of_domain
from ..engine.errors import DefinitionError
from ..engine.ports import Actuator, Sensor
from ..engine.table import Table
from .subject import Finding, Subject

__all__ = ["of_ports"]

_SAFE_VALUES = ("at_end", "at_suspend", "at_failure")


def of_ports(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find defaults, safe values and domains that are not messages of their slot's type."""
    ports: list[tuple[str, Sensor[Any, Any] | Actuator[Any], Sequence[str]]] = [
        *((name, each, ("default",)) for name, each in table.sensors.items()),
        *((name, each, _SAFE_VALUES) for name, each in table.actuators.items()),
    ]
    slots: dict[str, tuple[str, Any]] = {}
    for name, port, options in ports:
        declared = subject.declared.get(name)
        where = subject.states[0].where if declared is None else declared.where
        first, slot = slots.setdefault(port.slot.name, (name, port.slot))
        if slot.fingerprint != port.slot.fingerprint:
            types = f"{slot.type.__name__} and {port.slot.type.__name__}"
            text = f"{first!r} and {name!r} use slot {slot.name!r} for messages of {types}"
            yield Finding(*where, "error", text)
        for option in options:
            value = getattr(port, option)
            if value is not None and not isinstance(value, port.slot.type):
                wanted = port.slot.type.__name__
                given = f"the class {value.__name__}" if isinstance(value, type) else repr(value)
                text = f"{name!r}: {option} is a {wanted}, as {wanted}(), not {given}"
                yield Finding(*where, "error", text)
                break
        if isinstance(port, Sensor) and port.domain is not None:
            try:
                messages_of_domain(port.slot, port.domain)
            except DefinitionError as error:
                yield Finding(*where, "error", f"{name!r}: {error}")
