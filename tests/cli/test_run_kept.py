"""`llfsm run --keep`: machines go on where they were when their process was killed."""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path

import pytest

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from thoroughness import examples
from waiting import wait_for

from .conftest import Llfsm, offspring, wait_for_line

COUNT = ("run", "pump.py:Counter", "--keep", "kept", "-q", "-i", "0")
PUMP = """
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32

class Counter(Machine):
    number: int = 0
    at = Actuator(Slot("count", Int32))
    count, other = State(resume="in_place"), State()

    @count.on_entry
    def _(self):
        print("entered", self.number, flush=True)

    @count.on_resume
    def _(self):
        print("resumed", self.number, flush=True)

    @count.internal
    def _(self):
        self.number += 1
        self.at(Int32(data=self.number))

    count.to(other, when=lambda m: m.stopping)

class Pump(Machine):
    given: int = 0
    turns: int = 0
    wait, give, over = State(), State(resume="in_place"), State()
    wait.to(give, after_ms=1)
    give.to(over, when=lambda m: m.stopping)

    @give.on_entry
    def _(self):
        self.given += 1
        print("dose", self.given, flush=True)

    @give.internal
    def _(self):
        self.turns += 1
        if self.turns == 2:  # the round before was kept
            print("pumps", flush=True)

    @give.on_resume
    def _(self):
        print("goes on after dose", self.given, flush=True)

class Holds(Machine):
    thing: object = None
    first, last = State(), State()
    first.to(last)

    @first.on_entry
    def _(self):
        self.thing = lambda: None
"""


@pytest.fixture
def machines(tmp_path: Path) -> Path:
    (tmp_path / "pump.py").write_text(PUMP)
    return tmp_path


@pytest.mark.usefixtures("machines")
def test_a_dose_is_not_given_twice(llfsm: Llfsm, board: str) -> None:
    run = ("run", "pump.py:Pump", "--keep", "pump.kept", "-b", board, "-q")
    wait_for_line(llfsm.start(*run), "pumps")
    for _ in range(3):
        llfsm.started[-1].kill()
        llfsm.started[-1].wait()
        again = llfsm.start(*run)
        assert wait_for_line(again, "after dose") == "goes on after dose 1\n"
    again.send_signal(signal.SIGINT)  # so that it ends as a machine that has done its work
    assert again.wait() == 0
    assert wait_for_line(llfsm.start(*run), "dose") == "dose 1\n"


@pytest.mark.usefixtures("machines")
def test_no_more_than_the_round_under_way_is_lost(llfsm: Llfsm, board: str) -> None:
    chance, slot = random.Random(0), Slot("count", Int32)
    process = llfsm.start(*COUNT, "-b", board)
    wait_for_line(process, "entered 0")
    with Whiteboard(board) as wb:
        for _ in range(examples(8)):
            least = chance.randrange(1, 2000)
            before = wb[slot].count
            wait_for(lambda least=least + before: wb[slot].count >= least, "it counts")
            process.kill()
            process.wait()
            posted = wb.get_message(slot)
            assert posted is not None
            process = llfsm.start(*COUNT, "-b", board)
            kept = int(wait_for_line(process, "resumed").split()[1])
            assert kept in (posted.data - 1, posted.data)


@pytest.mark.usefixtures("machines")
def test_after_a_crash_the_next_run_of_n_goes_on(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "pump.py:Pump", "-n", "--keep", "kept", "-b", board)
    wait_for_line(process, "pumps")
    (child,) = offspring(process.pid)
    os.kill(child, signal.SIGKILL)
    wait_for_line(process, "it starts again")
    assert "goes on where kept has the machines" in wait_for_line(process, "goes on where")
    assert wait_for_line(process, "dose") == "goes on after dose 1\n"


@pytest.mark.usefixtures("machines")
def test_what_cannot_be_kept_ends_the_run_and_names_the_variable(llfsm: Llfsm, board: str) -> None:
    run = llfsm.run_apart("run", "pump.py:Holds", "--keep", "kept", "-b", board)
    assert run.returncode == 1
    assert "Error: Holds.thing, a function, cannot be kept: " in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.usefixtures("machines")
def test_a_file_in_use_or_of_other_machines_is_refused(llfsm: Llfsm, board: str) -> None:
    first = llfsm.start("run", "pump.py:Pump", "--keep", "kept", "-b", board)
    wait_for_line(first, "pumps")
    refused = llfsm.run("run", "pump.py:Pump", "--keep", "kept", "-b", board, "--local")
    assert refused.returncode == 2  # --local and -b
    refused = llfsm.run("run", "pump.py:Pump", "--keep", "kept", "--local")
    assert (refused.returncode, refused.stderr.splitlines()[-1]) == (
        1,
        "Error: kept: another process keeps its machines there; choose another file",
    )
    first.kill()
    first.wait()
    refused = llfsm.run("run", "pump.py:Counter", "--keep", "kept", "--local")
    assert refused.returncode == 1
    assert refused.stderr.splitlines()[-1] == (
        "Error: kept has a machine Pump, which is not run; start the machines that it was written "
        "by, or remove it to begin anew"
    )


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--ros", "--lifecycle"], "--keep keeps one run, --lifecycle may start several"),
    ],
)
@pytest.mark.usefixtures("machines")
def test_what_does_not_go_together_is_refused(llfsm: Llfsm, options: list[str], what: str) -> None:
    refused = llfsm.run("run", "pump.py:Pump", "--keep", "kept", *options)
    assert refused.returncode == 2
    assert what in refused.stderr
