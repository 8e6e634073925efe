"""Explore the microwave cold, in a process of its own, with SPIN beside it; or two ovens."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import shapes
from measure import Meter, Side, in_turns
from table import ALONE_MIB, ALONE_S, BYTES, RATE, SLOWER, Row

from llfsm.machines.properties.oven import OVEN
from llfsm.runtime.verification import Member, explore

__all__ = ["rows"]

MODEL = Path(__file__).parents[1] / "runtime" / "verification" / "microwave.pml"
PERIOD_MS = 200


def rows(times: int, most: int | None) -> Iterator[Row]:
    """Measure `times` explorations of a microwave, and one of two ovens, up to `most` states.

    SPIN runs compiled code of a model that was written for it: what stands beside it are orders of
    magnitude.
    """
    call = f"explore(OVEN, period_ms={PERIOD_MS})"
    found = [_explored(1, PERIOD_MS) for _ in range(times)]
    rates = [each["states"] / each["seconds"] for each in found]
    yield Row("states a second, explored cold", [Side("llfsm", call, rates)], RATE, 200_000)
    sizes = [each["bytes"] / each["states"] for each in found]
    yield Row("  memory a state", [Side("llfsm", call, sizes)], BYTES, 200)
    with tempfile.TemporaryDirectory() as folder:
        meters = [
            Meter("llfsm", f"{call}, from the start of Python", _whole),
            Meter(
                "SPIN",
                "pan",
                _spin(Path(folder), round(found[0]["states"])) if shutil.which("spin") else None,
            ),
        ]
        yield Row("  the same states in SPIN", in_turns(meters, times), SLOWER, None)
        yield from shapes.rows(times, Path(folder), quick=most is not None)
    two = _explored(2, 60_000, most)
    call = f"explore(two ovens), {two['states']:,.0f} states"
    yield Row("  two ovens, 8 machines", [Side("llfsm", call, [1e9 * two["seconds"]])], ALONE_S, 15)
    yield Row("  and their memory", [Side("llfsm", call, [two["bytes"]])], ALONE_MIB, 1024)


def _explored(ovens: int, period_ms: int, most: int | None = None) -> dict[str, float]:
    command = [sys.executable, __file__, *map(str, (ovens, period_ms, most or 10**9))]
    figures: dict[str, float] = json.loads(subprocess.check_output(command))
    return figures


def _whole() -> float:
    begin_ns = time.perf_counter_ns()
    _explored(1, PERIOD_MS)
    return time.perf_counter_ns() - begin_ns


def _spin(folder: Path, states: int) -> Callable[[], float]:
    """Return what runs the verifier that SPIN makes of the model, compiled with optimization.

    Its stack and its hash table are as large as the model needs. It must count the same states.
    """
    made = ["spin", f"-DPERIOD={PERIOD_MS}", "-o2", "-a", str(MODEL)]
    compiled = ["cc", "-w", "-O2", "-DSAFETY", "-DNOREDUCE", "pan.c", "-o", "pan"]
    for command in (made, compiled):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)

    def sample() -> float:
        begin_ns = time.perf_counter_ns()
        printed = subprocess.check_output(["./pan", "-m500000", "-w20"], cwd=folder, text=True)
        taken_ns = time.perf_counter_ns() - begin_ns
        assert f"{states} states, stored" in printed, printed
        assert "too small" not in printed, printed
        return taken_ns

    return sample


def another_oven() -> list[Member]:
    """Return the machines of a second microwave, which shares nothing with the first."""
    return [
        Member(
            machine,
            name=f"Other{machine.__name__}",
            slots={name: f"other_{name}" for name in machine.table.slots},
        )
        for machine in OVEN
    ]


def resident() -> int:
    """Return the most bytes that this process has had in memory, since its program began."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


def main() -> None:
    """Explore that many ovens, at that period, up to that many states; print figures as JSON."""
    ovens, period_ms, most = map(int, sys.argv[1:])
    machines = [*OVEN, *(another_oven() if ovens == 2 else [])]
    before, begin = resident(), time.perf_counter()
    space = explore(machines, period_ms=period_ms, max_states=most)
    seconds = time.perf_counter() - begin
    figures = {"states": space.states, "seconds": seconds, "bytes": resident() - before}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
