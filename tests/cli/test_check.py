"""`llfsm check`: one line a finding, and a status."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import Llfsm

GOOD = """\
from llfsm.runtime import Machine, State
class Good(Machine):
    A = State()
    B = State()
    A.to(B)
"""


def bundle(folder: Path, entry: str) -> None:
    folder.mkdir()
    (folder / "Language").write_text("python")
    (folder / "States").write_text("A")
    (folder / "State_A_OnEntry.py").write_text(entry)


def test_machines_without_findings(llfsm: Llfsm) -> None:
    (llfsm.cwd / "good.py").write_text(GOOD)
    bundle(llfsm.cwd / "M.machine", "print(name)")
    done = llfsm.run("check", "good:Good", "M", "RosWallTurttleBot")
    assert (done.returncode, done.stdout, done.stderr) == (0, "no findings\n", "")


def test_warnings_alone_are_no_failure(llfsm: Llfsm) -> None:
    (llfsm.cwd / "lonely.py").write_text(GOOD + "    C = State()\n")
    done = llfsm.run("check", "lonely:Good")
    printed = "lonely.py:6: warning: no transitions lead to state 'C'\n"
    assert (done.returncode, done.stdout, done.stderr) == (0, printed, "")


def test_findings_of_all_machines_are_sorted_and_reported_once(llfsm: Llfsm) -> None:
    bundle(llfsm.cwd / "N.machine", "one\n" * 10)
    bundle(llfsm.cwd / "M.machine", "two")
    done = llfsm.run("check", "N", "M", "N.machine")
    lines = ["M.machine/State_A_OnEntry.py:1: error: nothing is called 'two'"]
    lines += [
        f"N.machine/State_A_OnEntry.py:{line}: error: nothing is called 'one'"
        for line in range(1, 11)
    ]
    assert (done.returncode, done.stdout.splitlines(), done.stderr) == (1, lines, "")


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        (GOOD + "    A.to(A)\n", "bad.py:2: error: DefinitionError: Good, state 'A': the tran"),
        (
            GOOD + "    def suspend(self): ...\n",
            "bad.py:2: error: DefinitionError: Good: 'suspend'",
        ),
        (GOOD + "    A.to(nowhere)\n", "bad.py:6: error: NameError: name 'nowhere' is not defined"),
        (GOOD + "    (\n", "bad.py:6: error: SyntaxError: '(' was never closed"),
        (GOOD + "    @A.on_enter\n    def _(self): ...\n", "bad.py:6: error: AttributeError: "),
        (
            "from llfsm.whiteboard import Message\nclass Bad(Message):\n    names: list[str]\n",
            "bad.py:2: error: MessageTypeError: ",
        ),
        ("import nothing_like_it", "bad.py:1: error: ModuleNotFoundError: No module named 'noth"),
    ],
)
def test_a_module_that_cannot_be_imported(llfsm: Llfsm, text: str, printed: str) -> None:
    (llfsm.cwd / "bad.py").write_text(text)
    done = llfsm.run("check", "bad:Good", "RosPingPong")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.startswith(printed)
    assert done.stdout.count("\n") == 1


def test_a_bundle_may_import_modules_of_the_current_folder(llfsm: Llfsm, board: str) -> None:
    """As a class may, though `llfsm` is a script in a folder of its own."""
    (llfsm.cwd / "rover.py").write_text("SPEED = 2\n")
    bundle(llfsm.cwd / "Docker.machine", "print(SPEED)")
    (llfsm.cwd / "Docker.machine" / "Docker_Includes.py").write_text("from rover import SPEED\n")
    script = Path(sys.executable).with_name("llfsm")
    for command, printed in (("check", "no findings\n"), ("run", "2\n")):
        arguments = [script, command, "Docker", *(["-q", "-b", board] if command == "run" else [])]
        done = subprocess.run(arguments, cwd=llfsm.cwd, text=True, capture_output=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (0, printed, "")


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        ([], "Missing argument 'MACHINE...'"),
        (["Nobody"], "no machine 'Nobody'; those that ship: "),
        (["nowhere:M"], "there is no module 'nowhere'"),
    ],
)
def test_wrong_usage(llfsm: Llfsm, arguments: list[str], printed: str) -> None:
    done = llfsm.run("check", *arguments)
    assert done.returncode == 2
    assert printed in done.stderr
    assert "Traceback" not in done.stderr


WAITING = """\
from llfsm.runtime import Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32
import random
class Waits(Machine):
    level = Sensor(Slot("level", Int32))
    A = State()
    Long = State()
    C = State(final=True)
    A.to(Long, when=lambda self: self.level is not None)
    A.to(Long, after=2.5)
    Long.to(C, when=lambda self: random.random() > 0.5)
class Outer(Machine):
    GO = State(runs=Waits)
    ON = State()
    OVER = State(final=False)
    GO.to(ON, when_done=True)
    ON.to(OVER)
"""


def test_what_states_wait_for_is_explained(llfsm: Llfsm) -> None:
    (llfsm.cwd / "waits.py").write_text(WAITING)
    (llfsm.cwd / "robot.toml").write_text('[[machine]]\ndefinition = "waits.py:Waits"\n')
    bundle(llfsm.cwd / "M.machine", "print(name)")
    expected = (
        "no findings\n"
        "Waits\n"
        "  A     waits for level or 2.5 s\n"
        "  Long  is polled: random.random, in the guard to C\n"
        "  C     is final\n"
    )
    for machine in ("waits.py:Waits", "robot.toml"):
        done = llfsm.run("check", "--explain", machine)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.endswith(expected.partition("\n")[2])
    done = llfsm.run("check", "--explain", "M")
    assert done.stdout == "no findings\nM\n  A  is final\n"
    done = llfsm.run("check", "--explain", "waits.py:Outer")
    assert done.stdout.endswith(
        "Outer\n"
        "  GO    waits for the end of what it runs\n"
        "  ON    goes on at once\n"
        "  OVER  waits for requests\n"
    )


def test_what_has_errors_is_not_explained(llfsm: Llfsm) -> None:
    (llfsm.cwd / "waits.py").write_text(WAITING.replace("A.to(Long, after", "A.to(Lang, after"))
    done = llfsm.run("check", "--explain", "waits.py:Waits")
    assert done.returncode == 1
    assert "is polled" not in done.stdout
