"""A machine does the same as a class, as a bundle and as a class again, step by step."""

from __future__ import annotations

import importlib.util
import itertools
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings

import llfsm.machines
from llfsm.runtime import Arrangement, Machine, ManualClock, Trace
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    compile_bundle,
    load_bundle,
    read_bundle,
    write_bundle,
)
from llfsm.runtime.converting import class_bundle, class_text
from llfsm.runtime.engine.errors import FsmError
from llfsm.runtime.engine.events import Eval
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.std_msgs import Int32
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, TurtlePositionAnswer
from random_machines import LEFT, MIXED, RIGHT, SHARED, specs
from thoroughness import examples

FOLDER = Path(llfsm.machines.__file__).parent
SHIPPED = ("GridTurtle", "InfusionPump", "MinePump", "OvenTimer", "PressHands", "RosPingPong",
           "RosWallTurttleBot", "TurtleSuspendResume")  # fmt: skip
_numbers = itertools.count()


def imported(text: str, name: str, folder: Path) -> type[Machine]:
    """Return the class `name` of a module's text."""
    number = next(_numbers)
    file = folder / f"converted_{number}.py"
    file.write_text(text)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    sys.modules[file.stem] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made: type[Machine] = getattr(module, name)
    return made


def as_class(bundle: Bundle, folder: Path) -> type[Machine]:
    return imported(class_text(bundle, folder), bundle.name, folder)


def ran(machines: list[type[Machine]], seed: int, rounds: int) -> list[Any]:
    """Return what happens and is posted in random circumstances, but for labels and errors."""
    chance, trace = Random(seed), Trace()
    clock = ManualClock()
    board = LocalBoard(now_ns=clock.now_ns)
    sensors = [each for cls in machines for each in cls.table.sensors.values()]
    slots = {port.slot.name: port.slot for port in sensors}
    for cls in machines:
        slots |= {port.slot.name: port.slot for port in cls.table.actuators.values()}
    found: list[Any] = []
    arrangement = Arrangement(machines, whiteboard=board, clock=clock, observers=[trace])
    try:
        for _ in range(rounds):
            if chance.random() < 0.01:
                arrangement.stop()
            for port in sensors:
                if chance.random() < 0.4 and (message := possible(port, chance)) is not None:
                    board.add_message(port.slot, message)
            arrangement.round()
            found.append([board[slots[name]].get() for name in sorted(slots)])
            clock.advance(ms=chance.choice([5, 100, 1000]))
            if arrangement.finished:
                break
    except FsmError as error:
        found.append(type(error))
    finally:
        arrangement.end()
    events = [e._replace(label="") if isinstance(e, Eval) else e for e in trace]
    return [found, events]


def arrows(cls: type[Machine]) -> list[Any]:
    return [
        (state.final, [(each.target.name, each.after_ms) for each in state.transitions])
        for state in cls.table.states
    ]


def possible(port: Any, chance: Random) -> Any:
    if port.domain:
        return chance.choice(list(port.domain))
    if port.slot is ANSWER:
        return TurtlePositionAnswer(chance.randrange(9), chance.random() * 11, 5.0)
    if port.slot == LEFT:
        return chance.choice(MIXED)
    if port.slot in (RIGHT, SHARED):
        return Int32(data=chance.randrange(3))
    return None


@pytest.mark.parametrize("name", SHIPPED)
def test_a_machine_that_ships_does_the_same(name: str, tmp_path: Path) -> None:
    cls: type[Machine] = getattr(llfsm.machines, name)
    folder = tmp_path / f"{name}.machine"
    write_bundle(class_bundle(cls, tmp_path), folder)
    again = as_class(read_bundle(folder), tmp_path)
    bundle = class_bundle(again, tmp_path)
    shipped = as_class(read_bundle(FOLDER / f"{name}.machine"), tmp_path)
    others = [llfsm.machines.RosBlindTurttleBot] if name == "TurtleSuspendResume" else []
    expected = ran([cls, *others], 3, 60)
    assert len(expected[0]) > 10
    for made in (load_bundle(folder), again, compile_bundle(bundle), shipped):
        assert ran([made, *others], 3, 60) == expected
        assert arrows(made) == arrows(cls)
        assert [*made.table.variables] == [*cls.table.variables]


def statements(what: list[tuple[str, Any]], others: list[str]) -> Iterator[str]:
    for verb, argument in what:
        match verb:
            case "post":
                yield f"post(Int32(data={argument}))"
            case "count":
                yield f"n = (n + 1) % {argument}  # round"
            case "copy":
                yield "text = f'''{n}\n'''\npost(Int32(data=int(text)))"
            case "late":
                yield f"if after_ms({argument}):\n    n = 2"
            case "keep":
                text = "float('nan')" if argument != argument else repr(argument)
                yield f"kept = {text}"
            case "push":
                yield f"pushed.append({argument})\ndel pushed[:-2]"
            case "suspend_all" | "restart_self" | "suspend_self":
                yield f"{verb}()"
            case _ if argument in others:
                yield f"{verb}('{argument}')"
            case _:
                yield "pass"


def condition(what: str, argument: Any, others: list[str]) -> str:
    match what:
        case "after":
            return f"after_ms({argument})"
        case "suspended":
            return f"{argument in others} and is_suspended('{argument}')  # is it?"
        case "initial":
            return f"{argument in others} and state_name_of('{argument}') == 'S0'"
        case "stopping":
            return "stopping"
        case "fails":
            return "(\n    not n\n    or bool(1 / (n - 1))\n)"
        case "n":
            return f"n == {argument}"
    return f"{what} is not None and {what}.data == {argument}"


SECTIONS = {"on_entry": "OnEntry", "on_exit": "OnExit", "internal": "Internal",
            "on_suspend": "OnSuspend", "on_resume": "OnResume"}  # fmt: skip
INCLUDES = Fragment("""\
from llfsm.runtime import Actuator, Sensor
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32
from random_machines import LEFT, RIGHT, SHARED
from typing import Any
""")
VARIABLES = Fragment("""\
left = Sensor(LEFT)
right = Sensor(RIGHT, default=Int32(data=2))
shared = Sensor(SHARED, default=Int32(data=1))
post = Actuator(SHARED, at_suspend=Int32(data=3))
n: int = 0
kept: Any = None
pushed: list[int] = []
""")


def bundles(drawn: Any) -> list[Bundle]:
    """Return machines of a drawn list as bundles."""
    names = ["A", "B", "C"][: len(drawn)]
    made = []
    for name, spec in zip(names, drawn, strict=True):
        states = []
        for number, (codes, leads) in enumerate(spec):
            arrows: list[BundleTransition] = []
            for target, guard, after_ms in leads:
                if any(each.expression is None for each in arrows):
                    break
                parts = [] if after_ms is None else [f"after_ms({after_ms})"]
                if guard is not None:
                    parts.append(condition(*guard, names))
                text = " and ".join(parts)
                arrows.append(
                    BundleTransition(f"S{target % len(spec)}", Fragment(text) if text else None)
                )
            sections = {
                SECTIONS[key]: Fragment("\n".join(statements(what, names)) + "\n")
                for key, what in codes.items()
            }
            final = bool(leads) or number % 2 == 0
            states.append(BundleState(f"S{number}", sections, tuple(arrows), final=final))
        made.append(Bundle(name, tuple(states), includes=INCLUDES, variables=VARIABLES))
    return made


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@settings(max_examples=examples(10), deadline=None)
@given(specs)
def test_random_machines_do_the_same(drawn: Any) -> None:
    as_bundles = bundles(drawn)
    compiled = [compile_bundle(each) for each in as_bundles]
    expected = ran(compiled, 5, 25)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        classes = [as_class(each, folder) for each in as_bundles]
        again = [class_bundle(cls, folder) for cls in classes]
        assert [*map(arrows, classes)] == [*map(arrows, compiled)]
        assert ran(classes, 5, 25) == expected
        assert ran([compile_bundle(each) for each in again], 5, 25) == expected
