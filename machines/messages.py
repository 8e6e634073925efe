"""Machines that wait for one message, or publish one, for a state to run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llfsm.errors import LlfsmError
from llfsm.runtime import Actuator, DefinitionError, Machine, Sensor, State
from llfsm.runtime.engine.machine import define
from llfsm.whiteboard import Message, Slot

__all__ = ["NoMessageError", "PublishOnce", "WaitForMessage"]


class NoMessageError(LlfsmError):
    """No message came in time for which a `WaitForMessage` has waited; this is its failure."""


def WaitForMessage(  # noqa: N802  # makes classes
    slot: Slot[Any],
    timeout_ms: float | None = None,
    *,
    when: Callable[[Any], bool] = lambda message: True,
    name: str = "WaitForMessage",
) -> type[Machine]:
    """Make a machine that is done once a message has come for which `when` returns True.

    Messages from before it began do not count. After `timeout_ms`, if that is given, it fails with
    :class:`NoMessageError`.
    """
    if timeout_ms is not None and not timeout_ms > 0:
        raise DefinitionError(f"{name}: timeout_ms is {timeout_ms!r}; it must be above 0")

    def is_awaited(message: Any) -> bool:
        return message is not None and when(message)

    waiting, late, done = (State(each) for each in ("WAITING", "LATE", "DONE"))
    waiting.to(done, when=lambda self: is_awaited(self.message), label="came")
    states = [waiting, done]
    if timeout_ms is not None:
        waiting.to(late, after_ms=timeout_ms)
        states.insert(1, late)

    @late.on_entry
    def give_up(_: Any) -> None:
        raise NoMessageError(f"{slot.name}: no message within {timeout_ms:g} ms")

    attributes = {"message": Sensor(slot, since_start=True)}
    return define(name, states, attributes=attributes, path=f"{__name__}:{name}({slot.name})")


def PublishOnce(  # noqa: N802  # makes classes
    slot: Slot[Any],
    message: Message | Callable[[Any], Message],
    *,
    name: str = "PublishOnce",
) -> type[Machine]:
    """Make a machine that posts a message, or what a function of it makes, and is done."""
    post_, done = State("POST"), State("DONE")

    @post_.on_entry
    def post(self: Any) -> None:
        self.post(message if isinstance(message, Message) else message(self))

    post_.to(done)
    path = f"{__name__}:{name}({slot.name})"
    return define(name, [post_, done], attributes={"post": Actuator(slot)}, path=path)
