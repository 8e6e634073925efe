"""The case studies: what is proved of them, their counterexamples, their bundles and diagrams."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

import llfsm.machines
from llfsm.machines.properties import infusion, mine, oven, pressing, turtles
from llfsm.runtime import Arrangement, Machine, ManualClock
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.drawing import arrange, to_svg
from llfsm.runtime.engine.events import Event, Turn
from llfsm.runtime.verification import Member, Property, Space, Witness, explore
from llfsm.whiteboard import Whiteboard

FOLDER = Path(llfsm.machines.__file__).parent
DIAGRAMS = Path(__file__).parents[2] / "docs" / "diagrams"


class Study(NamedTuple):
    machines: tuple[Any, ...]
    properties: list[Property]
    violated: list[Property]
    period_ms: float
    how: dict[str, Any]


def listed(module: Any, *but: Property) -> list[Property]:
    found = [each for each in vars(module).values() if isinstance(each, Property)]
    return [each for each in found if each not in but]


ALWAYS_WRONG = [oven.no_radiation, oven.press_cooks, oven.minute_ends]
OVEN_FAULTS = [*ALWAYS_WRONG, oven.door_stops_motor, oven.off_is_off]
TURTLES = {
    "blind": ([turtles.drives_or_turns, turtles.ends_at_rest], turtles.BLIND, 500, {"stop": True}),
    "held": ([turtles.drives_or_turns, turtles.held_at_rest, turtles.holds, turtles.lets_go],
             turtles.HELD, 500, {}),
    "ping pong": ([turtles.counts], turtles.PING_PONG, 5,
                  {"abstract": {"RosPingPong.count": lambda count: count % 3}}),
    "wall": ([turtles.meets_wall, turtles.leaves_wall, turtles.never_rests_at_wall],
             turtles.WALL, 500, {}),
}  # fmt: skip
STUDIES = {
    "oven": Study(oven.OVEN, listed(oven), OVEN_FAULTS, 10_000, {}),
    "safe oven": Study(oven.SAFE_OVEN, listed(oven), ALWAYS_WRONG, 10_000, {}),
    "mine": Study(mine.MINE, listed(mine), [], 10_000, {}),
    "press": Study(pressing.PRESS, listed(pressing), [pressing.ram_obeys_slot], 100, {}),
    "infusion": Study(infusion.INFUSION, listed(infusion), [], 1000, {}),
} | {
    name: Study(machines, properties, [], period_ms, how)
    for name, (properties, machines, period_ms, how) in TURTLES.items()
}


@pytest.fixture(scope="module", params=STUDIES)
def explored(request: pytest.FixtureRequest) -> tuple[Study, Space]:
    study = STUDIES[request.param]
    return study, explore(
        study.machines, properties=study.properties, period_ms=study.period_ms, **study.how
    )


def test_the_properties_hold_but_those_that_do_not(explored: tuple[Study, Space]) -> None:
    study, space = explored
    wrong = [v.property for v in space.verdicts if v.holds is not True]
    assert sorted(wrong, key=str) == sorted(study.violated, key=str)
    assert not any(verdict.vacuous for verdict in space.verdicts)


def test_every_property_is_of_a_study() -> None:
    tried = [each for study in STUDIES.values() for each in study.properties]
    modules = (oven, mine, pressing, infusion, turtles)
    assert all(each in tried for module in modules for each in listed(module))


class Played:
    """A plain arrangement that is led along a witness, turn by turn; and the states on the way."""

    def __init__(self, machines: Iterable[Any], witness: Witness, *, observed: bool):
        self.clock, self.board = ManualClock(), Whiteboard.local()
        self.turns = list(witness.turns)
        observers = [self.prepare_observed] if observed else []
        self.arrangement = Arrangement(whiteboard=self.board, clock=self.clock, observers=observers)
        for each in machines:
            member = each if isinstance(each, Member) else Member(each)
            self.arrangement.load(member.machine, name=member.name)
        self.seats = list(self.arrangement.roster)
        self.slots = {
            port.slot.name: port.slot
            for table in (type(seat.machine).table for seat in self.seats)
            for port in (*table.sensors.values(), *table.actuators.values())
        }
        self.standings = [Standing(self)]
        for turn in self.turns:
            self.clock.sleep_until_ns(round(turn.time_ms * 1e6))
            if not observed:
                self.prepare(turn.machine)
            seat = next(seat for seat in self.seats if seat.name == turn.machine)
            self.arrangement.kernel.give_turns((seat,))
            self.standings.append(Standing(self))
        assert not self.turns[self.done :]

    done = 0

    def prepare_observed(self, event: Event) -> None:
        if isinstance(event, Turn):  # which comes before the snapshot
            self.prepare(event.machine)

    def prepare(self, machine: str) -> None:
        turn = self.turns[self.done]
        self.done += 1
        assert turn.machine == machine
        for name, message in turn.found.items():
            self.board.add_message(self.slots[name], message)


@pytest.mark.parametrize("observed", [False, True], ids=["unobserved", "observed"])
def test_a_counterexample_plays_on_a_plain_arrangement(
    explored: tuple[Study, Space], observed: bool
) -> None:
    """Its end violates the property; as what the machines are then, not by what was explored."""
    study, space = explored
    for verdict in space.verdicts:
        if verdict.property not in study.violated:
            continue
        assert verdict.witness is not None
        played = Played(study.machines, verdict.witness, observed=observed)
        if verdict.property.kind == "leads_to":
            assert never_answered(verdict.property, verdict.witness, played.standings)
        else:
            assert verdict.property.functions[0](played.standings[-1]) is True


def never_answered(prop: Property, witness: Witness, standings: list[Standing]) -> bool:
    """Return whether what is due at some time does not come, up to the end of a loop."""
    trigger, response = prop.functions
    due = max(n for n, standing in enumerate(standings) if trigger(standing))
    assert witness.loop is not None
    assert standings[witness.loop].kept == standings[-1].kept
    begin = min(due, witness.loop)
    return not any(response(standing) for standing in standings[begin:])


class Standing:
    """What `v` is for a property, taken from the machines and the board themselves."""

    def __init__(self, played: Played):
        self.machines, self.kept = {}, []
        for seat in played.seats:
            table, state = type(seat.machine).table, seat.current.name
            seen = {name: getattr(seat.machine, name) for name in table.sensors}
            variables = {name: getattr(seat.machine, name) for name in table.variables}
            self.machines[seat.name] = {"state": state} | seen | variables
            self.kept.append((state, variables))
        self.found = {slot: played.board.get_message(slot) for slot in played.slots.values()}

    def __getattr__(self, name: str) -> Any:
        return SimpleNamespace(**self.machines[name])

    def __getitem__(self, slot: Any) -> Any:
        return self.found[slot] or slot.type()


def bundle(machine: Any) -> Member:
    member = machine if isinstance(machine, Member) else Member(machine)
    loaded: type[Machine] = load_bundle(FOLDER / f"{member.machine.__name__}.machine")
    return member._replace(machine=loaded)


@pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
def test_the_bundles_have_the_same_states(study: Study) -> None:
    as_classes, as_bundles = (
        explore(machines, period_ms=study.period_ms, **study.how)
        for machines in (study.machines, [bundle(each) for each in study.machines])
    )
    counted = as_classes.states, as_classes.transitions, as_classes.ringlets
    assert (as_bundles.states, as_bundles.transitions, as_bundles.ringlets) == counted


def test_the_diagrams_show_the_machines() -> None:
    """After a change: llfsm draw NAME --sections -o docs/diagrams/NAME.svg."""
    pictures = sorted(DIAGRAMS.glob("*.svg"))
    assert pictures
    for picture in pictures:
        table = getattr(llfsm.machines, picture.stem).table
        assert picture.read_text() == to_svg(arrange(table, title=picture.stem, sections=True)), (
            picture.name
        )
