"""`llfsm debug` of a recording: forwards, backwards and into the code, from a prompt."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import record_script
from llfsm.bridges.recording.writer import JournalWriter, RecordingWriter
from llfsm.cli.debug.prompt import AskedPrompt, ReversePrompt
from llfsm.cli.rerun import plan_of_one, reverse_debugging
from llfsm.runtime.testing.scripted import Step
from llfsm.runtime.verification import Member
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32

from .conftest import MACHINES, Llfsm
from .machines import Bouncer

POSE = Slot("pose", Int32)
SCRIPT = [Step(10, {POSE: Int32(data=value)}) for value in (0, 3, 12, 4, 5, 15, 1, 2)]


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a recording of a bouncer that bounces twice; its plan has a copy of its code."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    shutil.copy(MACHINES, tmp_path / "bouncers.py")
    file = tmp_path / "run.mcap"
    plan = {"machine": [{"definition": "bouncers.py:Bouncer"}], "break": ["Bouncer:GO#3"]}
    record_script(file, [Member(Bouncer)], SCRIPT, plan=plan, folder=tmp_path)
    return file


def printed(llfsm: Llfsm, file: Path, *lines: str, options: Any = ("--trust",)) -> list[str]:
    """Return what is printed for lines; times are left out."""
    done = llfsm.run("debug", str(file), *options, entered="\n".join([*lines, "quit\n"]))
    assert done.returncode == 0, done.stderr
    return [line.partition(", at ")[0] for line in done.stdout.replace("llfsm> ", "").splitlines()]


def test_a_recording_is_gone_through_in_both_directions(llfsm: Llfsm, file: Path) -> None:
    assert printed(llfsm, file, "continue", "show variables", "back leave", "back fire", "why") == [
        "start: round 1, Bouncer in GO",
        "breakpoint Bouncer:GO#3: round 8, Bouncer in GO",
        "bounces = 2",
        "back: leave: round 7, Bouncer in STOP",
        "back: transition: round 5, Bouncer in GO",
        "it has left STOP:",
        "  true   -> GO  m.pose.data <= 9  pose.data=4 <= 9",
        "it is in GO, as it would be evaluated now:",
        "  false  -> STOP  m.pose.data > 9  pose.data=4 > 9",
    ]
    assert printed(llfsm, file, "clear", "break @pose if data > 9", "c", "c", "c", "reverse") == [
        "start: round 1, Bouncer in GO",
        *("no breakpoints", "@pose if data > 9"),
        "breakpoint @pose if data > 9: round 4, Bouncer in STOP",
        "breakpoint @pose if data > 9: round 7, Bouncer in STOP",
        "the recording ends here",
        "breakpoint @pose if data > 9: round 7, Bouncer in STOP",
    ]
    moment = "0.030000"
    (_, there, *_) = llfsm.run(
        *("debug", str(file), "--trust"), entered=f"goto {moment}\nquit\n"
    ).stdout.splitlines()
    assert there.startswith("llfsm> goto: round 3, Bouncer in GO, at 0.03")


def test_a_pdb_is_opened_in_a_section(llfsm: Llfsm, file: Path) -> None:
    """In a process of its own, as the tests' tools have ideas of where a pdb reads."""
    lines = [
        *("p self.bounces", "n", "p self.bounces", "step", "show variables", "back"),
        *("goto 0", "pdb", "q", "pdb Bouncer:GO.Internal", "continue", "quit"),
    ]
    done = llfsm.run_apart(
        *("debug", str(file), "--trust", "--pdb", "GO.OnExit"), entered="\n".join([*lines, ""])
    )
    shown = [line.partition(", at ")[0] for line in done.stdout.splitlines()]
    assert shown[1].startswith(f"> {file.with_name('bouncers.py')}(")
    assert shown[2] == "-> self.bounces += 1"
    assert [each for each in shown if each in ("(Pdb) 0", "(Pdb) 1")] == ["(Pdb) 0", "(Pdb) 1"]
    after = [each.rpartition("(Pdb) ")[2] for each in shown if "after " in each]
    assert after == [
        "after OnExit of GO: round 4, Bouncer in STOP",
        "after OnEntry of GO: round 2, Bouncer in GO",
        "after Internal of GO: round 3, Bouncer in GO",
    ]
    assert "llfsm> bounces = 1" in shown
    assert "llfsm> back: turn: round 3, Bouncer in GO" in shown
    assert done.returncode == 0


def test_code_that_has_changed_is_named_where_it_acts_differently(llfsm: Llfsm, file: Path) -> None:
    code = file.with_name("bouncers.py")
    code.write_text(code.read_text().replace("m.pose.data <= 9", "m.pose.data <= 4"))
    shown = printed(llfsm, file, "clear", "continue", "why", "back", "back")
    expected = "from here on the machines do not act as recorded: event "
    assert shown[2].startswith(expected)
    assert any(line.startswith("* label") and "<= 4" in line for line in shown)
    assert "Bouncer saw pose = Int32(data=4)" in shown
    assert "  false  -> STOP  m.pose.data > 9  pose.data=4 > 9" in shown
    assert shown[-2:] == [
        "back: turn: round 4, Bouncer in STOP",
        "back: turn: round 3, Bouncer in GO",
    ]


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("bak", "no command 'bak'; did you mean 'back' or 'break'?"),
        ("post pose {}", "no command 'post'; `help` lists them"),
        ("back over", "no step 'over'; there are: turn, round, fire, leave"),
        ("back", "the recording begins here"),
        ("back leave Bouncr", "no machine 'Bouncr'"),
        ("reverse", "no breakpoint is reached before this moment"),
        ("goto soon", "goto soon: give seconds from the beginning, as 12.5"),
        ("goto nan", "goto nan: give seconds from the beginning, as 12.5"),
        ("goto 1e999", "goto 1e999: give seconds from the beginning, as 12.5"),
        ("pdb GO", "pdb GO: write MACHINE:STATE.SECTION"),
        ("pdb GO.Entry", "with one of the sections OnEntry, OnExit"),
        ("pdb STOP.OnExit", "Bouncer has no code STOP.OnExit; it has: GO.OnEntry"),
        ("pdb Bouncr:GO.OnExit", "no machine 'Bouncr'"),
    ],
)
def test_a_line_that_is_wrong_changes_nothing(
    llfsm: Llfsm, file: Path, line: str, problem: str
) -> None:
    first, second, third = printed(llfsm, file, line, "pause")
    assert problem in second
    assert (first, third) == ("start: round 1, Bouncer in GO",) * 2


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["run.mcap"], "which machines? The recording names bouncers.py:Bouncer in"),
        (
            ["run.mcap", "RosPingPong", "RosPingPong"],
            "the recording has these machines: bouncers.py:B",
        ),
        (["run.mcap", "RosPingPong"], "its machines are Bouncer, not RosPingPong"),
        (["run.mcap", "--trust", "--record", "x.mcap"], "--record is for machines that run"),
        (["run.mcap", "--trust", "-b", "x"], "--board is for machines that run"),
        (["run.mcap", "--trust", "--break", "Bouncer:G"], "no state of Bouncer 'G'"),
        (["run.mcap", "--trust", "--pdb", "GO.X"], "pdb GO.X: write MACHINE:STATE.SECTION"),
        (["RosPingPong", "--pdb", "GO.X"], "--pdb is for a recording: give FILE.mcap first"),
        (["RosPingPong", "--trust"], "--trust is for a recording"),
        (["none.mcap", "--trust"], "none.mcap"),
    ],
)
def test_wrong_use_is_an_error(
    llfsm: Llfsm, file: Path, arguments: list[str], problem: str
) -> None:
    done = llfsm.run("debug", *arguments)
    assert done.returncode
    assert problem in done.stderr


def test_of_several_arrangements_one_is_named(llfsm: Llfsm, file: Path, tmp_path: Path) -> None:
    both, recording = tmp_path / "both.mcap", Recording(file)
    (journal,) = recording.journals
    with RecordingWriter(both, {}) as writer:
        for number, name in enumerate(("Bouncer", "Other")):
            output = JournalWriter(writer, pid=1 + number, session=number, whole=True)
            output.add({"event": "Plan", "plan": PLAN, "folder": str(tmp_path)})
            for entry in recording.entries(journal):
                output.add({**entry, "machine": name} if entry["event"] == "Loaded" else entry)
    done = llfsm.run("debug", str(both), "--trust")
    assert done.returncode
    assert "is of several arrangements: Bouncer; Other: name the machines of one" in done.stderr
    shown = printed(llfsm, both, options=[f"{MACHINES}:Bouncer"])
    assert shown == ["start: round 1, Bouncer in GO"]


PLAN = {"machine": [{"definition": "bouncers.py:Bouncer"}]}


def test_words_are_completed(llfsm: Llfsm, file: Path) -> None:
    recording = Recording(file)
    found = plan_of_one(recording, [f"{MACHINES}:Bouncer"], trust=False)
    with reverse_debugging(recording, *found, ReversePrompt) as client:
        prompt = AskedPrompt(client)
        assert {"back", "goto", "pdb", "step"} <= {*prompt.candidates("")}
        assert prompt.candidates("back ") == ["turn", "round", "fire", "leave"]
        assert prompt.candidates("back leave ") == ["Bouncer"]
        assert {"Bouncer:GO.OnEntry", "Bouncer:GO.Internal"} <= {*prompt.candidates("pdb ")}
