"""Stand-ins for Navigation2: each client reaches its end beside its own, whatever goes wrong."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.machines import nav2, stand_ins
from llfsm.machines.calls import ActionSlots, GoalCaller
from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.goals import GoalStatus
from llfsm.runtime.testing import run_until
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.geometry_msgs import Point

PAIRS: list[tuple[type[GoalCaller], type[stand_ins.ActionStandIn], ActionSlots, float]] = [
    (nav2.NavigateTo, stand_ins.NavigateToStandIn, nav2.NAVIGATE_TO_POSE, 0.0),
    (nav2.Spin, stand_ins.SpinStandIn, nav2.SPIN, 1.57),
    (nav2.BackUp, stand_ins.BackUpStandIn, nav2.BACK_UP, 3.0),
    (nav2.DriveOnHeading, stand_ins.DriveOnHeadingStandIn, nav2.DRIVE_ON_HEADING, 3.0),
    (nav2.Dock, stand_ins.DockStandIn, nav2.DOCK_ROBOT, 10.0),
    (nav2.Undock, stand_ins.UndockStandIn, nav2.UNDOCK_ROBOT, 3.0),
]


class Run:
    """A machine whose state runs a client, beside a stand-in, in simulated time."""

    def __init__(self, caller: Any, *others: Any):
        class Mission(Machine):
            CALL = State(runs=caller)
            THERE = State(final=False)
            FAILED = State(final=False)
            AGAIN = State()
            CALL.to(THERE, when_done=True)
            CALL.to(FAILED, when_failed=True)
            FAILED.to(AGAIN, when=lambda self: self.stopping)
            AGAIN.to(CALL)

        self.clock = ManualClock()
        self.board = LocalBoard(now_ns=self.clock.now_ns)
        self.arrangement = Arrangement(
            [Mission, *others], whiteboard=self.board, clock=self.clock, unload_accepting=False
        )

    def until(self, state: str, within_ms: float = 60_000) -> float:
        return run_until(self.arrangement, f"Mission.{state}", within_ms=within_ms)


requests = st.lists(
    st.one_of(
        st.sampled_from(["suspend", "resume", "restart"]), st.integers(1, 400).map(lambda n: n * 10)
    ),
    max_size=8,
)


@given(pair=st.sampled_from(PAIRS), asked=requests)
def test_whatever_is_asked_of_a_stand_in_its_client_comes_to_an_end(
    pair: Any, asked: list[str | int]
) -> None:
    caller, other, slots, _ = pair
    run = Run(caller, other)
    for each in asked:
        if isinstance(each, str):
            getattr(run.arrangement, each)(other.__name__)
        else:
            run.clock.advance(ms=each)
        run.arrangement.round()
    run.arrangement.resume(other.__name__)
    mission: Any = run.arrangement.machine("Mission")
    run_until(
        run.arrangement, lambda _: mission.state_name in ("THERE", "FAILED"), within_ms=90_000
    )
    status = run.board.get_message(slots.status)
    assert status is not None
    if mission.state_name == "FAILED":
        assert "restart" in asked
        assert status.status is GoalStatus.ABORTED
    else:
        assert status.status is GoalStatus.SUCCEEDED


@pytest.mark.parametrize(("caller", "other", "slots", "takes_s"), PAIRS)
def test_a_goal_takes_its_time_and_is_reached(
    caller: Any, other: Any, slots: ActionSlots, takes_s: float
) -> None:
    run = Run(caller, other)
    took_ms = run.until("THERE")
    assert takes_s * 1e3 < took_ms < takes_s * 1e3 + 100
    result, status = run.board.get_message(slots.result), run.board.get_message(slots.status)
    assert result.status is status.status is GoalStatus.SUCCEEDED


@pytest.mark.parametrize(("caller", "other", "slots", "takes_s"), PAIRS)
@pytest.mark.parametrize("wrong", ["fails", "refuses", "silent"])
def test_what_goes_wrong_is_a_failure_of_the_client(
    caller: Any, other: Any, slots: ActionSlots, takes_s: float, wrong: str
) -> None:
    run = Run(lambda _: caller(timeout_s=20.0), other(**{wrong: True}))
    took_ms = run.until("FAILED")
    expected = {"fails": takes_s, "refuses": 0.0, "silent": 20.0}[wrong]
    assert expected * 1e3 <= took_ms < expected * 1e3 + 100


def test_a_robot_is_where_it_went() -> None:
    navigator = stand_ins.NavigateToStandIn(x=1.0, speed=0.5)
    run = Run(lambda _: nav2.NavigateTo(x=4.0, y=4.0), navigator)
    took_ms = run.until("THERE")
    assert 10_000 < took_ms < 10_100  # 5 m
    assert (navigator.x, navigator.y) == (4.0, 4.0)
    pose = run.board.get_message(stand_ins.POSE)
    assert pose is not None
    assert pose.pose.position == Point(4.0, 4.0)


@given(requests=st.lists(st.sampled_from(["suspend", "restart", "resume", "wait"]), max_size=6))
def test_a_goal_that_nobody_waits_for_is_canceled(requests: list[str]) -> None:
    run = Run(nav2.Dock, stand_ins.DockStandIn)
    for request in requests:
        run.arrangement.round()
        if request != "wait":
            getattr(run.arrangement, request)("Mission")
        for _ in range(5):
            run.clock.advance(ms=300)
            run.arrangement.round()
        states = run.arrangement.states()
        if states["DockStandIn"] == "EXECUTING":
            assert states.get("Mission/Dock") == "CALLING"


def test_costmaps_are_cleared_and_again() -> None:
    run = Run(nav2.ClearCostmaps, stand_ins.ClearCostmapsStandIn)
    assert run.until("THERE") < 200
    run.arrangement.restart("Mission")
    run.arrangement.round()
    assert run.until("THERE") < 200
    answer = run.board.get_message(nav2.CLEAR_LOCAL_COSTMAP.answer)
    assert answer is not None
    assert answer.number == 2
