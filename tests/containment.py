"""Random machines run as any others, with requests at every boundary: it was all explored."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from hypothesis import assume, event, reject
from hypothesis import strategies as st

from agreement import DOMAINS
from llfsm.runtime import Arrangement, ExecutionError
from llfsm.runtime._values import freeze
from llfsm.runtime.counterexamples import LiveSituation
from llfsm.runtime.engine.events import Event, RoundEnd, Turn
from llfsm.runtime.engine.kernel import OnError
from llfsm.runtime.testing.scripted import ScriptedEnvironment
from llfsm.runtime.verification import Space, UnsupportedError, explore
from llfsm.runtime.verification._predicates import PackedSituation
from llfsm.runtime.verification.properties import Situation
from random_machines import FRESH, LEFT, RIGHT, SHARED, Ages, ages, built, specs

__all__ = ["Boundary", "Follower", "Happenings", "assert_contained", "happenings"]


class Boundary(NamedTuple):
    """What happens between two turns: requests to machine A or a stop, and what slots hold."""

    asked: tuple[str, ...] = ()
    left: int = 0
    right: int = 0


class Happenings(NamedTuple):
    """Machines, as `built` makes them, how they run, and what happens at each boundary."""

    machines: Any
    unload_accepting: bool
    period_ms: int
    boundaries: list[Boundary]
    on_error: OnError = "stop"
    ages: Ages = FRESH


_ASKED = st.sampled_from(["suspend", "suspend", "resume", "restart", "stop"])
_QUIET = st.just(Boundary())
_BUSY = st.builds(
    Boundary, st.tuples(_ASKED) | st.tuples(_ASKED, _ASKED), st.integers(0, 2), st.integers(0, 1)
)
happenings = st.builds(
    Happenings,
    specs,
    st.booleans(),
    st.sampled_from([5, 8, 10]),
    st.lists(_QUIET | _BUSY, min_size=4, max_size=30),
    st.sampled_from(["stop", "suspend"]),
    ages,
)


def assert_contained(happened: Happenings, *, most: int) -> None:
    """Run the machines, and follow in the explored states what they do; leave out large spaces."""
    how: dict[str, Any] = {
        "unload_accepting": happened.unload_accepting,
        "on_error": happened.on_error,
    }
    try:
        space = explore(
            built(happened.machines, happened.ages),
            period_ms=happened.period_ms,
            sensors=DOMAINS,
            stop=True,
            suspend="A",
            max_states=most,
            **how,
        )
    except UnsupportedError as error:
        if "in OnSuspend or OnResume" not in str(error):
            raise
        reject()
    assume(space.complete)
    event(f"{len(str(space.states))} digits of states")
    live = _Live(happened, space, **how)
    live.run()


class Follower:
    """Follows turns of machines in the explored states: `nodes` may be where they are."""

    def __init__(self, space: Space, environment: Any):
        self.environment = environment
        self.search = space.search
        self.nodes = {(0, self.search.tables.initial())}

    @property
    def machines(self) -> Any:
        return self.environment.machines

    def follow_seen(self, machine: str) -> None:
        """Go on to all states after a turn of `machine` in which all is as it is now."""
        live = self.observed(LiveSituation(self.environment))
        self.follow(machine, lambda state: self.observed(self.explored(state)) == live)

    def follow(self, machine: str, agrees: Callable[[int], object]) -> None:
        """Go on to all states after a turn of `machine` that agree; there must be some."""
        names = self.search.tables.system.names
        self.nodes = {
            (step.turn, step.state)
            for node in self.nodes
            for step in self.search.steps(*node)
            if names[step.place] == machine and agrees(step.state)
        }
        assert self.nodes, f"a turn of {machine} was not explored"

    def explored(self, state: int) -> Situation:
        return PackedSituation(self.search.tables, state, set())

    def observed(self, situation: Situation) -> Any:
        """Return what there is of a state but for times, and requests that are pending for A."""
        controls = {name: situation.control(name) for name in self.machines}
        controls["A"] = controls["A"]._replace(request=None)
        variables = [
            sorted((n, freeze(v, lambda _: None)) for n, v in situation.variables(name).items())
            for name in self.machines
        ]
        return controls, variables, situation.content(SHARED.name)


class _Live(Follower):
    """An arrangement whose turns are followed, under a manual clock.

    All boundaries are alike: before the first turn of a round, between two, and after the last.
    """

    def __init__(
        self, happened: Happenings, space: Space, *, unload_accepting: bool, on_error: OnError
    ):
        super().__init__(space, ScriptedEnvironment())
        self.arrangement = Arrangement(
            built(happened.machines, happened.ages),
            environment=self.environment,
            unload_accepting=unload_accepting,
            on_error=on_error,
            observers=[self.look],
        )
        self.period_ms = happened.period_ms
        self.coming = iter(happened.boundaries)
        self.turn = ""
        self.over = False

    def run(self) -> None:
        """Run rounds until the machines end, or nothing more happens."""
        arrangement, tables = self.arrangement, self.search.tables
        self.environment.whiteboard.add_message(RIGHT, DOMAINS[RIGHT][0])
        while not self.over:
            self.environment.clock.advance(ms=self.period_ms)
            try:
                arrangement.round()
            except ExecutionError:
                self.follow(self.turn, lambda state: state & tables.failed.mask)
                return
            if arrangement.finished:
                standings = filter(None, arrangement.roster.standings())
                asleep = any(each.machine == "A" and each.suspended for each in standings)
                if arrangement.stopping or not asleep:  # else it goes on, as if held
                    assert any(tables.may_end(*node) for node in self.nodes)
                return

    def look(self, event: Event) -> None:
        """Follow the turn that is over, and let the next things happen."""
        if not isinstance(event, Turn | RoundEnd):
            return
        if self.turn:
            self.follow_seen(self.turn)
        self.turn = event.machine if isinstance(event, Turn) else ""
        self.happen()

    def happen(self) -> None:
        boundary = next(self.coming, None)
        if boundary is None:
            self.over = True
            return
        for asked in boundary.asked:
            if asked == "stop":
                self.arrangement.stop()
            elif any(each.name == "A" for each in self.arrangement.machines):
                verb = self.arrangement.control.hold if asked == "suspend" else None
                (verb or getattr(self.arrangement, asked))("A")
        for slot, number in ((LEFT, boundary.left), (RIGHT, boundary.right)):
            if (message := DOMAINS[slot][number]) is not None:
                self.environment.whiteboard.add_message(slot, message)
