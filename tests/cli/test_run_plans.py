"""`llfsm run` of arrangement files, dispatch tables and all that arguments say about machines."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest

from llfsm.whiteboard import Whiteboard

from .conftest import Llfsm, exists, wait_for_line
from .test_run_bundles import write

MODULE = """
import time

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64, String

OUT = Slot("out", Int64)

class Counter(Machine):
    out = Actuator(OUT, at_end=Int64(-1))
    rounds: int = 2
    label: str = "x"
    COUNT = State()
    DONE = State()

    @COUNT.on_entry
    def _(self):
        self.left = self.rounds
        print(f"{self.name} {self.label!r} counts {self.rounds}", flush=True)

    @COUNT.to(DONE)
    def at_zero(self):
        self.left -= 1
        return self.left < 0

class Stays(Machine):
    A = State()
    B = State()

    @A.on_entry
    def _(self):
        print("entered A", flush=True)

    @B.on_entry
    def _(self):
        print(self.name, "ended well", flush=True)

    A.to(B, when=lambda m: m.stopping)

class Loader(Machine):
    A = State()

    @A.on_entry
    def _(self):
        self.load("Late")

class Late(Machine):
    A = State()

    @A.on_entry
    def _(self):
        print(self.name, "was loaded", flush=True)

class Slow(Machine):
    A = State()
    B = State()

    @A.internal
    def _(self):
        self.left -= 1
        time.sleep(0.003)

    left: int = 3
    A.to(B, when=lambda m: m.left <= 0)

class Broken(Machine):
    A = State()

    @A.on_entry
    def _(self):
        raise RuntimeError("broken indeed")

    A.to(A, when=lambda m: False)
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MODULE)


def machine(definition: str, *lines: str) -> str:
    return "\n".join(["[[machine]]", f'definition = "{definition}"', *lines, ""])


# Arrangement files


def test_an_arrangement_file(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(
        f'board = "{board}"\n'
        + machine("mine:Counter", 'name = "left"', "variables = {rounds = 5, label = 'y'}")
        + machine("mine:Counter", 'slots.out = "other"')
        + machine("mine:Stays", "suspended = true")
    )
    done = llfsm.run("run", "robot.toml", "-v")
    assert (done.returncode, done.stdout) == (0, "left 'y' counts 5\nCounter 'x' counts 2\n")
    assert f"left, Counter, Stays on whiteboard {board}\n" in done.stderr
    assert "m  2 s  2 - Stays                - Suspended" in done.stderr
    with Whiteboard(board, create=False) as wb:
        assert wb.get_message(wb.find("out")).data == -1
        assert wb.get_message(wb.find("other")).data == -1


def test_the_command_line_says_more_and_goes_before_the_file(llfsm: Llfsm, board: str) -> None:
    elsewhere = f"{board}-not"
    (llfsm.cwd / "robot.toml").write_text(
        f'board = "{elsewhere}"\non_error = "stop"\n'
        + machine("mine:Counter", "variables = {rounds = 5, label = 'y'}")
        + machine("mine:Broken")
    )
    process = llfsm.start(
        "run", "robot.toml", "Counter:rounds=7", "Counter:out:=mine", "-S", "mine:Stays",
        "--on-error=suspend", "-b", board,
    )  # fmt: skip
    wait_for_line(process, "Counter, Broken, Stays")
    wait_for_line(process, "Counter 'y' counts 7")
    wait_for_line(process, "broken indeed")
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0
    assert not exists(elsewhere)
    with Whiteboard(board, create=False) as wb:
        assert wb.get_message(wb.find("mine")).data == -1


def test_what_a_file_names_is_looked_for_beside_it(llfsm: Llfsm, board: str) -> None:
    robot = llfsm.cwd / "robot"
    write(robot / "parts" / "Arm.machine", "print('the arm of the robot')")
    write(llfsm.cwd / "parts" / "Arm.machine", "print('another arm')")
    write(llfsm.cwd / "Here.machine", "print('here')")
    (robot / "own.py").write_text(MODULE.replace("counts", "counts on"))
    (robot / "robot.toml").write_text(
        machine("parts/Arm") + machine("own:Counter") + machine("Here")
    )
    done = llfsm.run("run", "robot/robot.toml", "-q", "-b", board)
    assert done.stdout == "the arm of the robot\nCounter 'x' counts on 2\nhere\n"
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("[[machine]]\nname = 3", "robot.toml:2: machine[0].name: Expected"),
        ("[[machine]\n", "robot.toml:1: "),
        ("", "robot.toml: it names no [[machine]] to run"),
        (
            machine("mine:Counter", "variables.rounds = 'x'"),
            "Counter: rounds = 'x': Expected `int`",
        ),
        (machine("mine:Counter", "slots.color = 'x'"), "Counter uses no slot 'color'"),
        (machine("mine:Counter", "period_us = 5", "start_us = 5"), "robot.toml:1: machine[0]: "),
    ],
)
def test_a_wrong_file_is_one_clear_error(llfsm: Llfsm, board: str, text: str, printed: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(text)
    done = llfsm.run("run", "robot.toml", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert printed in done.stderr
    assert "Traceback" not in done.stderr


def test_a_file_that_names_what_is_no_machine_is_blamed(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(machine("mine:Nobody", 'name = "n"'))
    done = llfsm.run("run", "robot.toml", "-q", "-b", board)
    assert done.returncode != 0
    assert "robot.toml" in done.stderr
    assert "name:variable=value" not in done.stderr  # nobody has meant to set one


# Dispatch tables


def test_a_dispatch_table(llfsm: Llfsm, board: str) -> None:
    write(llfsm.cwd / "Arm.machine", "print(name, 'here')")
    (llfsm.cwd / "tables").mkdir()
    write(llfsm.cwd / "tables" / "Arm.machine", "print(name, 'there')")
    (llfsm.cwd / "tables" / "table").write_text(
        "Arm.machine\t2000\t900\nmine:Counter\t1000\t900\nmine:Stays\t2000\t900\tS\n\n"
        "1\t0\n0\t100\n2\t200\n1\t1000\n"
    )
    done = llfsm.run("run", "-T", "tables/table", "Counter:rounds=4", "-t", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Counter 'x' counts 4\nArm here\n")
    assert "Arm, Counter, Stays on" in done.stderr
    rows = {line.split()[0]: line.split() for line in done.stderr.splitlines()}
    assert int(rows["Counter"][1]) > 4


def test_a_wrong_dispatch_table_is_one_clear_error(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / "table").write_text("mine:Counter\t1000\t900\n\n0\t0\n1\t100\n")
    done = llfsm.run("run", "-T", "table", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "Error: table:4: there is no machine 1; they are 0 to 0\n"


# What machines are called, what they may load


def test_machines_have_names_of_their_own(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run(
        "run", "a=mine:Counter", "b=mine:Counter", "a:rounds=1", "b:out:=b/out", "b:label=p:q=r",
        "-q", "-b", board,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "a 'x' counts 1\nb 'p:q=r' counts 2\n")
    with Whiteboard(board, create=False) as wb:
        assert wb.get_message(wb.find("out")).data == -1
        assert wb.get_message(wb.find("b/out")).data == -1


def test_the_value_of_a_variable_may_look_like_anything(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "Counter:label=a:=b", "-q", "-b", board)
    assert done.stdout == "Counter 'a:=b' counts 2\n", done.stderr


def test_a_preloaded_machine_is_loaded_by_name(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Loader", "-P", "mine:Late", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Late was loaded\n")
    without = llfsm.run("run", "mine:Loader", "-q", "-b", board)
    assert (without.returncode, without.stdout) == (1, "")
    assert "no machine 'Late'" in without.stderr


# Turns


def test_a_period_and_what_is_late(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Slow", "--period", "1000", "-t", "-q", "-b", board)
    assert done.returncode == 0
    assert re.search(r"Slow: \d of \d turns ended after their deadline, the worst by", done.stderr)


def test_turns_that_were_not_run_are_counted(llfsm: Llfsm, board: str) -> None:
    waits = "class W(Machine):\n    A = State()\n    B = State(final=True)\n    A.to(B, after=2)\n"
    (llfsm.cwd / "waits.py").write_text(f"from llfsm.runtime import Machine, State\n{waits}")
    done = llfsm.run("run", "waits:W", "--period", "5000", "-t", "-q", "-b", board)
    assert done.returncode == 0
    assert re.search(r"\n    \d+ ringlets could change nothing: not run\n", done.stderr)


def test_late_turns_of_a_timetable_are_reported(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(
        machine("mine:Slow", "period_us = 10000", "deadline_us = 1000")
        + machine("mine:Counter", "period_us = 10000", "start_us = 9000", "deadline_us = 900000000")
    )
    done = llfsm.run("run", "robot.toml", "-q", "-b", board)
    assert done.returncode == 0
    late = [line for line in done.stderr.splitlines() if "after their deadline" in line]
    assert [line.split(":")[0] for line in late] == ["Slow"]


def test_timing_reports_each_machine_and_its_states(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Counter", "mine:Slow", "-t", "-q", "-b", board)
    assert done.returncode == 0
    head, *rows = [re.split(r"  +", line.strip()) for line in done.stderr.splitlines()]
    assert head[:4] == ["machine", "ringlets", "fired", "cost us"]
    assert head[4:] == ["jitter us", "late us", "overruns", "worst us"]
    assert [row[0].split()[0] for row in rows] == ["Counter", "COUNT", "DONE", "Slow", "A", "B"]
    assert rows[0][1:3] == ["4", "1"]
    assert rows[0][4:] == ["-", "-", "-", "-"]
    assert float(rows[3][3].split(" / ")[2]) >= 3000


def test_timing_is_reported_after_an_error_too(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("run", "mine:Broken", "-t", "-q", "-b", board)
    assert done.returncode == 1
    assert done.stderr.startswith("machine  ")
    assert "broken indeed" in done.stderr


# How it ends

SCHEDULES = {
    "idle": [],
    "period": ["--period", "5000"],
    "long period": ["--period", "900000000"],
    "file": ["robot.toml"],
    "table": ["-T", "table"],
}


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_a_signal_ends_every_schedule_cleanly(llfsm: Llfsm, board: str, schedule: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(machine("mine:Stays", "period_us = 2000"))
    (llfsm.cwd / "table").write_text("mine:Stays\t2000\t1000\n\n0\t0\n")
    arguments = SCHEDULES[schedule]
    named = [] if schedule in ("file", "table") else ["mine:Stays"]
    process = llfsm.start("run", *named, *arguments, "-q", "-b", board)
    wait_for_line(process, "entered A")
    process.send_signal(signal.SIGTERM)
    rest = process.stdout.read()
    assert process.wait() == 0
    if schedule != "long period":  # its next turn is later than the grace period
        assert "Stays ended well" in rest


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_an_error_in_every_schedule(llfsm: Llfsm, board: str, schedule: str) -> None:
    period = "5000"
    (llfsm.cwd / "robot.toml").write_text(
        machine("mine:Broken", f"period_us = {period}")
        + machine("mine:Counter", f"period_us = {period}")
    )
    (llfsm.cwd / "table").write_text(
        f"mine:Broken\t{period}\t1000\nmine:Counter\t{period}\t1000\n\n0\t0\n1\t0\n"
    )
    arguments = ["--period", period] if schedule == "long period" else SCHEDULES[schedule]
    named = [] if schedule in ("file", "table") else ["mine:Broken", "mine:Counter"]
    done = llfsm.run("run", *named, *arguments, "-q", "-b", board)
    assert done.returncode == 1
    assert "machine Broken, state A, OnEntry: RuntimeError: broken indeed" in done.stderr
    assert "counts" not in done.stdout
    process = llfsm.start("run", *named, *arguments, "--on-error=suspend", "-q", "-b", board)
    wait_for_line(process, "broken indeed")
    wait_for_line(process, "Counter 'x' counts 2")
    process.send_signal(signal.SIGINT)  # it waits for a resume of the one that failed
    assert process.wait() == 0


# What cannot be

USAGE = [
    (["mine:Counter", "robot.toml"], "name one arrangement file or one dispatch table"),
    (["robot.toml", "robot.toml"], "name one arrangement file or one dispatch table"),
    (["robot.toml", "-T", "table"], "name one arrangement file or one dispatch table"),
    (["mine:Counter", "-T", "table"], "name one arrangement file or one dispatch table"),
    (["-T", "nowhere"], "'nowhere' does not exist"),
    (["-T", "."], "is a directory"),
    (["robot.toml", "--period", "5"], "--period: the machines have periods of their own"),
    (["-T", "table", "--period", "5"], "--period: the machines have periods of their own"),
    (["mine:Counter", "--period", "0"], "0 is not in the range"),
    (["-P", "mine:Counter"], "name a machine to run"),
    (["-P", "mine:Nobody", "mine:Counter"], "mine has no 'Nobody'"),
    (["a=Nobody"], "a=Nobody: no machine 'Nobody'"),
    (["a=mine:Counter", "Counter:rounds=1"], "no machine 'Counter'; there are: a"),
    (["a=mine:Counter", "a:color=1"], "a has no variable 'color'"),
    (["a=mine:Counter", "b:out:=c"], "no machine 'b'; there are: a"),
    (["a=mine:Counter", "a:color:=c"], "a uses no slot 'color'; it uses: out"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "printed"), USAGE, ids=[" ".join(case[0]) for case in USAGE])
def test_what_cannot_be_meant_is_a_usage_error(
    llfsm: Llfsm, board: str, arguments: list[str], printed: str
) -> None:
    (llfsm.cwd / "robot.toml").write_text(machine("mine:Counter", "period_us = 5000"))
    (llfsm.cwd / "table").write_text("mine:Counter\t2000\t1000\n\n0\t0\n")
    done = llfsm.run("run", *arguments, "-q", "-b", board)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert printed in done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_not_loaded_cannot_be_told_what_to_do(llfsm: Llfsm, board: str) -> None:
    """It would be dropped without a word."""
    done = llfsm.run(
        "run", "mine:Loader", "-P", "mine:Counter", "-P", "mine:Late", "Counter:rounds=3",
        "-q", "-b", board,
    )  # fmt: skip
    assert done.returncode == 2
