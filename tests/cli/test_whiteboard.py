"""`llfsm whiteboard` as people type it."""

from __future__ import annotations

import json
import math
import re
import threading
from collections.abc import Iterator

import pytest

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.llfsm import (
    HOSTS,
    MIRROR,
    HostHeard,
    Hosts,
    HostSummary,
    MirrorStatus,
    summary_slot,
)
from llfsm.whiteboard.slot_names import KEEPS_READ
from waiting import wait_for

from .conftest import Llfsm, exists, wait_for_line

CMD_VEL = Slot("turtle1/cmd_vel", Twist)


def test_list_names_boards_and_slots(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        assert f"{board}  in use" in llfsm.run("whiteboard", "list").stdout
        wb.add_message(CMD_VEL, Twist())
        _ = wb[Slot("turtle1" + KEEPS_READ, Twist)]  # as who shows another host has it
    assert f"{board}  not in use" in llfsm.run("whiteboard", "list").stdout
    listed = llfsm.run("whiteboard", "list", board).stdout
    assert listed.startswith("turtle1/cmd_vel  geometry_msgs/msg/Twist  1 added")
    assert len(listed.splitlines()) == 1
    assert "turtle1/cmd_vel  " in llfsm.run("whiteboard", "list", "-b", board).stdout
    both = llfsm.run("whiteboard", "list", board, "-b", "other")
    assert (both.returncode, "name one" in both.stderr) == (2, True)


def test_get_prints_json(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(CMD_VEL, Twist(Vector3(x=1.5)))
    done = llfsm.run("whiteboard", "get", "turtle1/cmd_vel", "-b", board)
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    assert json.loads(done.stdout) == {"linear": zero | {"x": 1.5}, "angular": zero}


def test_json_for_programs_has_nothing_that_is_no_json(llfsm: Llfsm, board: str) -> None:
    def none(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    odd = Twist(Vector3(x=math.nan, y=math.inf, z=-math.inf))
    with Whiteboard(board) as wb:
        wb.add_message(CMD_VEL, odd)
        expected = {
            "linear": {"x": None, "y": None, "z": None},
            "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
        }
        got = llfsm.run("whiteboard", "get", CMD_VEL.name, "--json", "-b", board).stdout
        assert json.loads(got, parse_constant=none) == expected
        watched = llfsm.run("whiteboard", "watch", "--json", "-n", "1", "-b", board).stdout
        row = {"slot": CMD_VEL.name, "count": 1, "message": expected}
        assert json.loads(watched, parse_constant=none) == row
    assert "NaN" in llfsm.run("whiteboard", "get", CMD_VEL.name, "-b", board).stdout


def test_add_to_a_slot_of_another_process(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        slot = wb[CMD_VEL]
        done = llfsm.run("whiteboard", "add", CMD_VEL.name, '{"linear": {"x": 2}}', "-b", board)
        assert done.returncode == 0
        assert slot.get() == Twist(Vector3(x=2.0))


def test_add_makes_a_slot_of_a_shipped_type(llfsm: Llfsm, board: str) -> None:
    text = '{"data": "höllo"}'
    done = llfsm.run("whiteboard", "add", "say", text, "--type", "std_msgs/String", "-b", board)
    assert done.returncode == 0
    assert llfsm.run("whiteboard", "get", "say", "-b", board).stdout == '{"data": "höllo"}\n'


def test_watch_prints_changes(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(CMD_VEL, Twist())
        process = llfsm.start("whiteboard", "watch", "-n", "2", "-b", board)
        wait_for_line(process, "turtle1/cmd_vel 1 ")
        wb.add_message(CMD_VEL, Twist(Vector3(x=3.0)))
        assert '"x": 3.0' in wait_for_line(process, "turtle1/cmd_vel 2 ")
        assert process.wait() == 0


def test_watch_ends_with_the_board(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(CMD_VEL, Twist())
        process = llfsm.start("whiteboard", "watch", "-b", board)
        wait_for_line(process, "turtle1/cmd_vel 1 ")
        wb.remove()
        assert "was removed" in wait_for_line(process, "was removed")
        assert process.wait() == 1


def test_rm_refuses_a_board_in_use_unless_forced(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        refused = llfsm.run("whiteboard", "rm", board)
        assert refused.returncode == 1
        assert "in use" in refused.stderr
        assert wb.alive
        assert llfsm.run("whiteboard", "rm", "-f", board).returncode == 0
        assert not wb.alive
    assert not exists(board)


def test_rm_removes_a_damaged_board(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        path = wb.path
    path.write_bytes(b"LLWBOARD and then nothing")
    assert "damaged" in llfsm.run("whiteboard", "list", board).stderr
    assert llfsm.run("whiteboard", "rm", board).returncode == 0
    assert not path.exists()


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (["get", "nothing"], "has no slot 'nothing'; its slots: turtle1/cmd_vel"),
        (["get", "turtle1/cmd_vel"], "nothing was added"),
        (["add", "turtle1/cmd_vel", "{"], "slot 'turtle1/cmd_vel': invalid message"),
        (["add", "turtle1/cmd_vel", "[]"], "slot 'turtle1/cmd_vel': invalid message"),
        (["add", "turtle1/cmd_vel", '{"speed": 1}'], "has no field 'speed'; it has linear"),
        (["add", "turtle1/cmd_vel", '{"linear": {"x": "a"}}'], "linear.x"),
        (["add", "new", "{}"], "has no slot 'new'"),
        (["add", "new", "{}", "--type", "std_msgs/Nothing"], "no message type 'std_msgs/Nothing'"),
        (["add", "new", "{}", "--type", "json:JSONDecoder"], "is not a Message class"),
        (["add", "turtle1/cmd_vel", "{}", "--type", "std_msgs/String"], "holds geometry_msgs"),
        (["watch", "nothing"], "has no slot 'nothing'"),
    ],
)  # fmt: skip
def test_bad_input_is_one_clear_error(
    llfsm: Llfsm, board: str, arguments: list[str], printed: str
) -> None:
    with Whiteboard(board) as wb:
        slot = wb[CMD_VEL]
        done = llfsm.run("whiteboard", *arguments, "-b", board)
        assert done.returncode == 1
        assert printed in done.stderr
        assert "Traceback" not in done.stderr
        assert slot.count == 0


@pytest.mark.parametrize("arguments", [["list"], ["get", "x", "-b"], ["watch", "-b"], ["rm"]])
def test_a_board_that_is_not_there(llfsm: Llfsm, board: str, arguments: list[str]) -> None:
    done = llfsm.run("whiteboard", *arguments, board)
    assert done.returncode == 1
    assert "no such whiteboard" in done.stderr
    assert not exists(board)


@pytest.fixture
def fleet(board: str) -> Iterator[Whiteboard]:
    """A board of robot1, whose daemon is this process, and which has lost robot3."""
    hears = {
        "": ("id1", [HostHeard("id2", "vm", 0.1, 0.4, 0), HostHeard("id3", "vm", 7.2, 0.4, 5)]),
        "robot2": (
            "id2",
            [HostHeard("id1", "vm", 0.1, 12.34, 0), HostHeard("id9", "lab", 0, 1, 0)],
        ),
    }
    ended = threading.Event()
    with Whiteboard(board) as wb:
        wb.add_message(summary_slot("robot3"), HostSummary(host="id3"))

        def publish() -> None:
            while not ended.is_set():
                wb.add_message(MIRROR, MirrorStatus(name="robot1", fleet=("robot*",)))
                wb.add_message(HOSTS, Hosts(("robot1", "robot2")))
                for host, (identity, heard) in hears.items():
                    wb.add_message(
                        summary_slot(host), HostSummary(host=identity, hears=tuple(heard))
                    )
                ended.wait(0.05)

        thread = threading.Thread(target=publish)
        thread.start()
        wait_for(lambda: wb.get_message(HOSTS))
        yield wb
        ended.set()
        thread.join()


def test_the_fleet_is_a_table_of_who_hears_whom(llfsm: Llfsm, fleet: Whiteboard) -> None:
    printed = llfsm.run("whiteboard", "status", "--fleet", "-b", fleet.name).stdout.splitlines()
    assert [line.split() for line in printed[:3]] == [
        ["HOST", "robot1", "robot2", "robot3", "lab"],
        ["robot1", ".", "0.4", "ms", "silent", "7", "s", "-"],
        ["robot2", "12.3", "ms", ".", "-", "1.0", "ms"],
    ]
    assert re.fullmatch(r"robot3 +- +- +\. +- +lost for \d+ s", printed[3])
    rows = json.loads(
        llfsm.run("whiteboard", "status", "--fleet", "--json", "-b", fleet.name).stdout
    )
    assert {name: row["lost"] for name, row in rows.items()} == {
        "robot1": False, "robot2": False, "robot3": True,
    }  # fmt: skip
    assert rows["robot1"]["hears"]["robot3"]["silent_s"] == 7.2


def test_a_host_without_a_name_has_no_fleet(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(MIRROR, MirrorStatus())
        done = llfsm.run("whiteboard", "status", "--fleet", "-b", board)
    assert (done.returncode, "with --as" in done.stderr) == (1, True)
