"""A recording is gone through in both directions, and is the same in each."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from llfsm.bridges.recording.errors import MomentError, OtherMachinesError
from llfsm.bridges.recording.rerun import Rerun
from llfsm.bridges.recording.reversing.reverse_debugger import SectionPlace, Travel
from llfsm.runtime import BreakpointError
from llfsm.runtime.debugging.obeying import why_of
from llfsm.runtime.presence.published import variables_of

from .journalled_run import JumpingClock, Run
from .machines import COMMAND, Failing, Follower, Keeper, Number

MACHINES = [Keeper, Follower]


def journal(rounds: int, machines: list[Any] = MACHINES, *, seed: int = 1) -> Run:
    """Run machines on random commands, with a stop two rounds before the end."""
    choose = random.Random(seed)
    run = Run(machines, clock=JumpingClock())
    for number in range(rounds):
        if number % 3 == 0:  # else sensors find what they have found before
            run.board.add_message(COMMAND, Number(choose.randrange(1, 12)))
        if number == rounds - 2:
            run.arrangement.stop()
        run.clock.advance(ms=choose.choice([0, 10, 30]))
        run.arrangement.round()
    run.arrangement.end()
    return run


def travelled(run: Run, machines: list[Any] = MACHINES, **options: Any) -> Travel:
    entries = run.entries
    named = {getattr(each, "recorded", each.__name__): each for each in machines}

    def again() -> Rerun:
        rerun = Rerun(entries)
        arrangement = rerun.arrange(**options)
        for name, each in named.items():
            arrangement.load(each, name=name)
        return rerun

    return Travel(again, named, 0)


@pytest.fixture(scope="module")
def run() -> Run:
    return journal(40)


@pytest.fixture
def travel(run: Run) -> Iterator[Travel]:
    with travelled(run) as travel:
        travel.wait()
        yield travel


def sight(travel: Travel) -> object:
    """Return all that there is to be seen at a moment."""
    debugger, arrangement = travel.debugger, travel.arrangement
    names = [machine.name for machine in arrangement.machines]
    return (
        debugger.moment,
        debugger.turn,
        travel.now_s,
        arrangement.roster.standings(),
        [variables_of(arrangement.machine(name)) for name in names],
        [why_of(arrangement, name, debugger.now_ns).transitions for name in names],
    )


def moments(travel: Travel, how: str, *arguments: Any) -> list[int]:
    """Return each moment that is come to, one after the other, up to the end."""
    found = []
    while getattr(travel, how)(*arguments):
        found.append(travel.debugger.moment)
    return found


def test_each_moment_is_the_same_from_both_sides(travel: Travel, run: Run) -> None:
    """Also after the stop that was recorded, and whatever was looked at before."""
    seen = [sight(travel)]
    while travel.step("turn"):
        seen.append(sight(travel))
    assert len(seen) == sum(type(event).__name__ == "Turn" for event in run.trace) > 40
    assert travel.end.startswith("the recording ends here")
    for expected in reversed(seen[::7]):
        while travel.debugger.moment > expected[0]:
            travel.back("turn")
        assert sight(travel) == expected
    with pytest.raises(MomentError, match="the recording begins here"):
        travel.back("turn")
    assert sight(travel) == seen[0]


@pytest.mark.parametrize("until", ["round", "transition"])
def test_a_step_back_is_to_where_a_step_could_have_ended(travel: Travel, until: Any) -> None:
    ends = moments(travel, "step", until)
    ends = [1, *ends] if until == "round" else ends
    assert len(ends) > 2
    for start in (*ends[:3], ends[1] + 1, travel.debugger.moment):
        travel.goto(0)
        for _ in range(start - 1):
            travel.step("turn")
        earlier = [end for end in ends if end < start]
        if earlier:
            assert travel.back(until) == f"back: {until}"
            assert travel.debugger.moment == earlier[-1]
        else:
            with pytest.raises(MomentError):
                travel.back(until)
            assert travel.debugger.moment == start, "it stays where it was"


def test_a_step_back_runs_the_machines_again_once(
    travel: Travel, monkeypatch: pytest.MonkeyPatch
) -> None:
    again, arrange = [], Rerun.arrange
    monkeypatch.setattr(Rerun, "arrange", lambda rerun: again.append(rerun) or arrange(rerun))
    travel.goto(1e9)
    assert again == []
    for number, until in enumerate(("turn", "round", "transition"), 1):
        travel.back(until)
        assert len(again) == number


def test_a_machine_goes_back_to_before_it_came_to_its_state(travel: Travel) -> None:
    travel.goto(1e9)
    standing = travel.arrangement.roster.find("Follower").standing()
    travel.back("leave", "Follower")
    before = travel.debugger.moment
    assert travel.arrangement.state_name_of("Follower") != standing.state
    assert travel.debugger.turn.machine == "Follower"
    travel.step("turn")
    assert travel.arrangement.state_name_of("Follower") == standing.state
    travel.goto(0)
    with pytest.raises(MomentError, match="Follower has been in low from the beginning"):
        travel.back("leave", "Follower")
    assert travel.debugger.moment == 1 < before


def test_breakpoints_are_reached_from_both_sides(travel: Travel) -> None:
    """With counts from the beginning, also on messages; and looking changes nothing."""
    travel.step("round")
    travel.break_at("Follower:high", "@command#3 if value == 7", "Keeper:watch->")
    travel.goto(0)
    hits = moments(travel, "proceed")
    assert len(hits) > 3
    assert "not act as recorded" not in travel.end
    back = []
    with suppress(MomentError):
        while travel.back_to_breakpoint().startswith("breakpoint "):
            back.append(travel.debugger.moment)
    assert back == hits[::-1]
    assert travel.debugger.moment == hits[0], "it stays where it was"


def test_breakpoints_on_the_way_to_a_moment_are_passed(travel: Travel) -> None:
    travel.break_at("Follower:high", "Follower:low")
    travel.goto(1e9)
    assert travel.end
    times = {}
    while travel.back("round"):
        times[travel.debugger.moment] = travel.now_s
        if travel.debugger.moment == 1:
            break
    for moment, seconds in times.items():
        travel.goto(seconds)
        assert (travel.now_s, travel.debugger.moment) == (seconds, moment)
    travel.goto(times[1] - 5)
    assert travel.debugger.moment == 1


def test_a_message_is_kept_when_its_sensor_is_connected_again(travel: Travel) -> None:
    """As a breakpoint on its slot does, in the middle of the run."""
    for number in range(40):
        travel.break_at(*(["@command#99"] if number % 2 else []))
        travel.step("turn")
    travel.proceed()
    assert travel.end.startswith("the recording ends here")


def test_there_is_nothing_after_the_end(travel: Travel) -> None:
    assert not travel.proceed()
    for step in (travel.proceed, lambda: travel.step("turn")):
        with pytest.raises(MomentError, match=r"the recording ends here, at .*; go back"):
            step()


class Changed(Follower):
    recorded = "Follower"

    @Follower.high.on_entry
    def _(self) -> None:
        self.seen(Number(99))


def test_code_that_has_changed_is_followed_up_to_where_it_differs(run: Run) -> None:
    with travelled(run, [Keeper, Changed]) as travel:
        travel.wait()
        travel.proceed()
        assert travel.end.startswith("from here on the machines do not act as recorded: event ")
        assert "* message" in travel.end
        assert travel.arrangement.state_name_of("Follower") == "high"
        end = travel.end
        travel.back("turn")
        assert travel.debugger.turn.machine == "Follower"
        assert not travel.end
        assert not travel.step("turn")
        assert travel.end == end


def test_other_machines_are_refused(run: Run) -> None:
    with (
        travelled(run, [Follower]) as travel,
        pytest.raises(OtherMachinesError, match="Keeper, Follower, not Follower"),
    ):
        travel.wait()


def test_a_failure_that_ends_all_is_a_moment() -> None:
    run = Run([Failing], clock=JumpingClock())
    with suppress(Exception):
        for value in (1, 2, 3, 11):
            run.board.add_message(COMMAND, Number(value))
            run.arrangement.round()
    run.arrangement.end("failed")
    with travelled(run, [Failing]) as travel:
        travel.wait()
        travel.break_at("Failing!")
        assert "11 is too much" in travel.proceed()
        assert travel.arrangement.machine("Failing").command == Number(11)
        travel.back("turn")
        assert travel.arrangement.machine("Failing").command == Number(3)
        travel.goto(1e9)
        assert travel.end.startswith("the recording ends here")
        assert "machine Failing, state good, Internal: ValueError: 11 is too much" in travel.end
        assert "11 is too much" in travel.back_to_breakpoint()


def test_a_failure_that_others_outlive_is_gone_back_to() -> None:
    run = Run([Failing, Keeper], clock=JumpingClock(), on_error="suspend")
    for value in (1, 8, 11, 16, 8):
        run.board.add_message(COMMAND, Number(value))
        run.arrangement.round()
    run.arrangement.end()
    with travelled(run, [Failing, Keeper], on_error="suspend") as travel:
        travel.wait()
        travel.break_at("Failing!")
        travel.goto(1e9)
        assert "too much" not in travel.end
        assert travel.back_to_breakpoint() == "breakpoint Failing!"
        assert travel.arrangement.machine("Failing").command == Number(11)
        (cause,) = why_of(travel.arrangement, "Failing", travel.debugger.now_ns).before
        assert (cause.value, cause.seen) == (False, "False")
        with pytest.raises(MomentError, match="no breakpoint is reached before"):
            travel.back_to_breakpoint()


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        (
            SectionPlace("Follower", "low", "OnExit"),
            "no code low.OnExit; it has: low.OnE",
        ),
        (SectionPlace("Follower", "lo", "OnEntry"), "Follower has no code lo.OnEntry"),
    ],
)
def test_a_pdb_needs_code(travel: Travel, place: SectionPlace, problem: str) -> None:
    with pytest.raises(MomentError, match=problem):
        travel.open_pdb(place)
    assert travel.debugger.moment == 1


def test_a_breakpoint_that_is_wrong_changes_nothing(travel: Travel) -> None:
    travel.break_at("Follower:high")
    with pytest.raises(BreakpointError):
        travel.break_at("Follower:hig")
    assert travel.debugger.breakpoints == ("Follower:high",)
