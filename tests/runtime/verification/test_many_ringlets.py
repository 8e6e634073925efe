"""Where each state is a ringlet of its own, the work grows as the states do; memory bounds it."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import Machine, Sensor, State, define
from llfsm.runtime.verification import (
    Space,
    VerificationError,
    _memory,
    _tables,
    every,
    explore,
    never,
)
from llfsm.whiteboard import Message, Slot


class Key(Message):
    up: bool = False
    down: bool = False


def stepper(top: int) -> type[Machine]:
    """Make a machine whose position a key moves up to `top` and down to 0."""
    moves = State("MOVES")

    @moves.internal
    def move(self: Any) -> None:
        if self.key.up and self.pos < top:
            self.pos += 1
        elif self.key.down and self.pos > 0:
            self.pos -= 1

    moves.to(moves, when=lambda self: False)
    key = Sensor(Slot("key", Key), default=Key(), domain=every(Key))
    return define("Stepper", [moves], variables={"pos": (int, 0)}, attributes={"key": key})


def explored(top: int, **how: Any) -> Space:
    return explore(stepper(top), period_ms=10, **how)


@pytest.mark.parametrize("spread", [_tables.SPREAD, False], ids=["as built", "packed tight"])
def test_each_ringlet_of_a_counter_is_run_once(
    monkeypatch: pytest.MonkeyPatch, spread: bool
) -> None:
    """There are 4 keys for each position and for the state before the first turn."""
    monkeypatch.setattr(_tables, "SPREAD", spread)
    space = explored(2000)
    assert (space.states, space.depth, space.ringlets) == (2002, 2000, 4 * 2002)
    assert space.repeated == 1000, "a sample, as most of them are alike"


def test_the_tables_of_a_counter_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    if not _tables.SPREAD:
        pytest.skip("without the extension, fields grow to twice their size")
    made: list[Any] = []
    real = _tables.Packing.__init__

    def count(self: Any, sizes: Any) -> None:
        made.append(sizes)
        real(self, sizes)

    monkeypatch.setattr(_tables.Packing, "__init__", count)
    assert explored(1000).states == 1002
    assert len(made) == 1


def test_all_ringlets_are_run_again_if_there_are_few() -> None:
    space = explored(100)
    assert space.repeated == space.ringlets == 4 * 102


@pytest.mark.parametrize("last", [3000, 4000, 5000])
def test_what_seldom_does_something_else_is_in_the_sample(last: int) -> None:
    """One ringlet of thousands fires a transition, and reads a clock."""
    counts, ends = State("COUNTS"), State("ENDS")

    @counts.internal
    def count(self: Any) -> None:
        self.n += 1

    @counts.on_exit
    def leave(self: Any) -> None:
        self.n = min(0, time.monotonic_ns())

    counts.to(ends, when=lambda self: self.n == last)
    machine = define("M", [counts, ends], variables={"n": (int, 0)})
    with pytest.raises(VerificationError, match="OnExit, calls monotonic_ns"):
        explore(machine, period_ms=10)


def test_many_small_counters_have_an_end() -> None:
    """There is no limit for the values of one machine: 40 to the power of 3 here."""

    class Go(Message):
        which: bool = False

    turns = State("TURNS")

    @turns.internal
    def turn(self: Any) -> None:
        name = "x" if self.go.which else "y"
        setattr(self, name, (getattr(self, name) + 1) % 240)

    turns.to(turns, when=lambda self: False)
    go = Sensor(Slot("go", Go), default=Go(), domain=every(Go))
    variables = {"x": (int, 0), "y": (int, 0)}
    two = define("Two", [turns], variables=variables, attributes={"go": go})
    space = explore(two, period_ms=10)
    assert space.complete
    assert space.states == 240 * 240 + 1


def test_an_exploration_ends_before_memory_does(monkeypatch: pytest.MonkeyPatch) -> None:
    where = "llfsm.runtime.verification._deciding."
    monkeypatch.setattr(where + "LOOK_S", 0.0)
    looks = iter([False] * 300)
    monkeypatch.setattr(where + "is_memory_short", lambda: next(looks, True))
    space = explored(10**9, properties=[never(lambda v: v.Stepper.pos < 0)])
    assert (space.complete, space.cut, space.short_of_memory) == (False, True, True)
    assert space.verdicts[0].holds is None
    [hint] = space.hints()
    assert hint.startswith("Stepper.pos has had ")


UNDER_A_LIMIT = """
import resource
from pathlib import Path
from llfsm.runtime import Machine, State
from llfsm.runtime.verification import explore

class Counter(Machine):
    turns = State()
    n: int = 0

    @turns.internal
    def _(self):
        self.n += 1

    turns.to(turns, when=lambda self: False)

pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() * 4 // 3 + (20 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
space = explore(Counter, period_ms=10)
print(space.complete, space.short_of_memory, space.states > 1000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere, memory is not asked for")
def test_an_exploration_ends_within_a_limit_of_its_process(tmp_path: Path) -> None:
    file = tmp_path / "limited.py"
    file.write_text(UNDER_A_LIMIT)
    assert subprocess.check_output([sys.executable, file], text=True) == "False True True\n"


POSSIBLE_UNDER_A_LIMIT = """
import resource
from pathlib import Path
from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime.verification import always_possible, every, explore
from llfsm.whiteboard import Message, Slot

class Press(Message):
    on: bool = False

def made(name):
    class Turner(Machine):
        press = Sensor(Slot(f"press/{name}", Press), default=Press(), domain=every(Press))
        n: int = 0
        turns = State(final=False)

        @turns.internal
        def _(self):
            if self.press.on:
                self.n = (self.n + 1) % 60

    Turner.__name__ = name
    return Turner

machines = [made(name) for name in "ABC"]
assert explore(machines, period_ms=10).complete
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() * 4 // 3 + (20 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
possible = always_possible(lambda v: v.A.n == 59 and v.B.n == 59)
space = explore(machines, period_ms=10, properties=[possible])
print(space.verdicts[0].holds, space.short_of_memory, space.states > 100_000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere, memory is not asked for")
def test_what_is_possible_is_decided_within_a_limit_or_not_at_all(tmp_path: Path) -> None:
    file = tmp_path / "limited.py"
    file.write_text(POSSIBLE_UNDER_A_LIMIT)
    assert subprocess.check_output([sys.executable, file], text=True) == "None True True\n"


GIB = 1 << 30
UNLIMITED = {
    "/proc/meminfo": "MemTotal: 16000 kB\nMemFree: 1 kB\nMemAvailable: 900 kB\n",
    "/proc/self/statm": f"{2 * GIB // 4096} {GIB // 4096} 1 1 0 1 0\n",
    "/sys/fs/cgroup/memory.max": "max\n",
}


@pytest.mark.parametrize(
    ("files", "limit", "short"),
    [
        ({}, -1, False),
        ({"/proc/meminfo": "MemTotal: 16000 kB\nMemAvailable: 700 kB\n"}, -1, True),
        ({"/proc/meminfo": None}, -1, False),
        ({"/proc/self/statm": None}, -1, False),
        ({"/sys/fs/cgroup/memory.max": f"{2 * GIB}\n"}, -1, False),
        ({"/sys/fs/cgroup/memory.max": f"{GIB}\n"}, -1, True),
        ({"/sys/fs/cgroup/memory/memory.limit_in_bytes": f"{GIB}\n"}, -1, True),
        ({}, 3 * GIB, False),
        ({}, 2 * GIB, True),
    ],
)
def test_memory_is_short_of_a_host_a_group_or_a_process(
    monkeypatch: pytest.MonkeyPatch, files: dict[str, str | None], limit: int, short: bool
) -> None:
    known = UNLIMITED | files

    def read_text(path: Path) -> str:
        text = known.get(str(path))
        if text is None:
            raise FileNotFoundError(path)
        return text

    monkeypatch.setattr(_memory.Path, "read_text", read_text)
    monkeypatch.setattr(_memory.resource, "getpagesize", lambda: 4096)
    monkeypatch.setattr(_memory.resource, "getrlimit", lambda _: (limit, limit))
    monkeypatch.setattr(_memory.resource, "RLIM_INFINITY", -1)
    assert _memory.is_memory_short() is short


def test_memory_that_cannot_be_had_ends_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("llfsm.runtime.verification._deciding.Decisions.goes_on", fail)
    space = explored(9)
    assert (space.complete, space.cut, space.short_of_memory) == (False, True, True)
