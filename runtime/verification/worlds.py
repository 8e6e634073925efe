"""Worlds for proofs: machines that stand for the robot and its surroundings.

A world is a machine like all others: it reads what the controller posts, and posts what its sensors
read. What it does is not known, but bounded: it is *unpredictable within bounds*. The bounds are in
its code, and what is left open is a sensor (`chance`) that nobody posts to, whose domain has all
that may happen. So a proof includes each way in which the world may behave, and a counterexample
names the way that it took.

Each function here makes the class of a machine of a usual kind. In a run, where nobody posts to
its chance, a world does what is written as the default: a value stays, a button is not pressed, a
link works, a battery lasts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from llfsm.runtime.engine.machine import Machine, define
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.state import State
from llfsm.runtime.verification.errors import DomainError
from llfsm.whiteboard import Message, Slot

M = TypeVar("M", bound=Message)


class Chance(Message, type_name="llfsm/Chance"):
    """What happens, among all that may: a number whose meaning is the world's."""

    number: int = 0


def drift(
    slot: Slot[M], values: Sequence[M], *, start: int = 0, most: int = 1, name: str = "Drift"
) -> type[Machine]:
    """Make a world that posts one of `values`, which are in order, and moves among them.

    In each turn the place among them, `start` at first, changes by at most `most`, in any
    direction, or stays. Raise `DomainError` if there is no such place.
    """
    if not 0 <= start < len(values) or most < 0:
        raise DomainError(
            f"{name}: start is {start} and most {most}: start is a place among the "
            f"{len(values)} values, counted from 0, and most is not below 0"
        )
    messages = tuple(values)

    def move(machine: Any) -> None:
        machine.place = min(max(machine.place + machine.chance.number, 0), len(messages) - 1)
        machine.value(messages[machine.place])

    ports = {"chance": _chance(name, range(-most, most + 1)), "value": Actuator(slot)}
    return _world(name, move, {"place": (int, start)}, ports)


def button(
    slot: Slot[M], released: M, pressed: M, *, least_turns: int = 1, name: str = "Button"
) -> type[Machine]:
    """Make a world that posts `pressed` or `released`, and keeps each for `least_turns` or more."""
    messages = released, pressed

    def press(machine: Any) -> None:
        if machine.kept >= least_turns and machine.chance.number:
            machine.down, machine.kept = not machine.down, 0
        machine.kept = min(machine.kept + 1, least_turns)
        machine.value(messages[machine.down])

    ports = {"chance": _chance(name, range(2)), "value": Actuator(slot)}
    return _world(name, press, {"down": (bool, False), "kept": (int, least_turns)}, ports)


def link(
    source: Slot[M], target: Slot[M], *, most_lost: int | None = None, name: str = "Link"
) -> type[Machine]:
    """Make a world that passes messages of `source` on to `target`, and may lose them.

    It posts once a turn, or loses what is there. At most `most_lost` in a row are lost; with None,
    any number. Read the target by a sensor with `max_age_ms` to notice that the link is down.
    """

    def carry(machine: Any) -> None:
        is_lost = machine.chance.number and (most_lost is None or machine.lost < most_lost)
        if most_lost is not None:
            machine.lost = machine.lost + 1 if is_lost else 0
        if not is_lost and machine.sent is not None:
            machine.received(machine.sent)

    ports = {
        "chance": _chance(name, range(2)), "sent": Sensor(source), "received": Actuator(target),
    }  # fmt: skip
    return _world(name, carry, {"lost": (int, 0)}, ports)


def battery(
    slot: Slot[M],
    levels: Sequence[M],
    *,
    charges: tuple[Slot[Any], Callable[[Any], bool]],
    name: str = "Battery",
) -> type[Machine]:
    """Make a world that posts one of `levels`, from empty to full, and begins full.

    In a turn it stays, or it changes by one level: up if it is charged, which the function of
    `charges` decides by the slot's message (None before the first), and down if not.
    """
    where, is_charged = charges
    messages = tuple(levels)
    if not messages:
        raise DomainError(f"{name}: a battery needs at least one level")

    def use(machine: Any) -> None:
        step = 1 if is_charged(machine.charger) else -1
        level = machine.level + step * machine.chance.number
        machine.level = min(max(level, 0), len(messages) - 1)
        machine.value(messages[machine.level])

    ports = {
        "chance": _chance(name, range(2)), "charger": Sensor(where), "value": Actuator(slot),
    }  # fmt: skip
    return _world(name, use, {"level": (int, len(messages) - 1)}, ports)


def _chance(name: str, numbers: range) -> Sensor[Chance, Chance]:
    slot = Slot(f"chance/{name}", Chance)
    return Sensor(slot, default=Chance(), domain=[Chance(each) for each in numbers])


def _world(
    name: str,
    each_turn: Callable[[Any], None],
    variables: dict[str, tuple[type, Any]],
    ports: dict[str, Any],
) -> type[Machine]:
    """Make a machine that does the same in each turn."""
    goes_on = State("GOES_ON", final=False)
    goes_on.internal(each_turn)
    return define(name, [goes_on], variables=variables, attributes=ports)
