"""Explore models of four shapes, each a process of its own, and the same in SPIN.

What is compared is the user time of whole processes: the interpreter's start and all imports are
part of it, as the start of SPIN's verifier is. That was compiled before, with -O2, and its table
has room for the states, of which there are about as many.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from measure import Meter, in_turns
from table import SLOWER, Row

from llfsm.runtime import Machine, Sensor, State, define
from llfsm.runtime.verification import every, explore
from llfsm.whiteboard import Message, Slot

__all__ = ["rows"]


class Press(Message):
    on: bool = False


class Key(Message):
    up: bool = False
    down: bool = False


class Level(Message):
    value: int = 0


class Shape(NamedTuple):
    """Machines for a size, and the same in Promela, in which N is the size."""

    machines: Callable[[int], list[type[Machine]]]
    promela: str
    sizes: tuple[int, int]
    """In a full and in a quick run."""
    bits: int
    """Of the number of states, for SPIN's table."""
    promised: float | None
    """The most times that the exploration takes as long."""


def _machine(name: str, variables: list[str], code: Callable[[Any], None], sensor: Any) -> Any:
    state = State("RUNS")
    state.internal(code)
    state.to(state, when=lambda self: False)
    return define(
        name,
        [state],
        variables=dict.fromkeys(variables, (int, 0)),
        attributes={"sensor": sensor},
    )


def _pressed(number: int) -> Any:
    return Sensor(Slot(f"press{number}", Press), default=Press(), domain=every(Press))


def _repeating(size: int) -> list[type[Machine]]:
    def count(self: Any) -> None:
        if self.sensor.on:
            self.n = (self.n + 1) % size

    return [_machine(f"M{n}", ["n"], count, _pressed(n)) for n in range(4)]


def _counter(size: int) -> list[type[Machine]]:
    def move(self: Any) -> None:
        if self.sensor.up and self.n < size:
            self.n += 1
        elif self.sensor.down and self.n > 0:
            self.n -= 1

    return [_machine("M", ["n"], move, Sensor(Slot("key", Key), default=Key(), domain=every(Key)))]


def _clocks(size: int) -> list[type[Machine]]:
    made = []
    for number in range(4):
        states = [State("A"), State("B")]
        for state, other in (states, states[::-1]):
            state.to(other, when=lambda self: self.sensor.on, after_ms=10 * size)
        attributes = {"sensor": _pressed(number)}
        made.append(define(f"M{number}", states, attributes=attributes))
    return made


def _wide(size: int) -> list[type[Machine]]:
    def keep(self: Any) -> None:
        self.n = self.sensor.value

    domain = [Level(value=value) for value in range(size)]
    return [
        _machine("M", ["n"], keep, Sensor(Slot("level", Level), default=Level(), domain=domain))
    ]


def _in_turns(*choices: str) -> str:
    """Write four processes in one, whose turns follow each other, each with these choices."""
    options = [
        f":: d_step {{ turn == {n} && {choice.replace('$', str(n))}; turn = {(n + 1) % 4} }}\n"
        for n in range(4)
        for choice in choices
    ]
    variables = "byte n0, n1, n2, n3, turn; bit m0, m1, m2, m3; "
    return variables + "active proctype P() {\ndo\n" + "".join(options) + "od }\n"


SHAPES = {
    "repeating": Shape(
        _repeating, _in_turns("true -> n$ = (n$ + 1) % N", "true -> skip"), (40, 8), 24, 1.5
    ),
    "counter": Shape(
        _counter,
        "int n; active proctype P() { do :: n < N -> n++ :: n > 0 -> n-- :: n = n od }",
        (60_000, 500),
        17,
        None,
    ),
    "many clocks": Shape(
        _clocks,
        _in_turns("true -> n$ = (n$ <= N -> n$ + 1 : n$)", "n$ > N -> n$ = 0; m$ = 1 - m$"),
        (12, 3),
        23,
        1.5,
    ),
    "wide domain": Shape(
        _wide,
        "int n; active proctype P() { int v; do :: d_step { v = 0 } "
        "do :: v < N - 1 -> v++ :: break od; atomic { n = v; v = 0 } od }",
        (250, 20),
        18,
        None,
    ),
}


def rows(times: int, folder: Path, *, quick: bool) -> Iterator[Row]:
    """Measure each shape `times` times, in turns with SPIN if it is installed."""
    for name, shape in SHAPES.items():
        size = shape.sizes[quick]
        ours = [sys.executable, __file__, name, str(size)]
        meters = [
            Meter("llfsm", f"explore, {name}", lambda ours=ours: _user_ns(ours)),
            Meter("SPIN", "pan", _spin(shape, size, folder) if shutil.which("spin") else None),
        ]
        yield Row(f"  {name}, user time", in_turns(meters, times), SLOWER, shape.promised)


def _spin(shape: Shape, size: int, folder: Path) -> Callable[[], float]:
    """Compile SPIN's verifier of a model, and return what measures it."""
    (folder / "model.pml").write_text(shape.promela)
    made = ["spin", f"-DN={size}", "-a", "model.pml"]
    pan = folder / f"pan{size}_{shape.bits}"
    compiled = ["cc", "-w", "-O2", "-DSAFETY", "-DNOREDUCE", "pan.c", "-o", str(pan)]
    for command in (made, compiled):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return lambda: _user_ns([str(pan), "-m20000000", f"-w{shape.bits}"])


def _user_ns(command: list[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    subprocess.run(command, check=True, capture_output=True)
    return 1e9 * (resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)


def main() -> None:
    """Explore a shape of a size; print how many states there are."""
    name, size = sys.argv[1:]
    print(explore(SHAPES[name].machines(int(size)), period_ms=10).states)


if __name__ == "__main__":
    main()
