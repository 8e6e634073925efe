"""Runs that go on where a file had their machines run again, from there."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from inner_worlds import DOOR, built, worlds
from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.rerun import rerun
from llfsm.runtime import Machine, State
from llfsm.runtime.keeping import keep_in
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool
from thoroughness import examples
from waiting import wait_for

from .conftest import end_of, entries_in
from .journalled_run import JumpingClock, Run, keep

steps = st.lists(
    st.one_of(
        st.tuples(st.just("turn"), st.sampled_from([1, 10, 25])),
        st.tuples(st.just("door"), st.booleans()),
        st.tuples(st.sampled_from(["suspend", "resume", "restart"]), st.integers(0, 3)),
    ),
    max_size=12,
)


def do(run: Run, script: list[tuple[str, Any]], file: Path) -> bool:
    """Run machines that are kept in a file, and kill them; return whether they went on there."""
    with keep_in(file, run.arrangement) as goes_on:
        for what, value in script:
            if what == "turn":
                assert run.clock is not None
                run.clock.advance(ms=value)
                run.arrangement.round()
            elif what == "door":
                run.board.add_message(DOOR, Bool(data=value))
            elif names := [each.name for each in run.arrangement.machines]:
                getattr(run.arrangement, what)(names[value % len(names)])
    return goes_on


@settings(max_examples=examples(60), deadline=None)
@given(
    world=worlds,
    before=steps,
    after=steps,
    how=st.sampled_from([("again", "runs"), ("in_place", "runs"), ("in_place", "stops")]),
)
@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
def test_whatever_was_kept_the_run_that_goes_on_there_happens_again(
    tmp_path_factory: pytest.TempPathFactory, world: Any, before: Any, after: Any, how: Any
) -> None:
    assume(world[3] != "unnamed")  # classes that are in no module, and that nothing names
    outer, _ = built(world, *how)
    file = tmp_path_factory.mktemp("kept") / "kept"
    first = Run([outer], clock=JumpingClock(), on_error="suspend")
    do(first, before, file)
    second = Run([outer], clock=JumpingClock(), on_error="suspend")
    do(second, [*after, ("turn", 10)], file)
    second.arrangement.end()
    difference, trace = second.again([outer], on_error="suspend")
    assert difference is None
    assert str(trace) == str(second.trace)


PUMP = """
from llfsm.runtime import Machine, State

class Pump(Machine):
    given: int = 0
    turns: int = 0
    wait, give = State(), State(resume="in_place", final=False)
    wait.to(give)

    @give.on_entry
    def _(self):
        self.given += 1

    @give.internal
    def _(self):
        self.turns = min(self.turns + 1, 5)
"""


def test_a_recorded_run_of_the_command_line_goes_on_in_its_file(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path, tmp_path: Path
) -> None:
    (tmp_path / "pump.py").write_text(PUMP)
    run = ("run", "pump.py:Pump", "--keep", "pump.kept", "-b", board.name, "--record")
    for name in ("first.mcap", file.name):
        process = llfsm(*run, name)
        recorded = tmp_path / name
        wait_for(lambda recorded=recorded: has_turns(recorded, 8), "turns in the file")
        if name == "first.mcap":
            process.kill()
        else:
            process.send_signal(signal.SIGINT)
        end_of(process)
    first = next(each for each in entries_in(Recording(file)) if each["event"] == "Turn")
    assert first["state"] == "give"
    assert Recording(file).journals[0].about["machines"] == "Pump"
    status, printed = llfsm_here("rerun", file, "pump.py:Pump")
    assert (status, printed.split()[-3:]) == (0, ["are", "as", "recorded"])


def has_turns(file: Path, least: int) -> bool:
    """Check that a recording that is being written has so many turns."""
    try:
        return sum(each["event"] == "Turn" for each in entries_in(Recording(file))) >= least
    except (OSError, RecordingError):
        return False


def test_other_machines_than_those_that_were_kept_are_refused(file: Path, tmp_path: Path) -> None:
    class Pump(Machine):
        wait, give = State(), State(final=False)
        wait.to(give)

    class Other(Machine):
        wait = State(final=False)

    for _ in range(2):
        run = Run([Pump], clock=JumpingClock())
        do(run, [("turn", 1), ("turn", 1)], tmp_path / "kept")
    run.arrangement.end()
    keep(run, file)
    Other.__name__ = "Pump"
    with pytest.raises(RecordingError, match=r"run.mcap: the file of --keep has Pump "):
        rerun(file, [Other])
