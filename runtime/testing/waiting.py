"""Run an arrangement under a manual clock until a condition holds, and compare states.

Nothing waits: between two rounds the clock is moved to when the next one is due, as `Arrangement`
would sleep until then. Rounds that can change nothing are counted, not run, as `Arrangement` does.
So an hour of a machine takes as long as what happens in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from difflib import SequenceMatcher
from operator import itemgetter
from typing import Any, TypeAlias

from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.clock import ManualClock
from llfsm.runtime.engine.errors import OptionError, UnknownMachineError
from llfsm.runtime.engine.events import Event, RoundBegin, Section
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.waiting import Stillness
from llfsm.runtime.testing.errors import NotReachedError, ScriptError, StatesError
from llfsm.whiteboard import Board, Slot
from llfsm.whiteboard.errors import wrong_type


def states_of(trace: Iterable[Event], machine: str) -> list[str]:
    """List the states that `machine` entered, in order, its suspend state included.

    Raise `UnknownMachineError` if the trace has no section of that machine.
    """
    return [section.state for section in _entries(trace, machine)]


def assert_states(trace: Iterable[Event], machine: str, expected: Iterable[str]) -> None:
    """Raise `StatesError`, with the difference, unless `machine` entered exactly these states."""
    entries, wanted = _entries(trace, machine), list(expected)
    found = [section.state for section in entries]
    if found == wanted:
        return
    lines = [f"{machine} did not enter the states expected (- missing, + unexpected):"]
    for kind, a, b, c, d in SequenceMatcher(None, wanted, found, autojunk=False).get_opcodes():
        mark = " " if kind == "equal" else "+"
        if kind != "equal":
            lines += [f"  - {state}" for state in wanted[a:b]]
        lines += [
            f"  {mark} {section.state}  at {section.time_ns / 1e6:g} ms" for section in entries[c:d]
        ]
    raise StatesError("\n".join(lines))


def _entries(trace: Iterable[Event], machine: str) -> list[Section]:
    sections = [event for event in trace if isinstance(event, Section)]
    known = dict.fromkeys(section.machine for section in sections)
    if machine not in known:
        raise UnknownMachineError(machine, known, "traced")
    return [s for s in sections if s.machine == machine and s.section == "OnEntry"]


def current_states(arrangement: Arrangement, machines: Iterable[Machine]) -> str:
    """Write a line for each machine, after a line break: its state, and for how long."""
    now_ns = arrangement.clock.now_ns()
    return _lines([_current_state(machine, now_ns) for machine in machines])


def _explained_states(arrangement: Arrangement, machines: Iterable[Machine]) -> str:
    """Do as `current_states`, and write below each machine why it is in its state."""
    now_ns = arrangement.clock.now_ns()
    lines: list[str] = []
    for machine in machines:
        lines += (_current_state(machine, now_ns), *_causes(machine, now_ns))
    return _lines(lines)


def _lines(lines: list[str]) -> str:
    return "".join(f"\n  {line}" for line in lines or ["no machines"])


def _causes(machine: Machine, now_ns: int) -> Iterator[str]:
    from llfsm.runtime.debugging.causes import why  # here, as few tests fail

    seat = machine._seat
    status = seat.standing()
    is_there = seat.taken and seat.current is seat.previous and not status.suspended
    if is_there and status.entered_ns is not None:
        words = {True: "true", False: "false", None: "?"}
        for each in why(machine, status.state, now_ns - status.entered_ns):
            yield f"  -> {each.target}  {words[each.value]}: {each.seen}"


def _current_state(machine: Machine, now_ns: int) -> str:
    seat = machine._seat
    status = seat.standing()
    text = f"{status.machine}: {status.state}"
    if status.entered_ns is None or seat.current is not seat.previous:
        text += ", not yet entered"
    else:
        text += f" for {(now_ns - status.entered_ns) / 1e6:g} ms"
    if status.suspended:
        text += ", suspended"
    if status.request is not None:
        text += f", to {status.request}"
    return text if seat.taken else f"{text}, unloaded"


def name_of(function: object, default: str) -> str:
    """Name a function or class as in source text; `default` is for a lambda."""
    name = str(getattr(function, "__qualname__", default)).rpartition("<locals>.")[2]
    return default if "<" in name else name


Condition: TypeAlias = str | Callable[[Arrangement], bool]
"""``"Machine.STATE"``, or a function of the arrangement."""

# The next round follows at once after one in which a transition fires. It takes some time all the
# same: machines that fire for ever would otherwise keep the clock from moving.
_ROUND_NS = 10_000


def run_until(arrangement: Arrangement, condition: Condition, *, within_ms: float) -> float:
    """Run rounds until `condition` holds after one; return how many milliseconds that took.

    The clock, a `ManualClock`, moves as in `Arrangement.run`: by the period, or by the idle time
    after a round in which no transition fired, else by 10 µs. Raise `NotReachedError` when
    `within_ms` milliseconds have passed or the arrangement is over, and `OptionError` for another
    clock or a condition that no loaded machine can meet.
    """
    __tracebackhide__ = True  # for pytest: what failed is in the test
    clock = arrangement.clock
    if not isinstance(clock, ManualClock):
        raise OptionError(
            f"run_until moves the clock, but this is a {type(clock).__name__}: "
            f"give the Arrangement clock=ManualClock()"
        )
    is_state = isinstance(condition, str)  # else it may be one of the time, or of each round
    holds = _in_state(arrangement, condition) if isinstance(condition, str) else condition
    what = condition if isinstance(condition, str) else name_of(condition, "the condition")
    machines = list(arrangement.machines)
    stillness = Stillness(arrangement.kernel, type(arrangement).analysis)
    begin_ns, begin_round = clock.now_ns(), arrangement.rounds
    end_ns = begin_ns + round(within_ms * 1e6)
    while True:
        round_ns = clock.now_ns()
        fired = _due_ns(arrangement) <= end_ns and arrangement.round()
        machines += [machine for machine in arrangement.machines if machine not in machines]
        if holds(arrangement):
            return (clock.now_ns() - begin_ns) / 1e6
        over = arrangement.reason is not None or arrangement.finished
        passed_ns = clock.now_ns() - begin_ns
        if over or begin_ns + passed_ns >= end_ns:
            why = f"over after {passed_ns / 1e6:g} ms" if over else f"not in {within_ms:g} ms"
            rounds = arrangement.rounds - begin_round
            states = _explained_states(arrangement, machines)
            raise NotReachedError(f"waited for {what}: {why}, {rounds} rounds{states}")
        next_ns = next_round_ns(arrangement, round_ns, fired)
        if is_state and not fired:
            next_ns = _passed_over(arrangement, stillness, next_ns, end_ns)
        clock.sleep_until_ns(min(next_ns, end_ns))


def _passed_over(arrangement: Arrangement, stillness: Stillness, next_ns: int, end_ns: int) -> int:
    """Count the rounds that can change nothing, up to `end_ns`; return when the one after is."""
    pacer = arrangement.kernel.pacer
    cycle_ns = _pause_ns(arrangement) if pacer is None else pacer.cycle_ns
    until_ns = min(stillness.until_ns(), end_ns - cycle_ns + 1)
    rounds = -(-(until_ns - next_ns) // cycle_ns)
    if not stillness.is_since_last_round() or rounds <= 0:
        return next_ns
    stillness.pass_over(rounds)
    if pacer is not None:
        pacer.pass_over(rounds)
    return next_ns + rounds * cycle_ns


def next_round_ns(arrangement: Arrangement, round_ns: int, fired: bool) -> int:
    """Return the time of the round after one at `round_ns`, in which a transition `fired`."""
    pause_ns = _ROUND_NS if fired else _pause_ns(arrangement)
    return _due_ns(arrangement) or round_ns + pause_ns


def _pause_ns(arrangement: Arrangement) -> int:
    """Return the time between two rounds in which no transition fires."""
    return max(arrangement.pace.idle_us * 1_000, _ROUND_NS)


def _due_ns(arrangement: Arrangement) -> int:
    """Return when the next round is due; 0 if it begins when it is asked for."""
    pacer = arrangement.kernel.pacer
    return 0 if pacer is None else pacer.next_ns or 0


def _in_state(arrangement: Arrangement, place: str) -> Callable[[Arrangement], bool]:
    """Make the condition that a machine is in a state; it may be loaded later."""
    name, dot, state = place.rpartition(".")
    if not dot:
        raise OptionError(f'{place!r} names no state: it must be "Machine.STATE"')

    def find(now: Arrangement) -> Machine | None:
        return next((machine for machine in now.machines if machine.name == name), None)

    machine = find(arrangement)
    if machine is not None:
        states = [*machine._seat.states, machine._seat.suspension.name]
        if state not in states:
            names = ", ".join(dict.fromkeys(states))
            raise OptionError(f"{place!r}: {name} has no state {state!r}; it has: {names}")

    def holds(now: Arrangement) -> bool:
        machine = find(now)
        return machine is not None and machine.state_name == state

    return holds


class SensorScript:
    """An observer that posts each (time in ms, slot, message) of a script at its time.

    Times count from the first round that it observes. A message is posted before the first ringlet
    of the first round at its time or later, so a script works with `run`, `round` and `run_until`.
    Raise `ScriptError` for a time before 0, and `SlotTypeError` for a message of another type than
    its slot's.
    """

    def __init__(self, board: Board, script: Iterable[tuple[float, Slot[Any], Any]]):
        self._board = board
        self._left = sorted(script, key=itemgetter(0))
        self._begin_ns: int | None = None
        for time_ms, slot, message in self._left:
            if not time_ms >= 0:
                raise ScriptError(f"{slot.name} at {time_ms} ms: a script begins at 0 ms")
            if type(message) is not slot.type:
                raise wrong_type(slot.name, slot.type, message)

    @property
    def finished(self) -> bool:
        """True once every message was posted."""
        return not self._left

    def __call__(self, event: Event) -> None:
        """Post the messages that are due when a round begins."""
        if not isinstance(event, RoundBegin):
            return
        if self._begin_ns is None:
            self._begin_ns = event.time_ns
        passed_ns = event.time_ns - self._begin_ns
        while self._left and self._left[0][0] * 1e6 <= passed_ns:
            _, slot, message = self._left.pop(0)
            self._board.add_message(slot, message)
