"""Machines as a managed node: loaded, run, suspended with safe values, ended."""

from __future__ import annotations

import threading

import pytest

from llfsm.bridges.ros2.bridging.machine_config import plan_for
from llfsm.bridges.ros2.bridging.managed_machines import ManagedMachines
from llfsm.bridges.ros2.bridging.ros_environment import RosEnvironment
from llfsm.runtime import Actuator, Arrangement, LoadError, Machine, State
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64
from memory_transport import MemoryTransport
from waiting import PATIENCE_S, wait_for

SPEED = Slot("speed", Int64)


class Driver(Machine):
    """Drive until it is told otherwise; safe is 0, and -1 at the end."""

    drive = Actuator(SPEED, at_suspend=Int64(0), at_end=Int64(-1))
    fail = False
    accept = False
    hang = None
    hangs = False

    driving = State()
    over = State()

    @driving.on_entry
    def _(self) -> None:
        self.drive(Int64(1))

    @driving.internal
    def _(self) -> None:
        if self.fail:
            raise ValueError("broken")
        if self.hang is not None:
            self.hangs = True
            self.hang(20)

    driving.to(over, when=lambda self: self.accept)


class Managing:
    """Managed machines whose main thread runs beside the test."""

    def __init__(self, transport, patience_s):
        self.world = RosEnvironment(transport, plan_for(Driver, node="driver"))
        self.loads = 0
        self.refuse = False
        bridge = self.world.bridge
        self.machines = ManagedMachines(bridge.node, bridge.types, self.load, patience_s=patience_s)
        self.thread = threading.Thread(target=self.machines.run)
        self.thread.start()

    def load(self):
        if self.refuse:
            raise LoadError("there is no arm")
        self.loads += 1
        self.driver = Driver()
        environment = LiveEnvironment(self.world.whiteboard)
        return Arrangement([self.driver], environment=environment)

    def __call__(self, label):
        return self.machines.server.change(label)

    @property
    def state(self):
        return self.machines.server.state.label

    @property
    def speed(self):
        message = self.world.whiteboard.get_message(SPEED)
        return None if message is None else message.data

    def drives(self):
        wait_for(lambda: self.speed == 1, "driving")


@pytest.fixture
def patience_s():
    return PATIENCE_S


@pytest.fixture
def managing(memory, reported, patience_s):
    with MemoryTransport(memory, notify=reported) as transport:
        managing = Managing(transport, patience_s)
        yield managing
        managing("shutdown")
        managing.machines.stop()
        managing.thread.join(PATIENCE_S)
        assert not managing.thread.is_alive()
        managing.world.close()


def test_each_transition_does_its_work(managing):
    assert managing("configure")
    assert (managing.loads, managing.speed) == (1, None)  # it does not move yet
    assert managing("activate")
    managing.drives()
    assert managing("deactivate")
    assert managing.speed == 0
    assert managing("activate")
    managing.drives()
    assert managing("deactivate")
    assert managing("cleanup")
    assert managing.speed == -1
    assert managing("configure")
    assert managing.loads == 2
    assert managing("activate")
    managing.drives()
    assert managing("shutdown")
    assert (managing.state, managing.speed) == ("finalized", -1)


def test_it_may_be_cleaned_up_before_it_has_run(managing):
    assert managing("configure")
    assert managing("cleanup")
    assert (managing.state, managing.speed) == ("unconfigured", -1)


def test_machines_that_cannot_be_loaded_leave_it_unconfigured(managing, caplog):
    managing.refuse = True
    assert not managing("configure")
    assert managing.state == "unconfigured"
    assert "not configured: there is no arm" in caplog.text


def test_a_machine_that_fails_leads_through_an_error_to_unconfigured(managing, caplog):
    assert managing("configure")
    assert managing("activate")
    managing.drives()
    managing.driver.fail = True
    wait_for(lambda: managing.state == "unconfigured", "the error's processing")
    assert managing.speed == -1
    assert "ValueError: broken" in caplog.text
    managing.driver.fail = False
    assert managing("configure")


def test_machines_that_have_ended_are_not_activated_again(managing, caplog):
    assert managing("configure")
    assert managing("activate")
    managing.drives()
    managing.driver.accept = True
    wait_for(lambda: managing.speed == -1, "its end")
    assert managing("deactivate")
    assert not managing("activate")
    assert managing.state == "inactive"
    assert "clean up and configure them anew" in caplog.text
    assert managing("cleanup")


@pytest.mark.parametrize("patience_s", [0.05])
def test_a_machine_that_has_no_turn_stays_active(managing, caplog):
    go_on = threading.Event()
    assert managing("configure")
    assert managing("activate")
    managing.drives()
    managing.driver.hang = go_on.wait
    try:
        wait_for(lambda: managing.driver.hangs, "the hang")
        assert not managing("deactivate")
        assert managing.state == "active"
        assert "not deactivated: Driver did not have a turn" in caplog.text
    finally:
        go_on.set()
