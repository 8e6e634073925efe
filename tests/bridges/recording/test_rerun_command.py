"""`llfsm rerun`: machines that `llfsm run` and `llfsm demo` recorded run again."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.writer import ARRANGEMENT, RecordingWriter
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from waiting import PATIENCE_S, wait_for

from .conftest import end_of, entries_in, keep_journal, write
from .journalled_run import keep, patrol


def turns_in(file: Path) -> int:
    with suppress(FileNotFoundError, RecordingFileError):  # not begun yet
        return sum(entry["event"] == "Turn" for entry in entries_in(Recording(file)))
    return 0


def test_a_demo_that_was_recorded_runs_again(
    llfsm: Any, llfsm_here: Any, board: Whiteboard, file: Path
) -> None:
    llfsm("turtlesim", "-b", board.name)
    machine = llfsm("run", "RosWallTurttleBot", "-q", "-b", board.name, "--record", file)
    bound = board[Slot("turtle1/cmd_vel", Twist)]
    assert bound.wait(after=0, timeout=PATIENCE_S)
    wait_for(lambda: turns_in(file) > 50, "turns in the file")
    machine.terminate()
    assert end_of(machine)[0] == 0
    recording = Recording(file)
    assert recording.complete
    assert {"turtle1/pose", "turtle1/cmd_vel"} <= {*recording.slots}
    status, printed = llfsm_here("rerun", file, "--trust")
    assert (status, printed.split()[-3:]) == (0, ["are", "as", "recorded"])
    status, printed = llfsm_here("rerun", file, "RosWallTurttleBot=RosBlindTurttleBot")
    assert status == 1
    assert printed.startswith(f"Error: {file}: event ")
    status, printed = llfsm_here("rerun", file, "RosBlindTurttleBot")
    assert (status, printed.count("\n")) == (1, 1)
    assert "its machines are RosWallTurttleBot, not RosBlindTurttleBot" in printed


def test_llfsm_demo_records_what_runs_again(llfsm: Any, llfsm_here: Any, file: Path) -> None:
    name = f"test-demo-{os.getpid()}"
    demo = llfsm("demo", "wall", "-b", name, "--record", file)

    def has_pose() -> bool:
        with suppress(FileNotFoundError, RecordingFileError):  # not begun yet
            return "turtle1/pose" in Recording(file).slots
        return False

    wait_for(has_pose, "a pose")
    wait_for(lambda: turns_in(file) > 0, "a turn")  # before, there is nothing to run again
    demo.send_signal(signal.SIGINT)
    assert end_of(demo)[0] == 0
    assert Recording(file).about["board"] == name
    status, printed = llfsm_here("rerun", file, "RosWallTurttleBot")
    assert (status, printed.split()[-3:]) == (0, ["are", "as", "recorded"])


def planned(file: Path, plan: str, folder: Path) -> None:
    """Make a recording whose plan is that text, started in a folder."""
    about = {"session": "1-0", "plan": plan, "folder": str(folder)}
    with RecordingWriter(file, {}) as writer:
        writer.add_metadata(ARRANGEMENT, about)
        keep_journal(writer, patrol().entries)


def test_no_code_runs_that_only_the_file_names(llfsm_here: Any, file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / "evil.py").write_text(
        "import pathlib\npathlib.Path(__file__).with_name('ran').touch()"
    )
    ran = folder / "ran"
    planned(file, '{"machine": [{"definition": "evil:Patrol"}]}', folder)
    status, printed = llfsm_here("rerun", file)
    assert status == 2, printed
    assert f"names evil:Patrol in {folder}" in printed
    assert "--trust" in printed
    status, printed = llfsm_here("rerun", file, "RosPingPong")
    assert (status, ran.exists()) == (1, False)
    status, printed = llfsm_here("rerun", file, "evil:Patrol")
    assert (status, ran.exists()) == (2, False)
    assert "'evil'" in printed
    llfsm_here("rerun", file, "--trust")
    assert ran.exists()


@pytest.mark.parametrize(
    "plan", ["", "[]", '{"machine": 1}', '{"a":' * 9999, '{"machines": [{"x": 1}]}']
)
def test_an_invalid_plan_is_an_error(
    llfsm_here: Any, file: Path, tmp_path: Path, plan: str
) -> None:
    planned(file, plan, tmp_path)
    status, printed = llfsm_here("rerun", file, "--trust")
    assert (status, printed.count("\n")) == (1, 1)
    assert "its plan of machines is invalid" in printed


@pytest.mark.parametrize(
    ("make", "arguments", "why"),
    [
        (lambda file: write(file, []), [], "holds no events of machines"),
        (lambda file: keep(patrol(), file), [], "has no plan of its machines"),
        (lambda file: file.write_text("?"), [], "is not a recording of llfsm"),
    ],
)
def test_wrong_use_is_one_line(
    llfsm_here: Any, file: Path, make: Any, arguments: list[str], why: str
) -> None:
    make(file)
    status, printed = llfsm_here("rerun", file, "--trust", *arguments)
    assert (status, printed.count("\n")) == (1, 1)
    assert why in printed
