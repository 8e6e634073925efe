"""Compare the counts of case studies with SPIN's, and random machines with naive and real runs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from agreement import Situation, assert_agreement, situations
from containment import Happenings, assert_contained, happenings
from llfsm.machines.properties.mine import MINE
from llfsm.machines.properties.oven import OVEN
from llfsm.runtime.verification import explore
from real_runs import RealRun, assert_real_run_contained, real_runs
from spin import count

MODELS = Path(__file__).parents[1] / "runtime" / "verification"
PERIODS_MS = (60_000, 1000, 500, 200, 50)


@settings(max_examples=1_000, suppress_health_check=list(HealthCheck), deadline=None)
@given(situations)
def agreement(situation: Situation) -> None:
    """Compare random machines."""
    assert_agreement(situation, most=2_000)


@settings(max_examples=1_000, suppress_health_check=list(HealthCheck), deadline=None)
@given(happenings)
def containment(happened: Happenings) -> None:
    """Run random machines, with requests at every boundary."""
    assert_contained(happened, most=1_000)


@settings(
    max_examples=500,
    suppress_health_check=list(HealthCheck),
    deadline=None,
    phases=[Phase.generate],
)
@given(real_runs)
def on_a_busy_host(run: RealRun) -> None:
    """Run them while other processes want all cores, twice over."""
    assert_real_run_contained(run, most=2_000, rounds=100)


@contextmanager
def busy() -> Iterator[None]:
    """Let other processes want all cores."""
    command = [sys.executable, "-c", "while True: pass"]
    burning = [subprocess.Popen(command) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def main() -> None:
    """Print the counts; fail at the first difference."""
    for name, machines in (("microwave", OVEN), ("mine_pump", MINE)):
        for period_ms in PERIODS_MS:
            space = explore(machines, period_ms=period_ms)
            found = space.states, space.transitions
            with tempfile.TemporaryDirectory() as folder:
                counted = count(MODELS / f"{name}.pml", Path(folder), PERIOD=period_ms)
            print(f"{name} {period_ms} ms: {found[0]:,} states, {found[1]:,} transitions")
            assert found == counted, f"SPIN has {counted}"


@settings(
    max_examples=5_000,
    suppress_health_check=list(HealthCheck),
    deadline=None,
    phases=[Phase.generate],
)
@given(real_runs)
def in_real_time(run: RealRun) -> None:
    """Run random machines by the host's clock, in a world of its own pace."""
    assert_real_run_contained(run, most=2_000, rounds=100)


if __name__ == "__main__":
    agreement()
    print("1,000 arrangements of random machines agree with the naive explorer")
    containment()
    print("1,000 arrangements that ran did what was explored")
    in_real_time()
    print("5,000 arrangements that ran by the host's clock did what was explored")
    with busy():
        on_a_busy_host()
    print("500 that ran on a busy host did, too")
    try:
        main()
    except pytest.skip.Exception as reason:
        print(f"not compared: {reason}")
