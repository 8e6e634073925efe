"""The machines that ship do the same as classes and as bundles, step by step."""

from __future__ import annotations

from pathlib import Path

import pytest

import llfsm.machines
from llfsm.machines import (
    RosBlindTurttleBot,
    RosPingPong,
    RosWallTurttleBot,
    TurtleSuspendResume,
)
from llfsm.machines.common import CMD_VEL
from llfsm.machines.ping_pong import PINPONG
from llfsm.runtime import Arrangement, Machine, ManualClock, Trace
from llfsm.runtime.bundles import load_bundle, read_bundle
from llfsm.runtime.engine.events import Eval
from llfsm.runtime.engine.machine import MachineType
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST, TurtlePositionAnswer

WITHOUT_BUNDLE = {
    *llfsm.machines.behaviours.__all__,
    *llfsm.machines.nav2.__all__,
    *llfsm.machines.arms.__all__,
    *llfsm.machines.stand_ins.__all__,
}
SHIPPED = [
    each
    for each in llfsm.machines.__all__
    if isinstance(vars(llfsm.machines)[each], MachineType) and each not in WITHOUT_BUNDLE
]
FOLDER = Path(llfsm.machines.__file__).parent
EXPRESSIONS = {  # of the guards that the classes have given names
    "after_ms(1000) and answered": (
        "after_ms(1000) and answer.number >= number and not answer.failure"
    ),
    "away_from_walls": "pos_x > 2 and pos_y > 2 and pos_x < 9 and pos_y < 9",
    "target_is_suspended": "is_suspended(target)",
    "target_is_running": "is_running(target)",
}
POSTED = (PINPONG, CMD_VEL, REQUEST)
ANSWERS = {  # tenths of a second: what is answered then
    31: (5.0, 5.0, ""),
    52: (0.0, 0.0, "no pose yet"),
    68: (2.99, 5.0, ""),
    120: (8.0, 9.5, ""),
    160: (3.0, 8.99, ""),
}


def bundle(cls: type[Machine]) -> type[Machine]:
    return load_bundle(FOLDER / f"{cls.__name__}.machine")


def run(machines: list[type[Machine]], stop_at: int | None) -> tuple[Trace, list[object]]:
    """Run for 20 s in tenths; return what happened and what was posted."""
    trace = Trace()
    posted: list[object] = []
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement(machines, whiteboard=board, clock=clock, observers=[trace])
    for tenth in range(200):
        if tenth in ANSWERS and (request := board.get_message(REQUEST)):
            x, y, failure = ANSWERS[tenth]
            board.add_message(ANSWER, TurtlePositionAnswer(request.number, x, y, failure=failure))
        if tenth == stop_at:
            arrangement.stop()
        arrangement.round()
        posted.append([(board[slot].count, board.get_message(slot)) for slot in POSTED])
        if arrangement.finished:
            break
        clock.advance(ms=100)
    arrangement.end()
    return trace, posted


@pytest.mark.parametrize("stop_at", [None, 0, 5, 25, 61, 75])
@pytest.mark.parametrize(
    "machines",
    [[RosPingPong], [RosBlindTurttleBot], [RosWallTurttleBot],
     [RosBlindTurttleBot, TurtleSuspendResume], [RosWallTurttleBot, RosPingPong]],
    ids=lambda machines: "+".join(cls.__name__ for cls in machines),
)  # fmt: skip
def test_class_and_bundle_do_the_same(machines: list[type[Machine]], stop_at: int | None) -> None:
    of_classes, posted = run(machines, stop_at)
    of_bundles, posted_by_bundles = run([bundle(cls) for cls in machines], stop_at)
    expected = [
        event._replace(label=EXPRESSIONS.get(event.label, event.label))
        if isinstance(event, Eval)
        else event
        for event in of_classes
    ]
    assert list(of_bundles) == expected
    assert posted_by_bundles == posted
    states = {event.state for event in of_classes if isinstance(event, Eval)}
    if stop_at is None:
        ended = {"END"} if len(machines) == 1 else set()
        names = {state.name for cls in machines for state in cls.table.states}
        assert states >= names - ended - {"END"}


@pytest.mark.parametrize("name", SHIPPED)
def test_the_table_is_the_same(name: str) -> None:
    cls = getattr(llfsm.machines, name)
    made = bundle(cls)
    assert [state.name for state in made.table.states] == [s.name for s in cls.table.states]
    for state, other in zip(made.table.states, cls.table.states, strict=True):
        assert state.sections.keys() == other.sections.keys()
        assert [(t.target.name, t.after_ms) for t in state.transitions] == [
            (t.target.name, t.after_ms) for t in other.transitions
        ]
    for mine, its in zip(made.table.variables.values(), cls.table.variables.values(), strict=True):
        assert (mine.name, mine.type, mine.default) == (its.name, its.type, its.default)
    for kind in ("sensors", "actuators"):
        ports, others = getattr(made.table, kind), getattr(cls.table, kind)
        assert {n: (p.slot.name, p.slot.type) for n, p in ports.items()} == {
            n: (p.slot.name, p.slot.type) for n, p in others.items()
        }


@pytest.mark.parametrize("name", SHIPPED)
def test_the_layout_places_every_state_and_transition(name: str) -> None:
    found = read_bundle(FOLDER / f"{name}.machine")
    assert found.layout is not None
    assert found.layout.states.keys() == {state.name for state in found.states}
    for state in found.states:
        assert len(found.layout.transitions.get(state.name, ())) == len(state.transitions)
