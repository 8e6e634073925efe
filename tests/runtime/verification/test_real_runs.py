"""All that runs by the host's clock do was explored: late, stopped and asked from outside."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from llfsm.runtime import Arrangement, Machine, State
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.verification import explore, never
from real_runs import RealRun, assert_real_run_contained, real_runs


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(
    max_examples=15,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(real_runs)
def test_every_turn_of_a_real_run_was_explored(run: RealRun) -> None:
    assert_real_run_contained(run, most=1_000)


WAITING = [[({"internal": [("count", 3)]}, [(1, ("after", 20), None)]), ({}, [(0, None, None)])]]


def test_a_run_by_another_time_than_the_schedules_is_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = RealRun(WAITING, unload_accepting=True, period_ms=5, on_error="stop", seed=1)
    assert assert_real_run_contained(run, most=1_000, rounds=200)
    monkeypatch.setattr(Environment, "is_due", lambda self, due_ns: None)

    def run_again() -> None:
        for seed in range(20):
            assert_real_run_contained(run._replace(seed=seed), most=1_000, rounds=200)

    with pytest.raises(Exception, match="was not explored"):
        run_again()


class Warn(Machine):
    """The horn has sounded before the arm moves, if it drives for four turns."""

    ticks: int = 0
    drive, move, end = State(), State(), State()

    @drive.internal
    def _(self) -> None:
        self.ticks = min(self.ticks + 1, 9)

    drive.to(move, after_ms=3)
    move.to(end)


def test_a_wait_of_whole_periods_is_as_long_in_runs_as_it_was_proved() -> None:
    early = never(lambda v: v.Warn.state == "move" and v.Warn.ticks < 4)
    late = never(lambda v: v.Warn.state == "move" and v.Warn.ticks > 4)
    assert all(v.holds for v in explore(Warn, period_ms=1, properties=[early, late]).verdicts)
    for _ in range(20):
        machine = Warn()
        arrangement = Arrangement([machine], period_us=1_000)
        arrangement.run()
        assert arrangement.kernel.pacer is not None
        assert machine.ticks == 4 or arrangement.kernel.pacer.skipped


def test_what_a_run_without_a_period_may_do_is_not_proved_by_one() -> None:
    early = never(lambda v: v.Warn.state == "move" and v.Warn.ticks < 4)
    (verdict,) = explore(Warn, properties=[early]).verdicts
    assert verdict.holds is False
