"""Counterexamples of verification: as scripts, run again, as invariants, tables and tests.

A `Witness` lists the choices of the environment, turn by turn. From it comes a script of the
testing kit (`script_of`), and everything else from that: machines that do it again (`replay`), the
table of what they did (`rows_of`, `table_of`), and a test that fails until they are mended
(`regression_of`). In such a test a property is an invariant (`holds`): it gets the same views of
machines that run as it got of explored ones (`LiveSituation`).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from itertools import groupby
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from llfsm.runtime._values import message_text
from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.engine.errors import OptionError
from llfsm.runtime.engine.events import Event, Observer, RoundEnd, Status, Turn
from llfsm.runtime.engine.machine import MachineType
from llfsm.runtime.testing.play import ScriptRun, journal_of
from llfsm.runtime.testing.scripted import Answers, Ask, ScriptedEnvironment, Step, TurnOf, turn_of
from llfsm.runtime.testing.search import KIT, PythonText
from llfsm.runtime.verification.domains import Member, members_of
from llfsm.runtime.verification.environment import ControlState
from llfsm.runtime.verification.inner import inner_seats
from llfsm.runtime.verification.loaded import Found, Loading, absent_seats
from llfsm.runtime.verification.properties import (
    NO_FAILURE,
    Property,
    View,
    Witness,
    defaults_of,
    evaluate,
    on_a_screen,
    some_failed,
)

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.kernel import Factory, OnError
    from llfsm.runtime.engine.schedule import Timetable
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.journal.entries import Entry
    from llfsm.runtime.verification.properties import ChosenTurn
    from llfsm.runtime.verification.space import Space
    from llfsm.whiteboard import Slot

__all__ = ["holds", "replay"]

_NONE_FOUND: Final = Found({}, [])
_HEAD = ("round", "time", "machine", "saw", "did", "posted")
_REQUESTED = {
    "suspend": "suspended",
    "hold": "suspended",
    "resume": "resumed",
    "restart": "restarted",
}


# Scripts


def script_of(witness: Witness, space: Space) -> list[Step]:
    """Make a script of the environment's choices in a `space`."""
    steps = list(_steps(witness, space))
    if witness.at_end:
        steps[-1] = steps[-1]._replace(after=witness.at_end)
    return steps


def between_of(witness: Witness) -> tuple[float, float] | None:
    """Return the `between_ms` of `holds`: the times between which a loop must not go on."""
    if witness.loop is None:
        return None
    return witness.turns[witness.loop].time_ms, witness.turns[-1].time_ms


def _steps(witness: Witness, space: Space) -> Iterator[Step]:
    contents: dict[str, Any] = {}
    now_ms = 0.0
    for _, turns in groupby((*witness.turns, *witness.rest), key=lambda turn: turn.round):
        whole = [*turns]
        first = whole[0]
        before: dict[TurnOf, dict[Slot[Any], Any]] = {}
        asks: dict[TurnOf, list[Ask]] = {}
        elsewhere: dict[TurnOf, Answers] = {}
        timed = space.timetable is not None  # time passes by itself, also before the first turn
        messages = {} if timed else _news(first, contents, space)
        numbers: Counter[str] = Counter()
        for turn in whole:
            numbers[turn.machine] += 1
            which = turn_of(turn.machine, numbers[turn.machine])
            asked: list[Ask] = ["suspend"] if turn.withdraws else []
            if turn.request is not None:
                asked.append(turn.request.value)
            if turn.stop:
                asked.append("stop")
            if asked:
                asks[which] = asked
            if turn.answers:
                elsewhere[which] = turn.answers
            if (timed or turn is not first) and (news := _news(turn, contents, space)):
                before[which] = news
        wait_ms = 0 if timed else first.time_ms - now_ms
        yield Step(wait_ms, messages, before, asks, elsewhere=elsewhere)
        now_ms = first.time_ms


def _news(turn: ChosenTurn, contents: dict[str, Any], space: Space) -> dict[Slot[Any], Any]:
    """Find the messages that the environment changes at a turn, and note them in `contents`.

    One that must not be too old is posted again.
    """
    news = {}
    for name, message in turn.found.items():
        if contents.get(name) is not message or (name in space.aged and message is not None):
            contents[name] = message  # equal ones are one object
            news[space.slots[name]] = message
    return news


# Running a counterexample again, and views of machines that run


def replay(space: Space, witness: Witness, *, observers: Iterable[Observer] = ()) -> list[View]:
    """Run a counterexample on new machines, under a `ManualClock`, with `observers` attached.

    Return a view of the initial state, and one of the state after each turn. Raise
    `ExecutionError` for an error of a machine's code, as `Arrangement.round` does.
    """
    run = ScriptRun(
        space.members,
        unload_accepting=space.unload_accepting,
        on_error=space.on_error,
        timetable=space.timetable,
    )
    views = [view_of(run.scripted, space.found)]
    turn = False

    def look(event: Event) -> None:
        nonlocal turn
        if isinstance(event, Turn | RoundEnd):
            if turn:
                views.append(view_of(run.scripted, space.found))
            turn = isinstance(event, Turn)

    for observer in (look, *observers):
        run.arrangement.attach(observer)
    for _ in run.play(script_of(witness, space)):
        pass
    if run.error is not None:
        raise run.error
    return views


def view_of(environment: ScriptedEnvironment, found: Found = _NONE_FOUND) -> View:
    """Take a view of the state in which machines are now; `found` may not have been there yet."""
    return View(LiveSituation(environment, found))


class LiveSituation:
    """The state of machines that run as it is now, those that have left included."""

    def __init__(self, environment: ScriptedEnvironment, found: Found = _NONE_FOUND):
        loaded = {name: machine._seat for name, machine in environment.machines.items()}
        outermost = [seat for seat in loaded.values() if not seat.inner]
        outermost += absent_seats(outermost[0].control, found.loaded, loaded)
        inner = (each for seat in outermost for each in inner_seats(seat, found.inner))
        seats = {each.name: each for each in (*outermost, *inner)} | loaded
        self.seats: Mapping[str, Seat] = seats
        self.defaults: Mapping[str, Any] = defaults_of(seats.values())
        slots = _slots_of(seats.values())
        self._contents = {name: environment.content(slot) for name, slot in slots.items()}
        self._controls = {name: ControlState.shown(seat) for name, seat in seats.items()}
        self._variables, self._seen = {}, {}
        for name, seat in seats.items():
            attributes, table = vars(seat.machine), type(seat.machine).table
            ports = {*table.sensors, *table.actuators, "stopping"}
            own = {each: value for each, value in attributes.items() if each not in ports}
            self._variables[name] = deepcopy(own)
            self._seen[name] = {sensor: attributes.get(sensor) for sensor in table.sensors}

    def control(self, machine: str) -> ControlState:
        """Return a machine's control state."""
        return self._controls[machine]

    def variables(self, machine: str) -> Mapping[str, Any]:
        """Return a machine's variables."""
        return self._variables[machine]

    def seen(self, machine: str, sensor: str) -> Any:
        """Return the message that a machine's sensor found in its last turn; None if none."""
        return self._seen[machine][sensor]

    def content(self, slot: str) -> Any:
        """Return the message in a slot; None if it is empty."""
        return self._contents[slot]


# A property as an invariant


def holds(
    prop: Property,
    *,
    between_ms: tuple[float, float] | None = None,
    loads: Iterable[Factory | Member] = (),
) -> Holds:
    """Make an invariant for one `llfsm.runtime.testing.play`: that `prop` is not violated.

    Of a `leads_to` without a time of its own, a response due at the first time of `between_ms`, in
    milliseconds, must have come by the second; so must what is to be `always_possible`, if it was
    not there before. What is to hold `eventually_always` must hold between them. All three are
    violated if the machines end without. A `reachable` is violated in no state. `loads` are
    machines that others load, of which the property may speak before they are there.
    """
    members = members_of(given, sort=False) if (given := [*loads]) else ()
    return Holds(prop, between_ms, [Loading.of_member(member) for member in members])


class Holds:
    """The invariant that a property is not violated, for one play: see `holds`."""

    def __init__(
        self, prop: Property, between_ms: tuple[float, float] | None, loaded: list[Loading]
    ):
        self._found = Found({}, loaded)
        self.__qualname__ = prop.name  # which an error names
        self._property = prop
        self._from_ns, self._until_ns = (ms * 1e6 for ms in between_ms or (inf, inf))
        self._earlier: View | None = None
        self._due_ns: dict[int, float] = {}
        """Since when a response is due, by the number of those before it that have come."""

    def begin(self, arrangement: Arrangement) -> bool:
        """Check the initial state."""
        return self(arrangement)

    def __call__(self, arrangement: Arrangement) -> bool:
        """Check the state after a turn: False if it violates the property."""
        environment = arrangement.environment
        if not isinstance(environment, ScriptedEnvironment):
            raise OptionError("holds(...) is an invariant for llfsm.runtime.testing.play")
        prop = self._property
        before, now = self._earlier, view_of(environment, self._found)
        self._earlier = now
        match prop.kind:
            case "never" if prop is NO_FAILURE:
                return not some_failed(now)
            case "never" if prop.functions:
                return not evaluate(prop, prop.functions[0], now)
            case "always":
                return evaluate(prop, prop.functions[0], now)
            case "step" if before is not None:
                return evaluate(prop, prop.functions[0], before, now)
            case "leads_to" | "always_possible":
                answered = self._is_answered(now, environment.clock.now_ns())
                return answered and not (arrangement.finished and self._due_ns)
            case "eventually_always" if not evaluate(prop, prop.functions[0], now):
                in_loop = self._from_ns <= environment.clock.now_ns() <= self._until_ns
                return not (in_loop or arrangement.finished)
        return True

    def _is_answered(self, now: View, now_ns: int) -> bool:
        """Check that no response is late."""
        prop = self._property
        within_ns = inf if prop.within_ms is None else prop.within_ms * 1e6
        if any(now_ns - since > within_ns for since in self._due_ns.values()):
            return False
        trigger, *responses = (
            prop.functions if prop.kind == "leads_to" else (_always, *prop.functions)
        )
        if evaluate(prop, trigger, now):
            self._due_ns.setdefault(0, now_ns)
        for stage, response in enumerate(responses):
            if stage in self._due_ns and evaluate(prop, response, now):
                since = self._due_ns.pop(stage)
                if stage + 1 < len(responses):
                    self._due_ns[stage + 1] = min(since, self._due_ns.get(stage + 1, inf))
        overdue = any(since <= self._from_ns for since in self._due_ns.values())
        return not (overdue and now_ns >= self._until_ns)


def _always(_: View) -> bool:
    return True


# Tables: a row for each turn


class TurnRow(NamedTuple):
    """A turn, as texts: the machine's news, its actions, and its posts."""

    round: int
    time_ns: int
    """When it was due; the clock begins at 0."""
    machine: str
    saw: str
    """New messages in its sensors, and requests to it."""
    did: str
    posted: str
    quiet: bool
    """True if the machine neither saw nor did anything new."""


def rows_of(
    members: Iterable[Member],
    script: Sequence[Step],
    *,
    unload_accepting: bool = True,
    on_error: OnError = "stop",
    timetable: Timetable | None = None,
) -> list[TurnRow]:
    """Do a script, and list its turns."""
    run, entries = journal_of(
        members,
        script,
        unload_accepting=unload_accepting,
        on_error=on_error,
        timetable=timetable,
    )
    slots = _slots_of(machine._seat for machine in run.scripted.machines.values())
    rows: list[TurnRow] = []
    turn: list[Entry] = []
    for entry in entries:
        if entry["event"] in ("Turn", "RoundEnd") and turn:
            rows.append(_row(turn, slots))
            turn = []
        if entry["event"] == "Turn" or turn:
            turn.append(entry)
    if run.error is not None:  # in the last turn, which no other entry has ended
        last, error = _row(turn, slots), run.error
        did = f"{last.did}, fails in {error.step}: {error.__cause__!r}"
        rows.append(last._replace(did=did, quiet=False))
    return rows


def table_of(rows: Sequence[TurnRow], marked: int | None = None, *, full: bool = True) -> str:
    """Write a table of the turns that are not quiet; `marked` is the number of one that is shown.

    Rounds are folded into one line while all machines do what they did in the round before, or
    nothing new. Unless it is to be `full`, rows in the middle are left out that no screen has room
    for.
    """
    cells: list[tuple[str, ...]] = []
    folded: list[int] = []
    before: list[tuple[str, str, str, str]] = []
    numbered = enumerate(rows)
    for number, turns in groupby(numbered, key=lambda each: each[1].round):
        shown = [row for n, row in turns if not row.quiet or n == marked]
        news = [(row.machine, row.saw, row.did, row.posted) for row in shown]
        last = marked is not None and number == rows[marked].round
        if not news or (news == before and not last):
            folded.append(number)
        else:
            cells += _folded(folded)
            folded = []
            cells += _round(shown)
        before = news
    cells += _folded(folded)
    if not full:
        cells = on_a_screen(cells, lambda left: (f"({left} more rows: --full, full=True)",))
    cells.insert(0, _HEAD)
    table = [row for row in cells if len(row) == len(_HEAD)]
    widths = [max(len(row[column]) for row in table) for column in range(len(_HEAD))]
    lines = []
    for texts in cells:
        padded = zip(texts, widths, strict=False)
        lines.append("  ".join(f"{text:{width}}" for text, width in padded).rstrip())
    return "\n".join(lines)


def _round(rows: Sequence[TurnRow]) -> Iterator[tuple[str, ...]]:
    shown_ns = -1
    for number, row in enumerate(rows):
        when = "" if row.time_ns == shown_ns else f"{row.time_ns / 1e6:.10g} ms"
        shown_ns = row.time_ns
        yield "" if number else str(row.round), when, row.machine, row.saw, row.did, row.posted


def _folded(rounds: Sequence[int]) -> Iterator[tuple[str, ...]]:
    if rounds:
        first, last = rounds[0], rounds[-1]
        which = f"round {first}" if first == last else f"rounds {first} to {last}"
        yield (f"{which}: unchanged",)


def _row(turn: Sequence[Entry], slots: Mapping[str, Slot[Any]]) -> TurnRow:
    first = turn[0]
    saw: list[str] = []
    posted: list[str] = []
    did: list[str] = []
    fired, request = "", first["request"]
    for entry in turn[1:]:
        match entry["event"]:
            case "Answered":
                saw.append(_answer(entry["machine"], entry["answer"]))
            case "Asked":
                saw.append(f"{entry['action'].replace('hold', 'suspend')} is asked for")
                request = entry["action"] if entry["action"] in _REQUESTED else request
            case "Sensed":
                saw.append(_message(entry["sensor"], entry, slots))
            case "Posted":
                posted.append(_message(entry["slot"], entry, slots))
            case "Eval" if entry["value"]:
                fired = f"{entry['state']} -> {entry['target']}"
            case "Accepting" if entry["action"] == "unloaded":
                did.append("accepts and leaves")
            case "Failed":
                did.append(f"fails: {entry['error']}")
    new = bool(saw or did or posted or fired or request) or first["previous"] != first["state"]
    if request is not None:
        did.insert(0, f"is {_REQUESTED[request]}")
    if fired or request is None:
        did.insert(0, fired or f"in {first['state']}")
    texts = ", ".join(saw), ", ".join(did), ", ".join(posted)
    return TurnRow(first["round"], first["time_ns"], first["machine"], *texts, quiet=not new)


def _answer(machine: str, answer: str | bool | int | None) -> str:
    """Write what a machine of another process answered: its state, whether it is suspended, ..."""
    match answer:
        case None:
            return f"there is no {machine}"
        case str():
            return f"{machine} is in {answer}"
        case bool():
            return f"{machine} is {'' if answer else 'not '}suspended"
    return f"{machine} was {Status(answer).name.lower()}"


def _slots_of(seats: Iterable[Seat]) -> dict[str, Slot[Any]]:
    """Find the slots that machines use, by their names on the board."""
    slots: dict[str, Slot[Any]] = {}
    for seat in seats:
        table = type(seat.machine).table
        ports: list[Any] = [*table.sensors.values(), *table.actuators.values()]
        slots |= {slot.name: slot for slot in map(seat.slot_of, ports)}
    return slots


def _message(name: str, entry: Entry, slots: Mapping[str, Slot[Any]]) -> str:
    data = entry["message"]
    return message_text(name, None if data is None else slots[entry["slot"]].decoder.decode(data))


# Stories


def story_of(space: Space, witness: Witness, *, full: bool = False) -> Iterator[str]:
    """Tell a counterexample, a line each: the table of its turns, and how it goes on.

    The table has the rows of a screen at most, unless it is to be `full`.
    """
    number = len(witness.turns)
    if not number:
        yield "in the initial state"
    else:
        script = script_of(witness, space)
        rows = rows_of(
            space.members,
            script,
            unload_accepting=space.unload_accepting,
            on_error=space.on_error,
            timetable=space.timetable,
        )
        table = table_of(rows[:number], number - 1, full=full)
        yield f"after {number} turn{'s' if number != 1 else ''}:"
        yield from table.splitlines()
    if witness.loop is not None:
        first = witness.turns[witness.loop].round
        yield f"and so on for ever: all from round {first} on repeats"
    yield from witness.end_lines()


# Tests


def regression_of(space: Space, witness: Witness, where: str, *, folder: Path | None) -> str:
    """Write Python text of a test that fails until the machines are mended.

    It plays the way to a violation of the property `where`, as ``module:name``. Bundles are found
    from `folder`, which is to hold the test; None is the current one.
    """
    text = PythonText()
    module, _, name = where.partition(":")
    name = text.imported(module, name)
    holds = text.imported("llfsm.runtime.counterexamples", "holds")
    play = text.imported(KIT, "play")
    machines = "".join(f"            {_machine(text, each, folder)},\n" for each in space.members)
    steps = "".join(f"            {text.step(step)},\n" for step in script_of(witness, space))
    keep = "        unload_accepting=True,\n" if space.unload_accepting else ""
    keep += "" if space.on_error == "stop" else f"        on_error={space.on_error!r},\n"
    keep += "        to_end=True,\n" if space.suspend else ""
    if space.timetable is not None:
        keep += f"        timetable={_timetable(text, space.timetable)},\n"
    between, given = between_of(witness), name
    if between is not None:
        given += f", between_ms=({between[0]:.15g}, {between[1]:.15g})"
    if space.found.loaded:
        loads = (_machine(text, each.member(), folder) for each in space.found.loaded)
        given += f", loads=[{', '.join(loads)}]"
    call = (
        f"    {play}(\n        [\n{machines}        ],\n        [\n{steps}        ],\n"
        f"        invariant={holds}({given}),\n{keep}    )\n"
    )
    return f"{text.imports()}\n\n\ndef test_{name.replace('.', '_')}() -> None:\n{call}"


def _timetable(text: PythonText, timetable: Timetable) -> str:
    slot = text.imported("llfsm.runtime", "TimeSlot")
    slots = (f"{slot}{(*each,)!r}" for each in timetable.slots)
    return (
        f"{text.imported('llfsm.runtime', 'Timetable')}([{', '.join(slots)}], {timetable.cycle_us})"
    )


def _machine(text: PythonText, member: Member, folder: Path | None) -> str:
    """Write an expression for a machine as `play` takes it."""
    machine = member.machine
    bundle = Path(machine.table.path) if isinstance(machine, MachineType) else Path()
    if bundle.suffix == SUFFIX:
        load = text.imported("llfsm.runtime.bundles", "load_bundle")
        path = text.imported("pathlib", "Path")
        here = "" if folder is None else f"{path}(__file__).parent / "
        beside = os.path.relpath(bundle, folder)
        made = f"{load}({here}{beside!r})" if here else f"{load}({path}({beside!r}))"
    else:
        made = text.named(machine, "machine")
    options = [
        f"{name}={value!r}"
        for name, value in member._asdict().items()
        if name != "machine" and value not in (None, {}, False)
    ]
    if not options:
        return made
    return f"{text.imported('llfsm.runtime.verification', 'Member')}({', '.join([made, *options])})"
