"""`llfsm show` and `llfsm import` as people type them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .conftest import Llfsm

LAMP = Path(__file__).parents[1] / "data" / "bundles" / "Lamp.machine"


def test_a_class(llfsm: Llfsm) -> None:
    (llfsm.cwd / "mine.py").write_text(
        "from llfsm.runtime import *\n"
        "class M(Machine):\n"
        "    n: int = 3\n"
        "    A = State()\n"
        "    Suspend = State()\n"
        "    @A.on_entry\n"
        "    def _(self) -> None:\n"
        '        """Not shown."""\n'
        "        self.n += 1\n"
        "        self.n += 2\n"
        "    A.to(A, after_ms=5)\n"
    )
    done = llfsm.run("show", "mine:M")
    assert (done.returncode, done.stdout.splitlines()) == (
        0,
        [
            "M: 2 states, class mine:M",
            "  n: int = 3",
            "",
            "A (initial)",
            "  OnEntry   self.n += 1  (and 1 more)",
            "  -> A  after_ms(5)",
            "",
            "Suspend (suspend, accepting)",
        ],
    )


def test_a_machine_that_ships(llfsm: Llfsm) -> None:
    shown = llfsm.run("show", "RosWallTurttleBot").stdout
    assert "  asked = Sensor('turtle_position/request', TurtlePositionRequest)" in shown
    assert "  drive = Actuator('turtle1/cmd_vel', Twist)" in shown
    assert "  -> TEST  after_ms(1000) and answered" in shown


def test_a_bundle_of_cpp(llfsm: Llfsm) -> None:
    assert llfsm.run("show", str(LAMP)).stdout.splitlines() == [
        "Lamp: 6 states, bundle of objc++",
        "  int count; ///< times switched on",
        "  int limit = 3; ///<",
        "  bool broken; ///< whether it is",
        "  Status_t lamp_status; ///< what the lamp says",
        "",
        "InitialPseudoState (initial)",
        "  -> Off  true",
        "",
        "Off",
        "  OnEntry   count = 0;  (and 1 more)",
        "  OnResume  lamp(false);",
        "  -> On    after_ms(500) && !broken",
        "  -> Done  broken",
        "",
        "On",
        "  double since; ///< when",
        "  OnEntry   using namespace std;  (and 1 more)",
        "  -> Off   after(0.5)",
        "  -> Done  count >= limit - 1 || broken",
        "",
        "Suspend (suspend, accepting)",
        "",
        "Done (accepting)",
        "  OnEntry   // nothing to do",
        "",
        "Done_Suspending",
        "  -> Done  lamp_status.get().isOff()",
    ]


def test_what_cannot_be_shown(llfsm: Llfsm) -> None:
    done = llfsm.run("show", "Nobody")
    assert done.returncode == 2
    assert "no machine 'Nobody'" in done.stderr
    (llfsm.cwd / "X.machine").mkdir()
    done = llfsm.run("show", "X")
    assert done.returncode == 1
    assert "X.machine: not a bundle: there is no file States" in done.stderr


def test_import_and_then_show_and_run(llfsm: Llfsm, board: str) -> None:
    shutil.copytree(LAMP, llfsm.cwd / "cpp" / "Lamp.machine")
    done = llfsm.run("import", "cpp/Lamp.machine")
    folder = llfsm.cwd / "Lamp.machine"
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        "wrote Lamp.machine",
        "5 to translate by hand before it runs:",
        f"  {folder}/Lamp_Variables.py:4",
        f"  {folder}/State_Off_OnEntry.py:1",
        f"  {folder}/State_Off_OnResume.py:1",
        f"  {folder}/State_On_OnEntry.py:1",
        f"  {folder}/State_Done_Suspending_Transition_0.expr:1",
    ]
    assert llfsm.run("show", "Lamp").stdout.startswith("Lamp: 6 states, bundle of python\n")
    refused = llfsm.run("run", "Lamp", "-b", board)
    assert refused.returncode == 1
    assert f"{folder}/Lamp_Variables.py:4: this C++ is not translated yet" in refused.stderr
    again = llfsm.run("import", "cpp/Lamp.machine")
    assert (again.returncode, again.stdout) == (1, "")
    assert "it is there already" in again.stderr
    assert llfsm.run("import", "cpp/Lamp.machine", "-f").returncode == 0
    assert llfsm.run("import", "cpp/Lamp.machine", "-o", "deep/er").returncode == 0
    assert (llfsm.cwd / "deep" / "er" / "Lamp.machine" / "States").exists()


@pytest.mark.parametrize(
    ("argument", "status", "printed"),
    [("Nowhere.machine", 2, "does not exist"), ("Lamp.machine", 1, "already a Python bundle")],
)
def test_what_cannot_be_imported(llfsm: Llfsm, argument: str, status: int, printed: str) -> None:
    assert llfsm.run("import", str(LAMP)).returncode == 0
    done = llfsm.run("import", argument)
    assert done.returncode == status
    assert printed in done.stderr
    assert "Traceback" not in done.stderr
