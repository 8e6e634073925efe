"""A debugger: it pauses an arrangement at a boundary between two turns, and steps it.

It is an observer that does not return from the event with which a turn begins. Meanwhile the
arrangement publishes its machines and obeys requests, as while it sleeps. An arrangement that runs
freely has no such observer, and its turns cost what they cost without a debugger.

What is to happen is a `Goal`, set from any thread; the machines' thread compares each turn with it.
A breakpoint that is hit, too, only sets a goal: the pause comes before the next turn, when what the
breakpoint is about has happened as a whole.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Literal, NamedTuple, Self, TypeAlias, get_args

from llfsm.runtime.debugging.breakpoints import Breakpoint, Probes, check_breakpoints
from llfsm.runtime.debugging.causes import Fired, LastTurns, Sight, raised_at, sight_of
from llfsm.runtime.debugging.leases import Lease
from llfsm.runtime.engine.errors import ArrangementEndedError, NotPausedError, OptionError
from llfsm.runtime.engine.events import Eval, Event, Turn
from llfsm.runtime.log import logger
from llfsm.whiteboard.message_text import parse_message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from llfsm.runtime.debugging.causes import Cause
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.environment import Read
    from llfsm.runtime.engine.errors import ExecutionError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.seat import Seat


Step: TypeAlias = Literal["turn", "round", "transition", "leave"]
"""Until when: the next turn, the next round, a transition has fired, a machine left its state."""

_LOOK_S = 0.02  # between two looks for requests while paused


class Goal(NamedTuple):
    """The end of a run: why machines are paused then, and before which turn."""

    why: str
    is_reached: Callable[[Turn], bool] = lambda _: True


class Debugger:
    """Pause and step the machines of `arrangement`, from any thread.

    A pause that has a lease ends when it is over, unless `pause` renews it. A stop ends every
    pause. With `on_pause="safe"` each machine posts its `at_suspend` values when a pause begins;
    what it had posted before, it posts only where its code does so again. `lease_s` is for pauses
    at breakpoints.
    """

    def __init__(
        self,
        arrangement: Arrangement,
        *,
        on_pause: Literal["keep", "safe"] = "keep",
        lease_s: float | None = None,
    ) -> None:
        if on_pause not in ("keep", "safe"):
            raise OptionError(f'on_pause is {on_pause!r}; it must be "keep" or "safe"')
        self.arrangement = arrangement
        """The machines."""
        self._on_pause = on_pause
        self._default_lease_s = lease_s
        self.leases: dict[str, float] = {}
        """How long pauses at breakpoints last, by their texts, where it is not as usual."""
        self._goal: Goal | None = None
        self._lease_s: float | None = None  # how long the pause that is to come lasts
        self._lease: Lease | None = None  # that of this pause
        self._overrides: dict[tuple[str, str], Lease] = {}  # by machine and slot
        self._arrived = ""  # the machine whose transition has fired since the step began
        self._go = threading.Event()
        self._is_paused = threading.Event()
        self._probes = Probes((), self._hit)
        self.pauses = 0
        """How many pauses have begun: no two have the same number."""
        self.problem = ""
        """Why what another process has requested last was refused; "" if it was not."""
        self.turn: Turn | None = None
        """The turn that is to come, while paused."""
        self.fired: Fired | None = None
        """The transition at whose breakpoint it is paused."""
        self.turns = LastTurns(arrangement)
        """The machines' latest evaluations."""
        self._hits: list[str] = []  # the breakpoints at which it is to be paused
        self._hit_in = ""  # the machine at whose breakpoint, or after whose step, it is paused
        arrangement.kernel.instrument = self

    @classmethod
    def of(cls, arrangement: Arrangement) -> Self:
        """Give the debugger of an arrangement, or make one."""
        found = arrangement.kernel.instrument
        return found if isinstance(found, cls) else cls(arrangement)

    @property
    def now_ns(self) -> int:
        """The time of the turn that is to come: a journal keeps each look at the clock."""
        if self.turn is None:
            return self.arrangement.clock.now_ns()
        return self.arrangement.environment.seen_at(self.turn.time_ns)

    @property
    def paused(self) -> str:
        """The reason for the pause, as "breakpoint Wall:STOP"; "" while there is none."""
        return self.arrangement.kernel.paused

    @property
    def machine(self) -> str:
        """The machine to look at; "" if there is none.

        At a breakpoint it is the breakpoint's, after a step the one that has fired or left its
        state, else the one whose turn is to come.
        """
        loaded = (each.machine for each in filter(None, self.arrangement.roster.standings()))
        if self._hit_in in loaded:  # one that has failed may be no more
            return self._hit_in
        return self.turn.machine if self.turn else ""

    def wait(self, timeout_s: float) -> str:
        """Wait until the arrangement is paused; return the reason, as `paused` has it.

        Raise `NotPausedError` when that has taken `timeout_s` seconds of the host, and
        `ArrangementEndedError` if the arrangement ends instead.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            left_s = until_s - time.monotonic()
            if self._is_paused.wait(min(_LOOK_S, max(left_s, 0.0))) and (why := self.paused):
                return why
            if (reason := self.arrangement.reason) is not None:
                raise ArrangementEndedError(f"this arrangement has ended, not paused: {reason}")
            if left_s <= 0:
                raise NotPausedError(
                    f"not paused within {timeout_s:g} s: the machines run on until pause(), "
                    f"a breakpoint or the end of a step"
                )

    def pause(self, why: str = "pause", *, lease_s: float | None = None) -> None:
        """Pause before the next turn; if that is done already, renew the lease, if it has one."""
        if self.paused:
            if lease_s is not None:
                self.renew(lease_s)
            return
        self._lease_s = lease_s
        self._run(Goal(why))

    def renew(self, lease_s: float) -> None:
        """Let what has a lease, a pause or an override, last at least so long from now on."""
        for each in (self._lease, *self._overrides.values()):
            if each is not None:
                each.renew(lease_s)

    def step(
        self, until: Step = "turn", machine: str | None = None, *, lease_s: float | None = None
    ) -> None:
        """Go on, and pause again: by default, before the next turn.

        `machine` is the one that is to leave its state, by default the one to look at. Raise
        `OptionError` for what is no step, and `UnknownMachineError` for a machine.
        """
        if until not in get_args(Step):
            raise OptionError(f"no step {until!r}; there are: {', '.join(get_args(Step))}")
        self._lease_s, self._arrived, rounds = lease_s, "", self.arrangement.rounds
        match until:
            case "turn":
                goal = Goal("step: turn")
            case "round":
                goal = Goal("step: round", lambda turn: turn.round > rounds)
            case "transition":
                goal = Goal("step: transition", lambda _: self._shows(self._arrived))
            case "leave":
                name = machine or self.machine
                state = self.arrangement.state_name_of(name)
                goal = Goal(
                    f"step: {name} left {state}",
                    lambda _: not self.stands(name, state) and self._shows(name),
                )
        self._run(goal)

    def proceed(self) -> None:
        """Go on, and do not pause again."""
        self._goal = None
        self.arrangement.detach(self)
        self.turns.forget()
        self._release()

    def break_at(self, *texts: str, library: Mapping[str, type[Machine]] | None = None) -> None:
        """Replace all breakpoints by these; raise `BreakpointError`, and then replace none.

        Each is of a machine that is loaded or was, or one of the `library`, by the name that it
        will have, or of a slot that a loaded one reads. A text that is set already stays, even if a
        machine that was reloaded no longer has the state. :mod:`.breakpoints` describes the texts.
        """
        found = [Breakpoint.parse(text) for text in texts]
        new = [each for each in found if each.text not in self.breakpoints]
        machines = {**self.arrangement.control.loader.classes, **(library or {})}
        machines.update((each.name, type(each)) for each in self.arrangement.machines)
        check_breakpoints(new, machines, self.arrangement.roster.slots_read)
        self._equip(found)

    @property
    def breakpoints(self) -> tuple[str, ...]:
        """The texts of the breakpoints."""
        return tuple(each.text for each in self._probes.breakpoints)

    def why(self, machine: str) -> list[Cause]:
        """Explain why a paused machine is in its state: its transitions as they were last.

        A transition that was not evaluated is as it would be now, on the machine's last snapshot.
        """
        return self.sight(machine, self.now_ns).causes

    def sight(self, machine: str, now_ns: int) -> Sight:
        """Explain why a machine is in its state at `now_ns` of the clock, paused or not."""
        found = sight_of(self.arrangement, machine, self.turns, now_ns)
        if self.fired is not None and self.fired.machine == machine:
            return found._replace(before=self.fired)
        return found if self.paused else found._replace(before=None)

    def override(
        self, machine: str, sensor: str, text: str, *, lease_s: float | None = None
    ) -> None:
        """Override a sensor of a machine by a message in JSON, or null, until it is released.

        With a lease, it is released when that is over, unless it comes again. Raise what
        `Arrangement.override` raises, and `MessageFieldError`.
        """
        slot = self.arrangement.control.slot_of(machine, sensor)
        message = None if text.strip() == "null" else parse_message(slot, text)
        self.arrangement.override(machine, sensor, message)
        if lease_s is not None:
            self._overrides[machine, slot.name] = Lease(lease_s)

    def end_lease(self, machine: str, slot: str) -> None:
        """End the lease of what was overridden before: it does not end the override after it."""
        self._overrides.pop((machine, slot), None)

    def left_s(self, machine: str, sensor: str) -> float | None:
        """Count the seconds that a sensor stays overridden; None if only a release ends that."""
        lease = self._overrides.get(
            (machine, self.arrangement.control.slot_of(machine, sensor).name)
        )
        return None if lease is None else lease.left_s

    def pause_left_s(self) -> float | None:
        """Count the seconds until a pause ends; None if only a request ends it."""
        return None if self._lease is None else self._lease.left_s

    def look(self) -> None:
        """Release the sensors whose overrides nobody has renewed."""
        for (machine, slot), lease in [*self._overrides.items()]:
            if lease.is_over:
                self.end_lease(machine, slot)
                for sensor in self.arrangement.roster.find(machine).overridden:
                    if self.arrangement.control.slot_of(machine, sensor).name == slot:
                        what = "nobody renews the override: %s: %s is released"
                        logger().warning(what, machine, sensor)
                        self.arrangement.release(machine, sensor)

    def _equip(self, breakpoints: Iterable[Breakpoint]) -> None:
        slots = {each.slot for each in self._probes.breakpoints}
        self._probes = Probes(breakpoints, self._hit, self._probes)
        self.leases = {text: self.leases[text] for text in self.breakpoints if text in self.leases}
        slots |= {each.slot for each in self._probes.breakpoints}
        self.arrangement.kernel.equip(self)
        for slot in slots - {""}:
            self.arrangement.kernel.read_again(slot)

    def bound(self, seat: Seat) -> None:
        """Wrap the sections that breakpoints are in."""
        self._probes.wrap(seat)

    def reading(self, seat: Seat, slot: str, read: Read) -> Read:
        """Wrap a sensor whose messages breakpoints look at."""
        return self._probes.reading(seat, slot, read)

    def failed(self, seat: Seat, error: ExecutionError) -> None:
        """Pause at a breakpoint of the machine's failure: at once, if all others end, too."""
        goal, now_ns = self._goal, self.arrangement.environment.peek_ns()
        if error.step.startswith("transition "):
            self.turns.take_failure(seat, error.state, raised_at(seat, error), now_ns)
        self._probes.test_failures(seat)
        if self._goal is not goal:
            self.fired = Fired.failed(seat, error, now_ns)
        if self._goal is not None and self.arrangement.kernel.on_error == "stop":
            self._wait(f"{self._goal.why}: {error}", None)

    def _hit(self, breakpoint: Breakpoint, problem: str, seat: Seat, source: str) -> None:
        """Pause before the next turn: a breakpoint is reached, perhaps as one of several."""
        self._hit_in = seat.name
        if source:
            now_ns = self.arrangement.environment.peek_ns()
            self.fired = Fired.of(seat, source, now_ns)
        what = f"breakpoint {breakpoint.text}{problem}"
        if not self._hits:
            self._lease_s = self.leases.get(breakpoint.text, self._default_lease_s)
        if what not in self._hits:
            self._hits.append(what)
        self._run(Goal("; ".join(self._hits)))

    def __call__(self, event: Event) -> None:
        """Take an event; of that with which a turn begins, return when it may."""
        self.turns(event)
        if isinstance(event, Eval) and event.value is True:
            self._arrived = event.machine
        elif isinstance(event, Turn):
            goal = self._goal
            if goal is not None and goal.is_reached(event):
                self._wait(goal.why, event)

    def _shows(self, machine: str) -> bool:
        """Make a machine the one to look at; True if there is one."""
        self._hit_in = machine
        return bool(machine)

    def stands(self, machine: str, state: str) -> bool:
        """Check that a machine is loaded, and in that state."""
        standings = filter(None, self.arrangement.roster.standings())
        return any((each.machine, each.state) == (machine, state) for each in standings)

    def _run(self, goal: Goal) -> None:
        self._goal = goal
        if self not in self.arrangement.kernel.observers:
            self.turns.forget()
            self.arrangement.attach(self)
        self._release()
        self.arrangement.environment.wake()

    def _release(self) -> None:
        self.arrangement.kernel.paused = ""
        self._is_paused.clear()
        self._go.set()

    def _begin(self, why: str) -> None:
        self.arrangement.kernel.paused = why
        if self._on_pause == "safe":
            for standing in filter(None, self.arrangement.roster.standings()):
                self.arrangement.control.post_safe(standing.machine)
        self.pauses += 1
        self._is_paused.set()

    def _hold(self, is_over: Callable[[], bool]) -> None:
        """Wait in the machines' thread until the pause is over; a stop ends it, too."""
        self.arrangement.kernel.pause(is_over)

    def _wait(self, why: str, turn: Turn | None) -> None:
        self._go.clear()
        self.turn = turn
        self._lease = None if self._lease_s is None else Lease(self._lease_s)
        has_begun = False

        def is_over() -> bool:
            nonlocal has_begun
            if not has_begun:  # now that a journal keeps requests
                has_begun = True
                self._begin(why)
            if self._lease is not None and self._lease.is_over:
                logger().warning("nobody has renewed the pause (%s): the machines go on", why)
                self.proceed()
            return self._go.wait(_LOOK_S)

        try:
            self._hold(is_over)
        finally:
            self._is_paused.clear()
            self.turn, self.fired, self._hit_in, self.arrangement.kernel.paused = None, None, "", ""
            self._hits.clear()
            if not self._go.is_set():  # a stop or an error has ended it
                self.proceed()
