"""`llfsm up`: processes start in order, are watched, and end as one, however that comes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

from waiting import PATIENCE_S, wait_for

from .conftest import Llfsm, alive

PYTHON = sys.executable
LAMP = """
from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

class Lamp(Machine):
    light = Actuator(Slot("light", Bool), at_end=Bool())
    on = State(final=False)

    @on.on_entry
    def _(self) -> None:
        self.light(Bool(data=True))
"""
STUBBORN = "import signal,time;[signal.signal(n,signal.SIG_IGN) for n in (2,15)];print('deaf');"


def python(code: str) -> str:
    """Write a command that runs Python's code, in TOML."""
    return f"command = {[PYTHON, '-u', '-c', code]!r}"


def write(folder: Path, *processes: str, head: str = "") -> None:
    tables = "".join(f"[[process]]\n{dedent(each).strip()}\n" for each in processes)
    (folder / "robot.toml").write_text(f"{head}\n{tables}")


def up(llfsm: Llfsm, *options: str) -> subprocess.CompletedProcess[str]:
    return llfsm.run_apart("up", "robot.toml", *options)


def pids(text: str) -> list[int]:
    return [int(number) for number in re.findall(r"starts \((\d+)\)", text)]


def until(process: subprocess.Popen[str], text: str) -> str:
    """Return what it prints up to a line with `text`."""
    printed = ""
    while text not in printed:
        line = process.stdout.readline()
        assert line, f"{text!r} was never printed, but:\n{printed}"
        printed += line
    return printed


def sleeping(name: str, more: str = "") -> str:
    return f"name = '{name}'\n{python('import time; print(1); time.sleep(999)')}\n{more}"


def test_what_others_wait_for_comes_first_and_ends_last(llfsm: Llfsm, board: str) -> None:
    (llfsm.cwd / "lamp.py").write_text(LAMP)
    write(
        llfsm.cwd,
        "name = 'watch'\nafter = ['lamp']\ncommand = 'llfsm whiteboard watch light'",
        "name = 'lamp'\ncommand = 'llfsm run lamp:Lamp'",
        head=f"board = '{board}'",
    )
    process = llfsm.start("up", "robot.toml")
    before = until(process, 'watch | light 1 {"data": true}')
    process.send_signal(signal.SIGINT)
    rest = process.stdout.read()
    assert process.wait() == 0
    printed = before + rest
    assert printed.index("lamp starts") < printed.index("watch starts")
    assert rest.index("watch ended") < rest.index("lamp ended")
    assert not any(map(alive, pids(printed)))


def test_each_line_has_its_process_also_in_files(llfsm: Llfsm) -> None:
    write(
        llfsm.cwd,
        f"name = 'one'\n{python('print(1); print(2, end=str())')}",
        f"name = 'other'\nafter = ['one']\n{python('import sys; print(3, file=sys.stderr)')}",
    )
    for _ in range(2):  # files are added to
        done = up(llfsm, "--log-dir", "logs")
        assert done.returncode == 0
        assert sorted(done.stdout.splitlines()) == ["one   | 1", "one   | 2", "other | 3"]
    lines = (llfsm.cwd / "logs" / "one.log").read_text().splitlines()
    assert [line.split(" ", 1)[1] for line in lines] == ["1", "2", "1", "2"]
    assert re.match(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3} ", lines[0])


def test_one_that_waits_for_a_text(llfsm: Llfsm) -> None:
    slow = "import time; time.sleep(.2); print('now it is ready'); time.sleep(.2); print('end')"
    write(
        llfsm.cwd,
        f"name = 'slow'\nready = 'is ready'\n{python(slow)}",
        f"name = 'next'\nafter = ['slow']\n{python('print(4)')}",
    )
    shown = up(llfsm).stdout.splitlines()
    assert shown.index("slow | now it is ready") < shown.index("next | 4")
    assert shown.index("next | 4") < shown.index("slow | end")


def test_one_that_fails_ends_all(llfsm: Llfsm) -> None:
    write(llfsm.cwd, sleeping("long"), f"name = 'bad'\n{python('raise SystemExit(3)')}")
    done = up(llfsm)
    assert done.returncode == 1
    assert "bad ended (3)\nall end, as bad is essential\n" in done.stderr
    assert "long was killed by SIGINT" in done.stderr or "long ended" in done.stderr
    assert not any(map(alive, pids(done.stderr)))


def test_others_go_on_without_one_that_is_not_essential(llfsm: Llfsm) -> None:
    more = "essential = false\nready = 'it is'\n"
    write(
        llfsm.cwd,
        f"name = 'bad'\n{more}{python('raise SystemExit(3)')}",
        f"name = 'good'\n{python('import time; time.sleep(.3); print(5)')}",
        f"name = 'never'\nafter = ['bad']\n{more}{python('print(6)')}",
    )
    done = up(llfsm)
    assert done.returncode == 1
    assert done.stdout == "good  | 5\n"
    assert "never is not started, as bad has failed" in done.stderr


def test_one_that_fails_starts_again_after_a_while(llfsm: Llfsm) -> None:
    code = (
        "import os,sys; n=len(os.listdir('tries')); open(f'tries/{n}','w'); print(n); sys.exit(n<2)"
    )
    (llfsm.cwd / "tries").mkdir()
    write(llfsm.cwd, f"name = 'flaky'\nrestart = 'on-failure'\n{python(code)}")
    done = up(llfsm)
    assert done.returncode == 0
    assert done.stdout == "flaky | 0\nflaky | 1\nflaky | 2\n"
    assert "it starts again in 1 s" in done.stderr
    assert "it starts again in 2 s" in done.stderr


def test_one_that_always_starts_again_does_so_when_it_is_killed(llfsm: Llfsm) -> None:
    write(llfsm.cwd, sleeping("long", "restart = 'always'"))
    process = llfsm.start("up", "robot.toml")
    (first,) = pids(until(process, "long | 1"))
    os.kill(first, signal.SIGKILL)
    printed = until(process, "long | 1")
    assert "long was killed by SIGKILL; it starts again in 1 s" in printed
    process.send_signal(signal.SIGINT)
    process.stdout.read()
    assert process.wait() == 0


def test_one_that_hears_nothing_is_killed(llfsm: Llfsm) -> None:
    write(
        llfsm.cwd,
        f"name = 'deaf'\n{python(STUBBORN + 'time.sleep(999)')}",
        head="grace_s = 0.1",
    )
    process = llfsm.start("up", "robot.toml")
    printed = until(process, "deaf | deaf")
    process.send_signal(signal.SIGINT)
    printed += process.stdout.read()
    assert process.wait() == 0
    assert "deaf goes on after SIGINT\ndeaf goes on after SIGTERM\ndeaf was killed by" in printed


def test_a_second_ctrl_c_kills(llfsm: Llfsm) -> None:
    write(
        llfsm.cwd,
        f"name = 'deaf'\n{python(STUBBORN + 'time.sleep(999)')}",
        head=f"grace_s = {10 * PATIENCE_S}",
    )
    process = llfsm.start("up", "robot.toml")
    (pid,) = pids(until(process, "deaf | deaf"))
    process.send_signal(signal.SIGINT)
    until(process, "all end; a second Ctrl-C kills them")
    process.send_signal(signal.SIGINT)
    assert "deaf was killed by SIGKILL" in process.stdout.read()
    assert process.wait() == 0
    assert not alive(pid)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of a parent's end")
def test_all_end_when_it_is_killed_itself(llfsm: Llfsm) -> None:
    write(llfsm.cwd, sleeping("one"), sleeping("other"))
    process = llfsm.start("up", "robot.toml")
    started = pids(until(process, "other | 1"))
    process.kill()
    wait_for(lambda: not any(map(alive, started)), "the end of all")


def test_what_a_process_leaves_behind_is_ended(llfsm: Llfsm) -> None:
    write(llfsm.cwd, "name = 'shell'\ncommand = ['sh', '-c', 'sleep 999 & echo $!; exit 0']")
    done = up(llfsm)
    assert done.returncode == 0
    left = int(done.stdout.removeprefix("shell | "))
    wait_for(lambda: not alive(left), "the end of what is left")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "robot.toml: it names no [[process]] to start"),
        ("[[process]]\nname = 'a'\n", "missing required field `command`"),
        ("[[process]]\nname = ''\ncommand = 'a'\n", "robot.toml:2: process[0].name: each process"),
        ("[[process]]\nname = 'a'\ncommand = ''\n", "robot.toml:3: process[0].command: is no"),
        ("[[process]]\nname = 'a'\ncommand = \"'\"\n", "is no command: No closing quotation"),
        ("[[process]]\nname = 'a'\ncomand = 'a'\n", "there is no key 'comand' here; did you mean"),
        (
            "[[process]]\nname = 'abc'\ncommand = 'a'\nafter = ['abd']\n",
            "process 'abc' starts after 'abd', which is none; did you mean 'abc'?",
        ),
        (
            "[[process]]\nname = 'a'\ncommand = 'a'\nafter = ['a']\n",
            "processes wait for each other: a",
        ),
        ("[[process]]\nname = 'a'\ncommand = 'no-such-program'\n", "a cannot be started: No such"),
    ],
)
def test_a_wrong_file_is_an_error(llfsm: Llfsm, text: str, error: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(text)
    done = up(llfsm)
    assert done.returncode == 1
    assert error in done.stderr


def test_two_files_are_one_system(llfsm: Llfsm) -> None:
    write(llfsm.cwd, f"name = 'one'\n{python('print(1)')}")
    other = f"[[process]]\nname = 'other'\nafter = ['one']\n{python('print(2)')}\n"
    (llfsm.cwd / "other.toml").write_text(other)
    done = llfsm.run_apart("up", "other.toml", "robot.toml")
    assert sorted(done.stdout.splitlines()) == ["one   | 1", "other | 2"]
    assert done.stderr.index("one starts") < done.stderr.index("other starts")
    done = llfsm.run_apart("up", "other.toml", "other.toml")
    assert "'other' is the name of a process of another file" in done.stderr


MACHINES = """
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool, Int32

class Reader(Machine):
    light = Sensor(Slot("ligth", Bool), default=Bool())
    look, done = State(), State()
    look.to(done, when=lambda self: self.light.data)

    @done.on_entry
    def _(self) -> None:
        self.suspend("Lamp")

class Other(Machine):
    light = Actuator(Slot("light", Bool), at_end=Bool())
    glow = State(suspend=False)

class Number(Machine):
    light = Actuator(Slot("light", Int32), at_end=Int32())
    count = State()
"""


def checked(llfsm: Llfsm, *commands: str) -> tuple[int, str]:
    (llfsm.cwd / "lamp.py").write_text(LAMP)
    (llfsm.cwd / "more.py").write_text(MACHINES)
    (llfsm.cwd / "reader.toml").write_text("[[machine]]\ndefinition = 'more:Reader'\n")
    write(llfsm.cwd, *(f"name = 'p{n}'\ncommand = '{each}'" for n, each in enumerate(commands)))
    done = llfsm.run("check", "robot.toml")
    return done.returncode, done.stdout


def test_check_finds_what_is_wrong_with_its_machines_together(llfsm: Llfsm) -> None:
    commands = "llfsm run lamp:Lamp", "llfsm run reader.toml", "llfsm run more:Other -q"
    assert checked(llfsm, *commands) == (
        0,
        "robot.toml:1: warning: Lamp and Other post to 'light'; is only one of them to run at a "
        "time?\nrobot.toml:1: warning: Reader reads 'ligth' and Lamp posts to 'light': one is "
        "misspelt?\n",
    )
    apart = "llfsm run lamp:Lamp -b one", "llfsm run more:Other --board=other", "no-llfsm run"
    assert checked(llfsm, *apart) == (0, "no findings\n")
    alone = "llfsm run reader.toml", "llfsm run more:Other"
    assert "no machine 'Lamp' in the arrangement" in checked(llfsm, *alone)[1]


def test_check_finds_a_slot_of_two_types_and_commands_that_are_wrong(llfsm: Llfsm) -> None:
    status, text = checked(llfsm, "llfsm run lamp:Lamp", "llfsm run more:Number")
    assert status == 1
    assert "robot.toml:1: error: p1: slot 'light' holds std_msgs/msg/Bool" in text
    status, text = checked(llfsm, "llfsm run lamp:Lamp", "llfsm run more:None", "llfsm run --no")
    assert status == 1
    assert "robot.toml:5: error: p1: more:None: more has no 'None'" in text
    assert "robot.toml:8: error: p2: No such option '--no'" in text


def test_check_explains_no_whole_system(llfsm: Llfsm) -> None:
    checked(llfsm, "llfsm run lamp:Lamp")
    done = llfsm.run("check", "--explain", "robot.toml")
    assert done.returncode == 2
    assert "robot.toml starts processes: name their machines for --types" in done.stderr
