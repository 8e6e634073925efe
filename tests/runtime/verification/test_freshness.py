"""Sensors with `max_age_ms` and `since_start` are explored: messages may be too old."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, Machine, Sensor, State
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import Property, UnsupportedError, explore, leads_to, never
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

RANGE, ALIVE, DRIVE = (Slot(name, Int32) for name in ("range", "alive", "drive"))
FAR, NEAR = Int32(data=9), Int32(data=1)
GO, STAY = Int32(data=1), Int32(data=0)


class Driver(Machine):
    """Drive while something is seen and it is far away."""

    range = Sensor(RANGE, max_age_ms=100, domain=[FAR, NEAR])
    drive = Actuator(DRIVE, at_end=STAY)

    stay = State(final=False)
    go = State()

    @stay.on_entry
    def _(self) -> None:
        self.drive(STAY)

    stay.to(go, when=lambda m: m.range is not None and m.range.data > 5)

    @go.on_entry
    def _(self) -> None:
        self.drive(GO)

    go.to(stay, when=lambda m: m.range is not None and m.range.data < 5)


class Careful(Driver):
    """Stop where nothing is seen, too."""

    Driver.go.to(Driver.stay, when=lambda m: m.range is None)


BLIND = never(lambda v: v.Driver.state == "go" and v.Driver.range is None, "it drives blindly")
SEES = never(lambda v: v.Careful.state == "go" and v.Careful.range is None, "it drives blindly")


@pytest.mark.parametrize("how", [{"period_ms": 10}, {}, {"period_ms": 10, "choices": "rounds"}])
def test_a_message_of_the_environment_may_be_too_old(how: dict[str, Any]) -> None:
    space = explore(Driver, properties=[BLIND], **how)
    (verdict,) = space.verdicts
    assert verdict.holds is False
    assert verdict.witness is not None
    last = replay(space, verdict.witness)[-1]
    assert (last.Driver.state, last.Driver.range) == ("go", None)
    # Whoever looks for None is in the state for that one turn alone.
    assert explore(Careful, properties=[SEES], **how).verdicts[0].holds is True


class Since(Machine):
    """Go where a message that came since the start says so."""

    range = Sensor(RANGE, since_start=True, domain=[NEAR])
    wait, gone = State(), State()
    wait.to(gone, when=lambda m: m.range is not None)


def test_a_message_may_be_from_before_the_start() -> None:
    gone = leads_to(lambda v: v.Since.state == "wait", lambda v: v.Since.state == "gone")
    assert explore(Since, period_ms=10, properties=[gone]).verdicts[0].holds is False


class Beat(Machine):
    """Post now and then, until it is tired."""

    alive = Actuator(ALIVE)
    beats: int = 0
    beat, rest, tired = State(), State(), State(final=False)

    @beat.on_entry
    def _(self) -> None:
        self.alive(Int32(data=1))
        self.beats += 1

    beat.to(tired, when=lambda m: m.beats > 2)
    beat.to(rest)
    rest.to(beat, after_ms=30)


class Watch(Machine):
    """Count for how many turns nothing was heard."""

    alive = Sensor(ALIVE, max_age_ms=50)
    silent: int = 0
    watch = State(final=False)

    @watch.internal
    def _(self) -> None:
        self.silent = min(self.silent + 1, 9) if self.alive is None else 0


def deaf(turns: int) -> Property:
    """Be violated where nothing is heard for so many turns, though it still beats."""
    return never(lambda v: v.Beat.state == "rest" and v.Watch.silent >= turns)


@pytest.mark.parametrize(("machines", "heard"), [([Beat, Watch], 0), ([Watch, Beat], 1)])
def test_what_machines_post_is_as_old_as_their_turns(
    machines: list[type[Machine]], heard: int
) -> None:
    """A beat comes every 50 ms: after 30 ms, in the next turn, and a turn for each state."""
    ages = [deaf(turns) for turns in range(1, 4)]
    space = explore(machines, period_ms=10, properties=ages)
    assert space.complete
    assert [verdict.holds for verdict in space.verdicts] == [not heard, True, True]


@pytest.mark.parametrize("period_us", [5_000])
def test_it_runs_as_it_was_explored(period_us: int) -> None:
    """The watch falls silent just as many turns after the last beat as was explored."""

    class Ends(Watch):
        end = State()
        Watch.watch.to(end, when=lambda m: m.silent == 3)

    first = never(lambda v: v.Ends.state == "end", "it ends")
    (verdict,) = explore([Beat, Ends], period_ms=period_us / 1e3, properties=[first]).verdicts
    assert verdict.witness is not None
    rounds = verdict.witness.turns[-1].round
    for _ in range(3):
        arrangement = Arrangement([Beat, Ends], whiteboard=Whiteboard.local(), period_us=period_us)
        arrangement.run(max_rounds=rounds + 5)
        assert arrangement.kernel.pacer is not None
        if not arrangement.kernel.pacer.skipped:
            assert "Ends" not in {each.name for each in arrangement.machines}


def test_what_is_refused() -> None:
    with pytest.raises(UnsupportedError, match="give period_ms"):
        explore([Beat, Watch])

    class Asking(Machine):
        range = Sensor(RANGE, domain=[NEAR])
        a, b = State(), State()
        a.to(b, when=lambda m: (m.age_ms("range") or 0) > 3)

    with pytest.raises(UnsupportedError, match=r"age_ms.*max_age_ms"):
        explore(Asking, period_ms=10)

    class Younger(Machine):
        range = Sensor(RANGE, max_age_ms=20, domain=[FAR, NEAR])
        a, b = State(), State()
        a.to(b, when=lambda m: m.range is None)

    with pytest.raises(UnsupportedError, match="different max_age_ms"):
        explore([Driver, Younger], period_ms=10, choices="rounds")
    assert explore([Driver, Younger], period_ms=10).complete


class Restarted(Machine):
    """Leave its first state unless it finds what a restart has posted."""

    seen = Sensor(DRIVE, default=GO)
    drive = Actuator(DRIVE, at_suspend=STAY)
    a, b = State(), State(final=False)
    a.to(b, when=lambda m: m.seen.data == 1)


def test_a_machine_finds_what_its_restart_has_posted() -> None:
    stays = never(lambda v: v.Restarted.state == "a" and v.Restarted.seen == STAY)
    (verdict,) = explore(Restarted, period_ms=10, suspend="Restarted", properties=[stays]).verdicts
    assert verdict.holds is False
    assert verdict.witness is not None
    assert len(verdict.witness.turns) == 1
