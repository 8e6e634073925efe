"""A machine's sensor is overridden until it is released, and everybody sees that it is."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from llfsm.runtime import (
    Arrangement,
    Machine,
    ManualClock,
    Sensor,
    SensorNameError,
    State,
    UnknownMachineError,
)
from llfsm.runtime.debugging import Debugger, leases
from llfsm.runtime.engine.clock import MonotonicClock
from llfsm.runtime.presence.remote import Directory
from llfsm.runtime.testing.scripted import ScriptedEnvironment
from llfsm.whiteboard import BoundSlot, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.llfsm import (
    MachineRequest,
    MachineStatus,
    OverriddenSensor,
    status_slot,
)
from llfsm.whiteboard.messages.std_msgs import Float64, Int32
from waiting import PATIENCE_S, wait_for

from .machines import POSE, Driver, running, stopped_at


class Fresh(Machine):
    """Read a sensor that is blind soon, and one of what came after the start."""

    pose = Sensor(POSE, max_age_ms=10)
    later = Sensor(POSE, since_start=True)

    only = State()
    only.to(only, when=lambda m: False)


def overridden(status: BoundSlot[MachineStatus]) -> list[str]:
    return [each.sensor for each in status.get().overridden]


def arranged(*machines: type[Machine], **how: object) -> Arrangement:
    arrangement = Arrangement(machines, whiteboard=Whiteboard.local(), clock=ManualClock(), **how)
    arrangement.whiteboard.add_message(POSE, Int32(data=3))
    arrangement.round()
    return arrangement


def test_one_machine_reads_the_override_until_it_is_released() -> None:
    arrangement = arranged(Driver, Driver)
    first, second = arrangement.machines

    def seen() -> tuple[int, int]:
        arrangement.round()
        return first.pose.data, second.pose.data

    arrangement.override("Driver", "pose", Int32(data=7))
    assert seen() == (7, 3)
    arrangement.whiteboard.add_message(POSE, Int32(data=4))
    assert seen() == (7, 4)
    arrangement.override("Driver", "pose", None)
    assert seen() == (0, 4), "the default, as if there were no message"
    assert arrangement.roster.find("Driver").overridden == ("pose",)
    assert arrangement.roster.find("Driver.0").overridden == ()
    arrangement.release("Driver", "pose")
    assert seen() == (4, 4)
    assert arrangement.roster.find("Driver").overridden == ()


@pytest.mark.parametrize("clock", [ManualClock, MonotonicClock])
def test_an_override_never_ages(clock: Callable[[], ManualClock]) -> None:
    time = clock()
    arrangement = Arrangement([Fresh], whiteboard=Whiteboard.local(), clock=time)
    machine = arrangement.machine("Fresh")
    arrangement.override("Fresh", "pose", Int32(data=7))
    assert arrangement.roster.find("Fresh").overridden == ("pose", "later"), "both read this slot"
    for _ in range(3):
        time.sleep_until_ns(time.now_ns() + 15_000_000)
        arrangement.round()
        assert machine.pose == machine.later == Int32(data=7)
        assert machine.age_ms("pose") < 10
    arrangement.release("Fresh", "pose")
    arrangement.round()
    assert machine.pose is machine.later is None


def test_a_machine_that_is_loaded_again_is_not_overridden() -> None:
    arrangement = arranged(Driver)
    arrangement.override("Driver", "pose", Int32(data=7))
    arrangement.unload("Driver")
    arrangement.load(Driver)
    arrangement.round()
    assert arrangement.machine("Driver").pose.data == 3
    assert arrangement.roster.find("Driver").overridden == ()


def test_a_breakpoint_looks_at_the_override() -> None:
    arrangement = Arrangement([Driver], whiteboard=Whiteboard.local(), clock=ManualClock())
    with running(arrangement) as debugger:
        debugger.break_at("@pose if data == 7")
        arrangement.override("Driver", "pose", Int32(data=7))
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint @pose if data == 7"


def test_a_script_is_overridden() -> None:
    environment = ScriptedEnvironment()
    arrangement = Arrangement([Driver], environment=environment)
    arrangement.override("Driver", "pose", Int32(data=7))
    arrangement.round()
    assert arrangement.machine("Driver").pose.data == 7


@pytest.mark.parametrize(
    ("machine", "sensor", "message", "error", "problem"),
    [
        ("Drivr", "pose", Int32(), UnknownMachineError, "no machine 'Drivr'"),
        ("Driver", "pos", Int32(), SensorNameError, "no sensor 'pos'; it has: pose; did you mean"),
        ("Driver", "pose", Float64(), WhiteboardError, "Int32"),
        ("Driver", "pose", Int32(data="7"), WhiteboardError, "data"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_overridden_is_refused(
    machine: str, sensor: str, message: Int32, error: type[Exception], problem: str
) -> None:
    arrangement = arranged(Driver)
    with pytest.raises(error, match=problem):
        arrangement.override(machine, sensor, message)
    arrangement.round()
    assert arrangement.machine("Driver").pose.data == 3
    assert arrangement.roster.find("Driver").overridden == ()


def test_other_processes_override_and_see_it(caplog: pytest.LogCaptureFixture) -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Driver], clock=ManualClock(), whiteboard=board)
    with running(arrangement) as debugger:
        slot, remote = board[status_slot("Driver")], Directory(board).find("Driver")
        remote.send(MachineRequest("override", 'pose {"data": 7}'))
        wait_for(lambda: overridden(slot) == ["pose"], "the status says so")
        stopped_at(debugger)
        assert arrangement.machine("Driver").pose.data == 7
        remote.send(MachineRequest("override", 'pose {"dta": 7}'))
        wait_for(lambda: debugger.problem, "a refusal")
        assert "invalid message" in debugger.problem
        assert "override was not obeyed: Driver" in caplog.text
        remote.send(MachineRequest("override", "pose null"))
        wait_for(lambda: not debugger.problem)
        stopped_at(debugger)
        assert arrangement.machine("Driver").pose.data == 0
        remote.send(MachineRequest("release", "pose"))
        wait_for(lambda: slot.get().overridden == ())
        assert Debugger.of(arrangement).problem == ""


@pytest.mark.parametrize("is_paused", [True, False])
def test_an_override_ends_with_its_lease(
    is_paused: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Only one from outside has a lease, which is renewed, and never shortened."""
    time = SimpleNamespace(now=0.0)
    monkeypatch.setattr(leases, "time", SimpleNamespace(monotonic=lambda: time.now))
    board = Whiteboard.local()
    arrangement = Arrangement([Driver, Driver], clock=ManualClock(), whiteboard=board)
    with running(arrangement) as found:
        if not is_paused:
            found.proceed()
        slot, remote = board[status_slot("Driver")], Directory(board).find("Driver")
        other = board[status_slot("Driver.0")]

        def asked(request: MachineRequest) -> None:
            before = slot.get().obeyed
            remote.send(request)
            wait_for(lambda: slot.get().obeyed > before)

        found.override("Driver.0", "pose", "null")
        asked(MachineRequest("override", 'pose {"data": 7}', 10.0))
        wait_for(lambda: slot.get().overridden == (OverriddenSensor("pose", 10.0),))
        time.now = 9.0
        asked(MachineRequest("renew", lease_s=6.0))
        asked(MachineRequest("renew", lease_s=1.0))
        time.now = 14.0
        beats = slot.count
        wait_for(lambda: slot.count > beats + 3, "it was looked at since")
        assert slot.get().overridden == (OverriddenSensor("pose", 1.0),)
        time.now = 15.5
        wait_for(lambda: slot.get().overridden == (), "the release")
        assert "nobody renews the override: Driver: pose" in caplog.text
        assert other.get().overridden == (OverriddenSensor("pose"),)


@pytest.mark.parametrize("sensor", ["pose", "later"])
def test_a_lease_ends_with_its_override_and_ends_no_later_one(
    sensor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both sensors read the same slot; a refused override leaves what was there, and its lease."""
    time = SimpleNamespace(now=0.0)
    monkeypatch.setattr(leases, "time", SimpleNamespace(monotonic=lambda: time.now))
    arrangement = arranged(Fresh)
    found = Debugger(arrangement)
    found.override("Fresh", "pose", '{"data": 7}', lease_s=10.0)
    arrangement.override("Fresh", sensor, Int32(data=8))
    assert found.left_s("Fresh", "pose") is None
    time.now = 11.0
    found.look()
    assert arrangement.roster.find("Fresh").overridden == ("pose", "later")

    found.override("Fresh", sensor, '{"data": 7}', lease_s=10.0)
    with pytest.raises(WhiteboardError):
        arrangement.override("Fresh", "pose", Float64())
    assert found.left_s("Fresh", "pose") == found.left_s("Fresh", "later") == 10.0
    time.now = 22.0
    found.look()
    assert arrangement.roster.find("Fresh").overridden == ()
