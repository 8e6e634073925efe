"""A managed node's lifecycle on every transport: what rcl_lifecycle answers and publishes."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.lifecycle import TRANSITIONS, LifecycleServer, LifecycleState, WorkOutcome
from llfsm.bridges.ros2.qos import Qos
from waiting import PATIENCE_S

# As rcl_lifecycle registers them (Jazzy): id, label, start, goal.
RECORDED = [
    (1, "configure", "unconfigured", "configuring"),
    (10, "transition_success", "configuring", "inactive"),
    (11, "transition_failure", "configuring", "unconfigured"),
    (12, "transition_error", "configuring", "errorprocessing"),
    (2, "cleanup", "inactive", "cleaningup"),
    (20, "transition_success", "cleaningup", "unconfigured"),
    (21, "transition_failure", "cleaningup", "inactive"),
    (22, "transition_error", "cleaningup", "errorprocessing"),
    (3, "activate", "inactive", "activating"),
    (30, "transition_success", "activating", "active"),
    (31, "transition_failure", "activating", "inactive"),
    (32, "transition_error", "activating", "errorprocessing"),
    (4, "deactivate", "active", "deactivating"),
    (40, "transition_success", "deactivating", "inactive"),
    (41, "transition_failure", "deactivating", "active"),
    (42, "transition_error", "deactivating", "errorprocessing"),
    (5, "shutdown", "unconfigured", "shuttingdown"),
    (6, "shutdown", "inactive", "shuttingdown"),
    (7, "shutdown", "active", "shuttingdown"),
    (50, "transition_success", "shuttingdown", "finalized"),
    (51, "transition_failure", "shuttingdown", "finalized"),
    (52, "transition_error", "shuttingdown", "errorprocessing"),
    (60, "transition_success", "errorprocessing", "unconfigured"),
    (61, "transition_failure", "errorprocessing", "finalized"),
    (62, "transition_error", "errorprocessing", "finalized"),
]
STATES = {
    "unknown": 0,
    "unconfigured": 1,
    "inactive": 2,
    "active": 3,
    "finalized": 4,
    "configuring": 10,
    "cleaningup": 11,
    "shuttingdown": 12,
    "activating": 13,
    "deactivating": 14,
    "errorprocessing": 15,
}
LIFE = [
    ("unconfigured", "configuring"),
    ("configuring", "inactive"),
    ("inactive", "activating"),
    ("activating", "active"),
    ("active", "deactivating"),
    ("deactivating", "inactive"),
    ("inactive", "cleaningup"),
    ("cleaningup", "unconfigured"),
    ("unconfigured", "shuttingdown"),
    ("shuttingdown", "finalized"),
]
HASHES = {  # published for Jazzy
    "ChangeState": "356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5",
    "GetState": "800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795",
    "GetAvailableStates": "00a07d79d2207d71e81a8cbc1880e5d924cc16d4688ea8e8e06e443dc8f8aa1d",
    "GetAvailableTransitions": "59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc",
}


class Managed:
    """A managed node of which tests say how its work ends, and a client of it."""

    def __init__(self, world, types, seen):
        self.types = types
        self.outcomes = {}
        self.done = []
        self.events = seen()
        self.node = world.open().node("arm", "/left")
        self.server = LifecycleServer(self.node, types, lambda do: do(), self.work)
        self.transport = world.open()
        self.client = self.transport.node("manager")
        event = types.message("lifecycle_msgs/msg/TransitionEvent")
        self.client.subscription("/left/arm/transition_event", event, self.received, Qos(depth=100))
        assert self.transport.wait_graph(
            lambda graph: "/left/arm/get_state" in graph.services(), PATIENCE_S
        )

    def work(self, state):
        self.done.append(state.label)
        outcome = self.outcomes.get(state.label, WorkOutcome.SUCCESS)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def received(self, arrival):
        event = arrival.decode()
        assert (event.timestamp, event.transition.id, event.transition.label) == (0, 0, "")
        self.events((event.start_state.label, event.goal_state.label))

    def call(self, name, type_name, **fields):
        of = self.types.service(f"lifecycle_msgs/srv/{type_name}")
        client = self.client.client(f"/left/arm/{name}", of)
        self.transport.wait_graph(lambda _: client.ready, PATIENCE_S)
        return client.call(of.request.message(**fields), timeout=PATIENCE_S).result()

    def change(self, number=0, label=""):
        transition = self.types.message("lifecycle_msgs/msg/Transition").message(number, label)
        return self.call("change_state", "ChangeState", transition=transition).success

    @property
    def state(self):
        state = self.call("get_state", "GetState").current_state
        assert STATES[state.label] == state.id
        return state.label


@pytest.fixture
def managed(world, types, seen):
    return Managed(world, types, seen)


def test_states_and_transitions_are_those_of_rcl():
    assert [(t.id, t.label, t.start.label, t.goal.label) for t in TRANSITIONS] == RECORDED
    assert {state.label: int(state) for state in LifecycleState} == STATES


@pytest.mark.parametrize("name", HASHES)
def test_the_services_have_the_hashes_of_jazzy(name, types):
    assert types.service(f"lifecycle_msgs/srv/{name}").type_hash == f"RIHS01_{HASHES[name]}"


def test_a_life_from_outside(managed):
    assert managed.state == "unconfigured"
    assert managed.change(1)
    assert managed.change(label="activate")
    assert managed.state == "active"
    assert managed.change(4)
    assert managed.change(2)
    assert managed.change(5)
    assert managed.state == "finalized"
    done = ["configuring", "activating", "deactivating", "cleaningup", "shuttingdown"]
    assert managed.done == done
    assert not managed.change(1)
    managed.events.wait(lambda events: events[-1:] == LIFE[-1:])
    assert managed.events == LIFE[-len(managed.events) :]  # who subscribes late misses the first


def test_what_can_be_asked(managed):
    states = managed.call("get_available_states", "GetAvailableStates").available_states
    assert {state.label: state.id for state in states} == STATES
    ways = managed.call("get_available_transitions", "GetAvailableTransitions")
    assert [way.transition.label for way in ways.available_transitions] == ["configure", "shutdown"]
    graph = managed.call("get_transition_graph", "GetAvailableTransitions").available_transitions
    assert [
        (way.transition.id, way.transition.label, way.start_state.label, way.goal_state.label)
        for way in graph
    ] == RECORDED


@pytest.mark.parametrize(
    ("outcomes", "after", "done"),
    [
        ({"configuring": WorkOutcome.FAILURE}, "unconfigured", ["configuring"]),
        ({"configuring": WorkOutcome.ERROR}, "unconfigured", ["configuring", "errorprocessing"]),
        ({"configuring": ValueError("x")}, "unconfigured", ["configuring", "errorprocessing"]),
        (
            {"configuring": WorkOutcome.ERROR, "errorprocessing": WorkOutcome.FAILURE},
            "finalized",
            ["configuring", "errorprocessing"],
        ),
        (
            {"configuring": WorkOutcome.ERROR, "errorprocessing": ValueError("y")},
            "finalized",
            ["configuring", "errorprocessing"],
        ),
    ],
)
def test_what_follows_work_that_fails(managed, outcomes, after, done):
    managed.outcomes = outcomes
    assert not managed.change(label="configure")
    assert (managed.state, managed.done) == (after, done)


def test_a_transition_that_there_is_not_does_nothing(managed):
    assert not managed.change(3)
    assert not managed.change(label="fly")
    assert (managed.state, managed.done) == ("unconfigured", [])
