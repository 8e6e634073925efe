"""A managed node's states and transitions, as rcl_lifecycle has them, and their services.

A request leads to a transition state, in which the node does the work; how that ended leads on to
a primary state. After an error it is first in ``errorprocessing``. :data:`TRANSITIONS` is the whole
machine: the server takes rows of it, and lists them to clients.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from enum import Enum, IntEnum
from typing import Any, NamedTuple

from llfsm.bridges.ros2.calls import answering, through
from llfsm.bridges.ros2.threads import Put
from llfsm.bridges.ros2.transport import Node, ServiceRequest
from llfsm.bridges.ros2.types import TypeLibrary

_LOG = logging.getLogger("llfsm.bridges.ros2")


class LifecycleState(IntEnum):
    """The states, numbered as in lifecycle_msgs/msg/State."""

    UNKNOWN = 0
    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    FINALIZED = 4
    CONFIGURING = 10
    CLEANINGUP = 11
    SHUTTINGDOWN = 12
    ACTIVATING = 13
    DEACTIVATING = 14
    ERRORPROCESSING = 15

    @property
    def label(self) -> str:
        """The state's name in ROS."""
        return self.name.lower()


class WorkOutcome(Enum):
    """The end of a transition state's work; the value is the label of the transition out."""

    SUCCESS = "transition_success"
    FAILURE = "transition_failure"
    ERROR = "transition_error"


class LifecycleTransition(NamedTuple):
    """A transition, numbered as in lifecycle_msgs/msg/Transition."""

    id: int
    label: str
    start: LifecycleState
    goal: LifecycleState


def _ends(
    first: int, start: LifecycleState, success: LifecycleState, failure: LifecycleState
) -> tuple[LifecycleTransition, ...]:
    """Make the three transitions out of a transition state."""
    error = LifecycleState.ERRORPROCESSING
    goals = (success, failure, failure if start is error else error)
    return tuple(
        LifecycleTransition(first + number, outcome.value, start, goal)
        for number, (outcome, goal) in enumerate(zip(WorkOutcome, goals, strict=True))
    )


def _all() -> tuple[LifecycleTransition, ...]:
    state, of = LifecycleState, LifecycleTransition
    return (
        of(1, "configure", state.UNCONFIGURED, state.CONFIGURING),
        *_ends(10, state.CONFIGURING, state.INACTIVE, state.UNCONFIGURED),
        of(2, "cleanup", state.INACTIVE, state.CLEANINGUP),
        *_ends(20, state.CLEANINGUP, state.UNCONFIGURED, state.INACTIVE),
        of(3, "activate", state.INACTIVE, state.ACTIVATING),
        *_ends(30, state.ACTIVATING, state.ACTIVE, state.INACTIVE),
        of(4, "deactivate", state.ACTIVE, state.DEACTIVATING),
        *_ends(40, state.DEACTIVATING, state.INACTIVE, state.ACTIVE),
        of(5, "shutdown", state.UNCONFIGURED, state.SHUTTINGDOWN),
        of(6, "shutdown", state.INACTIVE, state.SHUTTINGDOWN),
        of(7, "shutdown", state.ACTIVE, state.SHUTTINGDOWN),
        *_ends(50, state.SHUTTINGDOWN, state.FINALIZED, state.FINALIZED),
        *_ends(60, state.ERRORPROCESSING, state.UNCONFIGURED, state.FINALIZED),
    )


TRANSITIONS = _all()
"""All transitions, in rcl_lifecycle's order."""


class LifecycleServer:
    """Serves a node's lifecycle, and publishes its transitions on ``~/transition_event``.

    ``work`` does the work of a transition state and returns how it ended; what it raises counts as
    an error. It is called through ``put``, one transition after the other.
    """

    def __init__(
        self,
        node: Node,
        types: TypeLibrary,
        put: Put,
        work: Callable[[LifecycleState], WorkOutcome],
    ) -> None:
        self.state = LifecycleState.UNCONFIGURED
        self._work = work
        self._changing = threading.RLock()
        self._state = types.message("lifecycle_msgs/msg/State").message
        self._transition = types.message("lifecycle_msgs/msg/Transition").message
        self._description = types.message("lifecycle_msgs/msg/TransitionDescription").message
        event = types.message("lifecycle_msgs/msg/TransitionEvent")
        self._event = event.message
        self._publish = node.publisher("~/transition_event", event).publish
        change = types.service("lifecycle_msgs/srv/ChangeState")
        self._changed = change.response.message
        node.server("~/change_state", change, through(put, self._change))
        transitions = "GetAvailableTransitions"
        for name, type_name, answer in (
            ("get_state", "GetState", self._current),
            ("get_available_states", "GetAvailableStates", self._states),
            ("get_available_transitions", transitions, self._available),
            ("get_transition_graph", transitions, self._graph),
        ):
            of = types.service(f"lifecycle_msgs/srv/{type_name}")
            node.server(f"~/{name}", of, answering(of, answer))

    def change(
        self, wanted: int | str, work: Callable[[LifecycleState], WorkOutcome] | None = None
    ) -> bool:
        """Make a transition of the current state, by id or label; return whether it succeeded.

        ``work`` is done instead of the server's own, but for the work of errors.
        """
        with self._changing:
            way = next((each for each in self._ways() if wanted in (each.id, each.label)), None)
            if way is None:
                _LOG.warning(
                    "No transition matching %s found for current state %s", wanted, self.state.label
                )
                return False
            self._take(way)
            outcome = self._end(work or self._work)
            if outcome is WorkOutcome.ERROR:
                _LOG.warning("Error occurred while doing error handling.")
                self._end(self._work)
            return outcome is WorkOutcome.SUCCESS

    def _end(self, work: Callable[[LifecycleState], WorkOutcome]) -> WorkOutcome:
        """Do the work of a transition state, and leave it."""
        try:
            outcome = work(self.state)
        except Exception:
            _LOG.exception("Caught exception in callback for transition %d", self.state)
            outcome = WorkOutcome.ERROR
        self._take(next(each for each in self._ways() if each.label == outcome.value))
        return outcome

    def _take(self, way: LifecycleTransition) -> None:
        self.state = way.goal
        # As rcl_lifecycle publishes it: without a time, and without the transition.
        self._publish(self._event(start_state=self._of(way.start), goal_state=self._of(way.goal)))

    def _ways(self) -> list[LifecycleTransition]:
        return [each for each in TRANSITIONS if each.start is self.state]

    def _change(self, request: ServiceRequest[Any, Any]) -> None:
        wanted = request.message.transition
        request.answer(self._changed(success=self.change(wanted.label or wanted.id)))

    def _current(self, _: Any) -> dict[str, Any]:
        return {"current_state": self._of(self.state)}

    def _states(self, _: Any) -> dict[str, Any]:
        return {"available_states": tuple(map(self._of, LifecycleState))}

    def _available(self, _: Any) -> dict[str, Any]:
        return self._described(self._ways())

    def _graph(self, _: Any) -> dict[str, Any]:
        return self._described(TRANSITIONS)

    def _described(self, ways: Iterable[LifecycleTransition]) -> dict[str, Any]:
        described = (
            self._description(
                self._transition(way.id, way.label), self._of(way.start), self._of(way.goal)
            )
            for way in ways
        )
        return {"available_transitions": tuple(described)}

    def _of(self, state: LifecycleState) -> Any:
        return self._state(int(state), state.label)
