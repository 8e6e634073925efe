"""A recording is gone through in both directions, and is the same in each."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.rerun import Rerun
from llfsm.bridges.recording.reversing.reverse_debugger import ReverseDebugger, SectionPlace
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


def debugging(run: Run, machines: list[Any] = MACHINES, **options: Any) -> ReverseDebugger:
    entries = run.entries
    named = {getattr(each, "recorded", each.__name__): each for each in machines}

    def again() -> Rerun:
        rerun = Rerun(entries)
        arrangement = rerun.arrange(**options)
        for name, each in named.items():
            arrangement.load(each, name=name)
        return rerun

    return ReverseDebugger(again, named, 0)


@pytest.fixture(scope="module")
def run() -> Run:
    return journal(40)


@pytest.fixture
def reverse(run: Run) -> Iterator[ReverseDebugger]:
    with debugging(run) as reverse:
        reverse.wait()
        yield reverse


def sight(reverse: ReverseDebugger) -> object:
    """Return all that there is to be seen at a moment."""
    debugger, arrangement = reverse.debugger, reverse.arrangement
    names = [machine.name for machine in arrangement.machines]
    return (
        debugger.moment,
        debugger.turn,
        reverse.now_s,
        arrangement.roster.standings(),
        [variables_of(arrangement.machine(name)) for name in names],
        [why_of(arrangement, name, debugger.now_ns).transitions for name in names],
    )


def moments(reverse: ReverseDebugger, how: str, *arguments: Any) -> list[int]:
    """Return each moment that is come to, one after the other, up to the end."""
    found = []
    while getattr(reverse, how)(*arguments):
        found.append(reverse.debugger.moment)
    return found


def test_each_moment_is_the_same_from_both_sides(reverse: ReverseDebugger, run: Run) -> None:
    """Also after the stop that was recorded, and whatever was looked at before."""
    seen = [sight(reverse)]
    while reverse.step("turn"):
        seen.append(sight(reverse))
    assert len(seen) == sum(type(event).__name__ == "Turn" for event in run.trace) > 40
    assert reverse.end.startswith("the recording ends here")
    for expected in reversed(seen[::7]):
        while reverse.debugger.moment > expected[0]:
            reverse.back("turn")
        assert sight(reverse) == expected
    with pytest.raises(RecordingError, match="the recording begins here"):
        reverse.back("turn")
    assert sight(reverse) == seen[0]


@pytest.mark.parametrize("until", ["round", "transition"])
def test_a_step_back_is_to_where_a_step_could_have_ended(
    reverse: ReverseDebugger, until: Any
) -> None:
    ends = moments(reverse, "step", until)
    ends = [1, *ends] if until == "round" else ends
    assert len(ends) > 2
    for start in (*ends[:3], ends[1] + 1, reverse.debugger.moment):
        reverse.goto(0)
        for _ in range(start - 1):
            reverse.step("turn")
        earlier = [end for end in ends if end < start]
        if earlier:
            assert reverse.back(until) == f"back: {until}"
            assert reverse.debugger.moment == earlier[-1]
        else:
            with pytest.raises(RecordingError):
                reverse.back(until)
            assert reverse.debugger.moment == start, "it stays where it was"


def test_a_step_back_runs_the_machines_again_once(
    reverse: ReverseDebugger, monkeypatch: pytest.MonkeyPatch
) -> None:
    again, arrange = [], Rerun.arrange
    monkeypatch.setattr(Rerun, "arrange", lambda rerun: again.append(rerun) or arrange(rerun))
    reverse.goto(1e9)
    assert again == []
    for number, until in enumerate(("turn", "round", "transition"), 1):
        reverse.back(until)
        assert len(again) == number


def test_a_machine_goes_back_to_before_it_came_to_its_state(reverse: ReverseDebugger) -> None:
    reverse.goto(1e9)
    standing = reverse.arrangement.roster.find("Follower").standing()
    reverse.back("leave", "Follower")
    before = reverse.debugger.moment
    assert reverse.arrangement.state_name_of("Follower") != standing.state
    assert reverse.debugger.turn.machine == "Follower"
    reverse.step("turn")
    assert reverse.arrangement.state_name_of("Follower") == standing.state
    reverse.goto(0)
    with pytest.raises(RecordingError, match="Follower has been in low from the beginning"):
        reverse.back("leave", "Follower")
    assert reverse.debugger.moment == 1 < before


def test_breakpoints_are_reached_from_both_sides(reverse: ReverseDebugger) -> None:
    """With counts from the beginning, also on messages; and looking changes nothing."""
    reverse.step("round")
    reverse.break_at("Follower:high", "@command#3 if value == 7", "Keeper:watch->")
    reverse.goto(0)
    hits = moments(reverse, "proceed")
    assert len(hits) > 3
    assert "not act as recorded" not in reverse.end
    back = []
    with suppress(RecordingError):
        while reverse.back_to_breakpoint().startswith("breakpoint "):
            back.append(reverse.debugger.moment)
    assert back == hits[::-1]
    assert reverse.debugger.moment == hits[0], "it stays where it was"


def test_breakpoints_on_the_way_to_a_moment_are_passed(reverse: ReverseDebugger) -> None:
    reverse.break_at("Follower:high", "Follower:low")
    reverse.goto(1e9)
    assert reverse.end
    times = {}
    while reverse.back("round"):
        times[reverse.debugger.moment] = reverse.now_s
        if reverse.debugger.moment == 1:
            break
    for moment, seconds in times.items():
        reverse.goto(seconds)
        assert (reverse.now_s, reverse.debugger.moment) == (seconds, moment)
    reverse.goto(times[1] - 5)
    assert reverse.debugger.moment == 1


def test_a_message_is_kept_when_its_sensor_is_connected_again(reverse: ReverseDebugger) -> None:
    """As a breakpoint on its slot does, in the middle of the run."""
    for number in range(40):
        reverse.break_at(*(["@command#99"] if number % 2 else []))
        reverse.step("turn")
    reverse.proceed()
    assert reverse.end.startswith("the recording ends here")


def test_there_is_nothing_after_the_end(reverse: ReverseDebugger) -> None:
    assert not reverse.proceed()
    for step in (reverse.proceed, lambda: reverse.step("turn")):
        with pytest.raises(RecordingError, match=r"the recording ends here, at .*; go back"):
            step()


class Changed(Follower):
    recorded = "Follower"

    @Follower.high.on_entry
    def _(self) -> None:
        self.seen(Number(99))


def test_code_that_has_changed_is_followed_up_to_where_it_differs(run: Run) -> None:
    with debugging(run, [Keeper, Changed]) as reverse:
        reverse.wait()
        reverse.proceed()
        said = "from here on the machines do not act as recorded: Follower now "
        assert reverse.end.startswith(said)
        assert "* message" in reverse.end
        assert reverse.arrangement.state_name_of("Follower") == "high"
        end = reverse.end
        reverse.back("turn")
        assert reverse.debugger.turn.machine == "Follower"
        assert not reverse.end
        assert not reverse.step("turn")
        assert reverse.end == end


def test_other_machines_are_refused(run: Run) -> None:
    with (
        debugging(run, [Follower]) as reverse,
        pytest.raises(RecordingError, match="Keeper, Follower, not Follower"),
    ):
        reverse.wait()


def test_a_failure_that_ends_all_is_a_moment() -> None:
    run = Run([Failing], clock=JumpingClock())
    with suppress(Exception):
        for value in (1, 2, 3, 11):
            run.board.add_message(COMMAND, Number(value))
            run.arrangement.round()
    run.arrangement.end("failed")
    with debugging(run, [Failing]) as reverse:
        reverse.wait()
        reverse.break_at("Failing!")
        assert "11 is too much" in reverse.proceed()
        assert reverse.arrangement.machine("Failing").command == Number(11)
        reverse.back("turn")
        assert reverse.arrangement.machine("Failing").command == Number(3)
        reverse.goto(1e9)
        assert reverse.end.startswith("the recording ends here")
        assert "machine Failing, state good, Internal: ValueError: 11 is too much" in reverse.end
        assert "11 is too much" in reverse.back_to_breakpoint()


def test_a_failure_that_others_outlive_is_gone_back_to() -> None:
    run = Run([Failing, Keeper], clock=JumpingClock(), on_error="suspend")
    for value in (1, 8, 11, 16, 8):
        run.board.add_message(COMMAND, Number(value))
        run.arrangement.round()
    run.arrangement.end()
    with debugging(run, [Failing, Keeper], on_error="suspend") as reverse:
        reverse.wait()
        reverse.break_at("Failing!")
        reverse.goto(1e9)
        assert "too much" not in reverse.end
        assert reverse.back_to_breakpoint() == "breakpoint Failing!"
        assert reverse.arrangement.machine("Failing").command == Number(11)
        (cause,) = why_of(reverse.arrangement, "Failing", reverse.debugger.now_ns).before
        assert (cause.value, cause.seen) == (False, "False")
        with pytest.raises(RecordingError, match="no breakpoint is reached before"):
            reverse.back_to_breakpoint()


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
def test_a_pdb_needs_code(reverse: ReverseDebugger, place: SectionPlace, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem):
        reverse.open_pdb(place)
    assert reverse.debugger.moment == 1


def test_a_breakpoint_that_is_wrong_changes_nothing(reverse: ReverseDebugger) -> None:
    reverse.break_at("Follower:high")
    with pytest.raises(BreakpointError):
        reverse.break_at("Follower:hig")
    assert reverse.debugger.breakpoints == ("Follower:high",)
