"""Calls of actions and services as machines, for a state to run: done, or failed with the reason.

They use the slots that a bridge connects with ROS (docs/how-to/ros2-actions.md), and need no ROS
themselves: a test or a proof answers in the same slots. Nothing blocks. A machine posts its goal or
its request, and its transitions look for the answer in each turn; whoever leaves the state that
runs it, suspends it or kills its process cancels its goal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from msgspec.structs import replace

from llfsm.errors import LlfsmError
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.engine.machine import define
from llfsm.runtime.goals import CancelGoal, GoalStanding
from llfsm.whiteboard import Message, Slot

__all__ = [
    "ActionSlots",
    "CallAction",
    "CallFailedError",
    "CallService",
    "GoalCaller",
    "ServiceSlots",
    "ports_of",
]

Asked = Message | Callable[[Any], Message]


class CallFailedError(LlfsmError):
    """An action or a service was refused, failed, or took too long; the text has the reason."""


class Action(Protocol):
    """The slots of an action, as `llfsm.bridges.ros2.bridging.action_slots` makes them."""

    @property
    def goal(self) -> Slot[Any]: ...

    @property
    def cancel(self) -> Slot[CancelGoal]: ...

    @property
    def status(self) -> Slot[GoalStanding]: ...


class ActionWithResult(Action, Protocol):
    """The slots of an action, of whose result the reason of a failure is read."""

    @property
    def result(self) -> Slot[Any]: ...


class ActionSlots(NamedTuple):
    """The slots of an action, of which the messages are known without ROS."""

    goal: Slot[Any]
    cancel: Slot[CancelGoal]
    status: Slot[GoalStanding]
    feedback: Slot[Any]
    result: Slot[Any]

    @classmethod
    def of(
        cls, name: str, goal: type[Message], feedback: type[Message], result: type[Message]
    ) -> ActionSlots:
        """Make the slots that a bridge makes of an action of that name."""
        return cls(
            Slot(f"{name}/goal", goal),
            Slot(f"{name}/cancel", CancelGoal),
            Slot(f"{name}/status", GoalStanding),
            Slot(f"{name}/feedback", feedback),
            Slot(f"{name}/result", result),
        )


class ServiceSlots(NamedTuple):
    """The slots of a service, of which the messages are known without ROS."""

    request: Slot[Any]
    answer: Slot[Any]

    @classmethod
    def of(cls, name: str, request: type[Message], answer: type[Message]) -> ServiceSlots:
        """Make the slots that a bridge makes of a service of that name."""
        return cls(Slot(f"{name}/request", request), Slot(f"{name}/answer", answer))


CallerPorts = tuple[Actuator[Any], Actuator[CancelGoal], Any, Any, Any]


class Service(Protocol):
    """The slots of a service, as `llfsm.bridges.ros2.bridging.service_slots` makes them."""

    @property
    def request(self) -> Slot[Any]: ...

    @property
    def answer(self) -> Slot[Any]: ...


def CallAction(  # noqa: N802  # makes classes
    action: Action, goal: Asked, timeout_ms: float = 60_000, *, name: str = "CallAction"
) -> type[Machine]:
    """Make a machine that sends a goal, and is done when that has succeeded.

    `goal` is a message of the action's goal slot, or a function of the machine that makes one when
    it begins; the machine numbers it. The machine fails with :class:`CallFailedError` if the goal
    is refused, canceled or aborted, or has not ended within `timeout_ms`. Its goal is canceled
    however the machine ends before that.
    """

    def send(self: Any) -> None:
        self.number = max(self.sent.number, self.standing.number) + 1
        self.send(replace(_made(goal, self), number=self.number))

    def fail(self: Any) -> None:
        standing = self.standing
        why = f": {standing.failure}" if standing.failure else ""
        raise CallFailedError(
            f"{action.goal.name}: the goal was {standing.status.name.lower()}{why}"
        )

    return _caller(
        name,
        (action.goal.name, timeout_ms),
        (send, fail),
        succeeded=lambda self: self.standing.has_succeeded(self.number),
        failed=lambda self: self.standing.has_failed(self.number),
        sent=Sensor(action.goal, default=action.goal.type()),
        standing=Sensor(action.status, default=GoalStanding()),
        send=Actuator(action.goal),
        cancel=Actuator(action.cancel, at_end=CancelGoal()),
    )


def CallService(  # noqa: N802
    service: Service,
    request: Asked,
    timeout_ms: float = 5_000,
    *,
    accept: Callable[[Any], bool] = lambda answer: True,
    name: str = "CallService",
) -> type[Machine]:
    """Make a machine that posts a request to a service, and is done when the answer is there.

    `request` is a message of the service's request slot, or a function of the machine that makes
    one when it begins; the machine numbers it. What the answer says is for the caller to read, from
    the service's answer slot. The machine fails with :class:`CallFailedError` if the bridge reports
    a failure, if `accept` returns False for the answer, or if none came within `timeout_ms`. A
    request that is on its way is not taken back when the machine ends.
    """

    def send(self: Any) -> None:
        self.number = max(self.sent.number, self.answer.number) + 1
        self.send(replace(_made(request, self), number=self.number))

    def is_good(answer: Any) -> bool:
        return not answer.failure and accept(answer)

    def fail(self: Any) -> None:
        why = self.answer.failure or f"the answer is not accepted: {self.answer}"
        raise CallFailedError(f"{service.request.name}: {why}")

    return _caller(
        name,
        (service.request.name, timeout_ms),
        (send, fail),
        succeeded=lambda self: self.answer.number == self.number and is_good(self.answer),
        failed=lambda self: self.answer.number == self.number and not is_good(self.answer),
        sent=Sensor(service.request, default=service.request.type()),
        answer=Sensor(service.answer, default=service.answer.type()),
        send=Actuator(service.request),
    )


class GoalCaller(Machine):
    """Send one goal of an action, and be done when that has succeeded; subclasses say which.

    A subclass has the ports that :func:`ports_of` makes, its parameters as variables, and a
    `goal` that makes the message. It fails with :class:`CallFailedError`, which has the server's
    reason, if the goal is refused, canceled or aborted, or has not ended within `timeout_s`
    seconds. Its goal is canceled however the machine ends before that.
    """

    if TYPE_CHECKING:
        send: ClassVar[Any]
        cancel: ClassVar[Any]
        sent: ClassVar[Any]
        standing: ClassVar[Any]
        result: ClassVar[Any]
    timeout_s: float = 60.0
    number: int = 0

    CALLING = State()
    FAILED = State()
    LATE = State()
    DONE = State()

    def goal(self, number: int) -> Message:
        """Make the goal, which carries that number."""
        raise NotImplementedError  # each action has its own

    def reason(self, result: Any) -> str:
        """Return the server's reason for a failure; "" if it gives none."""
        number = f"error {result.error_code}" if result.error_code else ""
        text: str = result.error_msg
        return f"{text} ({number})" if text and number else text or number

    def name_of_goal(self) -> str:
        """Return the name of the slot, for the errors."""
        return str(type(self).send.slot.name)

    @CALLING.on_entry
    def _(self) -> None:
        self.number = max(self.sent.number, self.standing.number) + 1
        self.send(self.goal(self.number))

    @FAILED.on_entry
    def _(self) -> None:
        standing, result = self.standing, self.result
        why = standing.failure
        if result.number == self.number and not why:
            why = self.reason(result)
        how = f"the goal was {standing.status.name.lower()}"
        raise CallFailedError(f"{self.name_of_goal()}: {how}{why and ': '}{why}")

    @LATE.on_entry
    def _(self) -> None:
        what = f"{self.name_of_goal()}: no answer within {self.timeout_s:g} s"
        raise CallFailedError(what)

    CALLING.to(DONE, when=lambda self: self.standing.has_succeeded(self.number))
    CALLING.to(FAILED, when=lambda self: self.standing.has_failed(self.number))
    CALLING.to(LATE, when=lambda self: self.after(self.timeout_s))


def ports_of(action: ActionWithResult) -> CallerPorts:
    """Make the ports `send`, `cancel`, `sent`, `standing` and `result` of a `GoalCaller`."""
    return (
        Actuator(action.goal),
        Actuator(action.cancel, at_end=CancelGoal()),
        Sensor(action.goal, default=action.goal.type()),
        Sensor(action.status, default=GoalStanding()),
        Sensor(action.result, default=action.result.type()),
    )


def _made(asked: Asked, machine: Any) -> Message:
    return asked if isinstance(asked, Message) else asked(machine)


def _caller(
    name: str,
    call: tuple[str, float],
    actions: tuple[Callable[[Any], None], Callable[[Any], None]],
    succeeded: Callable[[Any], bool],
    failed: Callable[[Any], bool],
    **attributes: Any,
) -> type[Machine]:
    slot, timeout_ms = call
    if not isinstance(timeout_ms, int | float) or isinstance(timeout_ms, bool) or timeout_ms <= 0:
        raise DefinitionError(f"{name}: timeout_ms is {timeout_ms!r}; it must be above 0")
    calling, wrong, late, done = (State(each) for each in ("CALLING", "FAILED", "LATE", "DONE"))
    send, fail = actions
    calling.on_entry(send)
    calling.to(done, when=succeeded, label="succeeded")
    calling.to(wrong, when=failed, label="failed")
    calling.to(late, after_ms=timeout_ms)
    wrong.on_entry(fail)

    @late.on_entry
    def give_up(_: Any) -> None:
        raise CallFailedError(f"{slot}: no answer within {timeout_ms:g} ms")

    path = f"{__name__}:{name}({slot})"
    states = [calling, wrong, late, done]
    return define(name, states, variables={"number": (int, 0)}, attributes=attributes, path=path)
