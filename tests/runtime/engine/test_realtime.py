"""Real time is given whole or refused with the right that is missing, and given back at the end."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import subprocess
import sys
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import pytest

from llfsm.runtime import Arrangement, Machine, ManualClock, OptionError, RealtimeError, State
from llfsm.runtime.engine.realtime import collect_if_due, in_real_time


@cache
def permitted() -> bool:
    try:
        with in_real_time(1, None):
            return True
    except RealtimeError:
        return False


needs_the_right = pytest.mark.skipif("not permitted()", reason="no right to run in real time")
CORE = min(os.sched_getaffinity(0))


def conditions() -> tuple[object, ...]:
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return policy, os.sched_getparam(0).sched_priority, os.sched_getaffinity(0), gc.isenabled()


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    before = conditions()
    yield
    assert conditions() == before


class Looks(Machine):
    """Look at the conditions under which it runs."""

    found: tuple[object, ...] = ()
    a, b = State(), State()

    @a.on_entry
    def _(self) -> None:
        self.found = conditions()

    a.to(b)


class Stays(Machine):
    """Never accept."""

    a, b = State(), State()
    a.to(b, when=lambda m: False)


@needs_the_right
def test_a_run_has_its_priority_and_its_core() -> None:
    machine = Looks()
    Arrangement([machine], clock=ManualClock(), realtime=7, cpu=CORE).run()
    assert machine.found == (os.SCHED_FIFO, 7, {CORE}, False)


@needs_the_right
def test_statistics_show_what_was_achieved() -> None:
    """Which a round without `run` does not ask for."""
    arrangement = Arrangement([Looks], clock=ManualClock(), realtime=7, cpu=CORE, timed=True)
    arrangement.round()
    [found] = arrangement.statistics()
    assert (found.realtime, found.cpu) == (None, None)
    arrangement.run()
    [found] = arrangement.statistics()
    assert (found.realtime, found.cpu) == (7, CORE)


def test_statistics_show_no_more_than_that() -> None:
    arrangement = Arrangement([Looks], clock=ManualClock(), realtime=7, cpu=9999, timed=True)
    arrangement.round()
    with pytest.raises(RealtimeError):
        arrangement.run()
    [found] = arrangement.statistics()
    assert (found.realtime, found.cpu) == (None, None)


@needs_the_right
def test_threads_and_processes_of_a_run_are_ordinary() -> None:
    with in_real_time(7, None):
        code = "import os; print(os.sched_getscheduler(0))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert int(done.stdout) == os.SCHED_OTHER


def locked_kb() -> int:
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmLck"))


@needs_the_right
def test_memory_is_locked_meanwhile() -> None:
    before = locked_kb()
    with in_real_time(1, None):
        assert locked_kb() > before + 1000
    assert locked_kb() == before


@needs_the_right
def test_a_run_that_ends_leaves_others_what_they_need() -> None:
    before = locked_kb()
    with ThreadPoolExecutor(1) as other, in_real_time(1, None):
        assert other.submit(Arrangement([Looks], realtime=2).run).result()
        assert not gc.isenabled()
        assert locked_kb() > before + 1000
    assert gc.isenabled()
    assert locked_kb() == before


class Sleeps(ManualClock):
    """Note when its sleeps were to end."""

    def __init__(self) -> None:
        super().__init__()
        self.deadlines_us: list[int] = []

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self.deadlines_us.append(deadline_ns // 1000)
        super().sleep_until_ns(deadline_ns)


@needs_the_right
@pytest.mark.parametrize(
    ("period_us", "realtime", "sleeps_us"),
    [
        (1000, 1, [900, 1000, 1900, 2000]),
        (100, 1, [100, 200]),
        (1000, None, [1000, 2000]),
    ],
)
def test_a_run_is_awake_shortly_before_a_turn(
    period_us: int, realtime: int | None, sleeps_us: list[int]
) -> None:
    """Awake, it looks after what others want, and sleeps again with warm caches."""
    clock = Sleeps()
    Arrangement([Stays], clock=clock, period_us=period_us, realtime=realtime).run(max_rounds=3)
    assert clock.deadlines_us == sleeps_us


class Knot:
    """Garbage that only a collection finds."""

    def __init__(self) -> None:
        self.itself = self


@needs_the_right
def test_garbage_is_collected_when_it_is_due_and_asked_for() -> None:
    with in_real_time(1, None):
        knot = weakref.ref(Knot())
        collect_if_due()
        assert knot() is not None
        more = [Knot() for _ in range(gc.get_threshold()[0] + 1)]
        assert knot() is not None
        collect_if_due()
        assert knot() is None
        assert len(more) > gc.get_threshold()[0]


@needs_the_right
def test_an_error_in_a_machine_gives_all_back() -> None:
    class Fails(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            raise ValueError

    with pytest.raises(Exception, match="ValueError"):
        Arrangement([Fails], clock=ManualClock(), realtime=7, cpu=CORE).run()


def test_a_core_that_is_not_there() -> None:
    cores = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
    with pytest.raises(RealtimeError, match=f"core 9999 cannot be used; this process has: {cores}"):
        Arrangement([Looks], clock=ManualClock(), realtime=7, cpu=9999).run()


WITHOUT = """
import gc, os
from llfsm.runtime.engine.realtime import in_real_time
try:
    with in_real_time(7, min(os.sched_getaffinity(0))):
        print("entered")
except Exception as error:
    print(error)
print(len(os.sched_getaffinity(0)), gc.isenabled())
"""
PR_CAPBSET_DROP = 24
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23


def refusal(capability: int, limit: int, most: int) -> str:
    """Return the error of a process that has neither a capability nor the limit that replaces it.

    It is left as it was.
    """

    def renounce() -> None:
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)
        resource.setrlimit(limit, (most, most))

    command = [sys.executable, "-c", WITHOUT]
    done = subprocess.run(command, capture_output=True, text=True, check=True, preexec_fn=renounce)
    refused, after = done.stdout.splitlines()
    assert "/etc/security/limits.conf" in refused
    assert f"+ep {os.path.realpath(sys.executable)}`" in refused
    assert after == f"{len(os.sched_getaffinity(0))} True"
    return refused


def test_memory_that_cannot_be_locked_is_an_error() -> None:
    assert refusal(CAP_IPC_LOCK, resource.RLIMIT_MEMLOCK, 65536).startswith(
        "memory cannot be locked (Cannot allocate memory; the limit is 64 kB): put "
    )


@needs_the_right
def test_a_priority_that_is_refused_is_an_error() -> None:
    assert refusal(CAP_SYS_NICE, resource.RLIMIT_RTPRIO, 0).startswith(
        "the priority 7 of SCHED_FIFO was refused (Operation not permitted): put "
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"realtime": 0}, "realtime is 0; a priority is from 1 to 99"),
        ({"realtime": 100}, "realtime is 100; a priority is from 1 to 99"),
        ({"realtime": True}, "realtime is True; a priority is from 1 to 99"),
        ({"realtime": "50"}, "realtime is '50'; a priority is from 1 to 99"),
        ({"realtime": 1, "cpu": -1}, "cpu is -1; a core is a number from 0"),
        ({"realtime": 1, "cpu": False}, "cpu is False; a core is a number from 0"),
        ({"cpu": 0}, "cpu is given without realtime"),
    ],
)
def test_impossible_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Arrangement([Looks], **options)
