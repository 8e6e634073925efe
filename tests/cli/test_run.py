"""`llfsm run` as people type it."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64
from waiting import PATIENCE_S

from .conftest import Llfsm, exists, wait_for_line

MODULE = """
import time
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64

OUT = Slot("out", Int64)

class Counter(Machine):
    out = Actuator(OUT, at_end=Int64(-1))
    rounds: int = 2
    label: str = "x"
    COUNT = State()
    DONE = State()

    @COUNT.on_entry
    def _(self) -> None:
        self.left = self.rounds
        print(f"{self.name} {self.label!r} counts {self.rounds}", flush=True)

    @COUNT.to(DONE)
    def at_zero(self) -> bool:
        self.left -= 1
        return self.left < 0

class Echo(Machine):
    asked = Sensor(Slot("in", Int64))
    out = Actuator(OUT)
    A = State()
    B = State()
    A.to(B, when=lambda m: m.asked is not None)

    @A.internal
    def _(self) -> None:
        print("turn", time.monotonic_ns(), flush=True)

    @A.on_exit
    def _(self) -> None:
        print("turn", time.monotonic_ns(), flush=True)
        self.out(self.asked)

class Broken(Machine):
    A = State()
    B = State()

    @A.internal
    def _(self) -> None:
        1 / 0

    @A.to(B)
    def wrong(self) -> bool:
        return False

class NotBool(Machine):
    A = State()
    B = State()

    @A.to(B)
    def seven(self) -> bool:
        return 7

class Stays(Machine):
    A = State()
    B = State()

    @A.on_entry
    def _(self) -> None:
        print("entered A", flush=True)

    @A.to(B)
    def never(self) -> bool:
        return self.stopping

nothing = 3
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MODULE)


def test_a_class_of_ones_own(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Counter 'x' counts 2\n")
    with Whiteboard(board, create=False) as wb:
        assert wb.get_message(wb.find("out")).data == -1


def test_variables_are_set_and_converted(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "Counter:rounds=3", "Counter:label=7=8", "-b", board)
    assert done.stdout == "Counter '7=8' counts 3\n"


def test_the_same_machine_twice(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "mine:Counter", "Counter.0:rounds=5", "-b", board)
    assert done.stdout == "Counter 'x' counts 2\nCounter.0 'x' counts 5\n"


def test_verbose_reports_state_changes_as_clfsm_does(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "-v", "-q", "-b", board)
    assert done.stderr.splitlines() == [
        "m  0 s  0 - Counter              - COUNT",
        "m  0 s  1 - Counter              - DONE",
    ]
    twice = llfsm.run("run", "mine:Counter", "-vv", "-q", "-b", board)
    assert "mine:Counter" in twice.stderr


def test_the_header_names_machines_and_board_unless_quiet(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "-b", board)
    assert "Counter" in done.stderr
    assert board in done.stderr
    assert llfsm.run("run", "mine:Counter", "-q", "-b", board).stderr == ""


def test_suspends_and_resumes_are_reported(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start(
        "run", "RosPingPong", "TurtleSuspendResume", "TurtleSuspendResume:target=RosPingPong",
        "-s", "-q", "-b", board,
    )  # fmt: skip
    assert "Suspend 0: INITIAL -> Suspended" in wait_for_line(process, "Suspend 0")
    assert "Resume 0: Suspended -> INITIAL" in wait_for_line(process, "Resume 0")


def test_a_machine_may_start_suspended(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "-S", "mine:Stays", "-v", "-q", "-b", board)
    assert done.returncode == 0
    assert "m  1 s  2 - Stays                - Suspended" in done.stderr


def test_accepting_machines_stay_with_u(llfsm: Llfsm, board: str) -> None:
    assert llfsm.run("run", "mine:Counter", "-u", "-b", board).returncode == 0


def test_a_message_of_another_process_ends_the_idle_sleep(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "mine:Echo", "-i", "600000000", "-q", "-b", board)
    wait_for_line(process, "turn")
    with Whiteboard(board) as wb:
        wb.add_message(Slot("in", Int64), Int64(7))
        answer = wb[Slot("out", Int64)].wait(after=0, timeout=PATIENCE_S)
    assert answer is not None
    assert answer.message == Int64(7)


def test_with_no_wake_it_does_not(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "mine:Echo", "--no-wake", "-i", "300000", "-q", "-b", board)
    first = wait_for_line(process, "turn")
    with Whiteboard(board) as wb:
        wb.add_message(Slot("in", Int64), Int64(7))
    second = wait_for_line(process, "turn")
    assert int(second.split()[1]) - int(first.split()[1]) >= 300_000_000


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it_cleanly(llfsm: Llfsm, board: str, number: signal.Signals) -> None:
    process = llfsm.start("run", "mine:Stays", "mine:Counter", "-b", board)
    wait_for_line(process, "entered A")
    process.send_signal(number)
    assert process.wait() == 0


def test_the_board_is_kept_unless_told_otherwise(llfsm: Llfsm, board: str) -> None:
    llfsm.run("run", "mine:Counter", "-b", board)
    assert exists(board)
    llfsm.run("run", "mine:Counter", "-b", board, "--remove-board")
    assert not exists(board)


@pytest.mark.parametrize(
    ("arguments", "status", "printed"),
    [
        ([], 2, "name a machine"),
        (["Nobody"], 2, "those that ship: "),
        (["no.such:Thing"], 2, "no module 'no'"),
        (["mine:Thing"], 2, "mine has no 'Thing'; its machines: "),
        ([":Counter"], 2, "no machine ':Counter'"),
        (["mine:nothing"], 2, "nothing is not a machine class; mine has: "),
        (["mine:Counter", "Counter:rounds=many"], 2, "'Counter:rounds=many'"),
        (["mine:Counter", "Counter:speed=1"], 2, "it has: rounds, label"),
        (["mine:Counter", "Counter:round=1"], 2, "label; did you mean 'rounds'?"),
        (["mine:Counter", "Other:rounds=1"], 2, "there are: Counter"),
        (["mine:Counter", "counter:rounds=1"], 2, "there are: Counter; did you mean 'Counter'?"),
        (["mine:Counter", "rounds=1"], 2, "name:variable=value"),
        (["mine:Counter", "--router", "no"], 2, "--ros or --ros-time is needed for --router"),
        (["mine:Counter", "--domain", "5"], 2, "--ros or --ros-time is needed for --domain"),
        (["mine:Counter", "--transport", "auto"], 2, "--ros-time is needed for --transport"),
        (["mine:Counter", "-i", "-5"], 2, "-5"),
        (["--realtime", "mine:Counter"], 2, "is not a priority; name the machines first"),
        (["mine:Counter", "--realtime", "100"], 2, "100 is not in the range 1<=x<=99"),
        (["mine:Counter", "--cpu", "0"], 1, "cpu is given without realtime"),
        (["mine:Counter", "--realtime", "--cpu", "9999"], 1, "core 9999 cannot be used"),
        (["mine:Counter", "-b", "a/b"], 1, "is not a valid whiteboard name"),
        (["mine:Broken"], 1, "Broken, state A, Internal"),
        (["mine:NotBool"], 1, "seven"),
    ],
)  # fmt: skip
def test_bad_input_is_one_clear_error(
    llfsm: Llfsm, board: str, arguments: list[str], status: int, printed: str
) -> None:
    where = [] if "-b" in arguments else ["-b", board]
    done = llfsm.run("run", "-q", *arguments, *where)
    assert done.returncode == status
    assert printed in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize("core", ["9999", str(10**20)])
def test_a_core_that_is_not_there_is_all_that_is_printed(
    llfsm: Llfsm, board: str, core: str
) -> None:
    options = ["--realtime", "--cpu", core, "-t"]
    done = llfsm.run("run", "-q", "mine:Counter", "-b", board, *options)
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"Error: core {core} cannot be used; this process has: ")


def test_an_error_in_user_code_names_file_and_line(llfsm: Llfsm, board: str) -> None:
    line = next(n for n, text in enumerate(MODULE.splitlines(), 1) if "1 / 0" in text)
    done = llfsm.run("run", "-q", "mine:Broken", "-b", board)
    assert f"mine.py:{line}" in done.stderr
    done = llfsm.run_apart("--debug", "run", "-q", "mine:Broken", "-b", board)
    assert "Traceback" in done.stderr


def test_on_error_suspend_goes_on(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("run", "mine:Broken", "mine:Counter", "--on-error=suspend", "-b", board)
    wait_for_line(process, "ZeroDivisionError")
    wait_for_line(process, "Counter 'x' counts 2")
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0


def test_help_answers_with_examples(llfsm: Llfsm) -> None:
    for command in ([], ["run"], ["turtlesim"], ["whiteboard"], ["demo"]):
        done = llfsm.run(*command, "--help")
        assert done.returncode == 0
        assert "llfsm" in done.stdout
