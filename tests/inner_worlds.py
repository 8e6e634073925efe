"""Random machines, three levels deep, whose states run each other.

Importable from every test: `from inner_worlds import built, worlds`.
"""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.engine.machine import define
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool, Int32

__all__ = ["DOOR", "LOOKING", "OUT", "PARKED", "PLAIN", "built", "worlds"]

DOOR, OUT = Slot("door", Bool), Slot("out", Int32)

# Each machine is data: what it does in a turn, when it leaves its first state, and what that runs.
leads = st.lists(
    st.tuples(
        st.sampled_from(["done", "failed", "count", "door", "time", "looks"]),
        st.sampled_from([0, 10, 25]),
        st.integers(0, 1),
    ),
    max_size=2,
)
levels = st.fixed_dictionaries(
    {
        "leads": leads,
        "second": st.lists(st.sampled_from(["back", "time"]), max_size=1),
        "history": st.booleans(),
        "counts": st.integers(0, 2),
        "fails": st.sampled_from([None, None, 1]),
        "posts": st.booleans(),
    }
)
worlds = st.tuples(
    levels,
    levels,
    levels,
    st.sampled_from(["bottom", "middle", "both", "two", "twice", "either", "unnamed"]),
    st.sampled_from(
        [[], [], ["Top"], ["Top/Middle"], ["Top/Middle/Bottom"], ["Top", "Top/Middle"]]
    ),
)


def made(
    name: str, spec: dict[str, Any], inner: list[Any], resume: Any, clock: Any
) -> type[Machine]:
    """Make the class of a machine whose first state runs `inner`."""
    how = {"resume": resume, "clock": clock}
    first = State("A", runs=inner or None, history=spec["history"], **how)
    second, last = State("B", **how), State("C", **how)
    targets = [second, last]

    def begin(machine: Any) -> None:
        if spec["posts"]:
            machine.out(Int32(data=machine.count))

    def count(machine: Any) -> None:
        if machine.count == spec["fails"]:
            raise ValueError("on purpose")
        machine.count = min(machine.count + 1, spec["counts"])

    first.on_entry(begin)
    first.internal(count)
    for kind, ms, target in spec["leads"]:
        to = targets[target]
        if kind in ("done", "failed"):
            if inner:
                first.to(to, when_done=kind == "done", when_failed=kind == "failed")
        elif kind == "count":
            first.to(to, when=lambda machine: machine.count >= spec["counts"])
        elif kind == "door":
            first.to(to, when=lambda machine: machine.door is not None and machine.door.data)
        elif kind == "time":
            first.to(to, after_ms=ms)
        elif inner:
            first.to(to, when=lambda m: any(each.count for each in m.first.machines))
    for kind in spec["second"]:
        if kind == "back":
            second.to(first, when=lambda machine: machine.count > 0)
        else:
            second.to(first, after_ms=10)
    ports = {"first": first, "door": Sensor(DOOR), "out": Actuator(OUT, at_suspend=Int32(data=-1))}
    return define(name, [first, second, last], variables={"count": (int, 0)}, attributes=ports)


PLAIN: dict[str, Any] = {
    "leads": [], "second": [], "history": False, "counts": 0, "fails": None, "posts": False,
}  # fmt: skip
LOOKING = PLAIN | {"leads": [("door", 0, 0), ("looks", 0, 0)], "history": True, "counts": 2}
PARKED = PLAIN | {"leads": [("door", 0, 0)], "second": ["time"], "counts": 1}


def built(
    world: Any, resume: Any = "again", clock: Any = "runs"
) -> tuple[type[Machine], list[str]]:
    """Make the outermost class of a world, and name the machines that are to be suspended."""
    top, middle, bottom, shape, suspend = world
    lowest = made("Bottom", bottom, [], resume, clock)
    between = made("Middle", middle, [lowest], resume, clock)

    def make(machine: Any) -> Machine:
        return between(count=min(machine.count, 1))

    kinds = {True: between, False: lowest}
    runs: list[Any] = {
        "bottom": [lowest],
        "middle": [between],
        "both": [between, lowest],
        "two": [lowest, lowest],
        "twice": [make],
        "either": [lambda machine: between() if machine.count else lowest()],
        "unnamed": [lambda machine: kinds[machine.count > 0]()],
    }[shape]
    outer = made("Top", top, runs, resume, clock)
    alone = runs[0] is lowest or shape == "unnamed"  # of which the others may never be there
    names = {"Top"} if alone else {"Top", "Top/Middle", "Top/Middle/Bottom"}
    return outer, [name for name in suspend if name in names]
