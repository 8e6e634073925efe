"""`llfsm view --fleet` with real daemons: what it shows, and that it reads nothing else."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from forked import Forked
from llfsm.whiteboard.messages.llfsm import HOSTS, status_slot, summary_slot, variables_slot
from mirrored_hosts import LLFSM, Host, hosts_in, number_slot
from waiting import wait_for

from .fleets import MACHINES, FleetServer, Window, start_daemons

Start = Callable[..., Any]

POSE, THEIRS = number_slot("arm/angle"), number_slot("robot7/arm/angle")


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[dict[str, Host]]:
    """Two robots, one with a machine, and an operator."""
    with hosts_in(tmp_path) as make_host:
        hosts = start_daemons(make_host, "robot7", "robot8")
        robot = hosts["robot7"]
        robot.add(1, POSE)
        command = [*LLFSM, "run", f"{MACHINES}:Counts", "-q", *robot.select]
        with Forked(command, text=True, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "Counts entered A\n"
            yield hosts
            process.kill()


def read_of_others(operator: Host) -> set[str]:
    """Return what is read of robots on the operator's board, and which hosts there are."""
    return {n for n in operator.board.read_slots() if "robot" in n or n == HOSTS.name}


TABLE = {HOSTS.name, *(summary_slot(name).name for name in ("robot7", "robot8"))}


def test_a_host_is_read_while_its_page_is_open(hosts: dict[str, Host], start: Start) -> None:
    """Of all hosts, the summaries are, while the page of the fleet is."""
    operator = hosts["operator"]
    server = start(FleetServer, operator)
    assert read_of_others(operator) == set(), "no page is open"
    with server.live() as socket:
        fleet = Window(socket)
        well = {"operator": "", "robot7": "", "robot8": ""}
        wait_for(lambda: fleet.troubles() == well, "all hosts", between=fleet.receive)
        wait_for(lambda: fleet.hosts["robot7"]["summary"]["machines"] == 1, between=fleet.receive)
        wait_for(lambda: fleet.hosts["robot8"]["lead"] is not None, between=fleet.receive)
        assert [fleet.hosts[name]["own"] for name in well] == [True, False, False]
        wait_for(lambda: fleet.hosts["robot7"]["summary"]["sent_rate"], between=fleet.receive)
        assert read_of_others(operator) == TABLE
        on_board = {info.name for info in operator.board.slots()}
        assert not {status_slot("robot7/Counts").name, THEIRS.name} & on_board

        wanted = {THEIRS.name, *(of("robot7/Counts").name for of in (status_slot, variables_slot))}
        with server.live(at="/host/robot7/live") as one, server.live(at="/host/robot7/live") as two:
            for window in map(Window, (one, two)):
                has_all = partial(wanted.issubset, window.samples)
                wait_for(has_all, "all of it", between=window.receive)
                assert window.trouble == ""
            read = read_of_others(operator)
            assert wanted <= read
            assert not any("robot8" in name for name in read - TABLE)
            drawn = server.get("/host/robot7/diagram", machine="robot7/Counts").json()
            assert "problem" not in drawn
        wait_for(lambda: read_of_others(operator) == TABLE, "the end of the interest in robot7")
        closed = server.get("/host/robot7/log").json()
        assert closed == {"problem": "the page of this host is not open"}
        assert read_of_others(operator) == TABLE
    wait_for(lambda: read_of_others(operator) == set(), "the end of all interest")
    counts = operator.board[summary_slot("robot7")].count
    published = hosts["robot7"].board[summary_slot()]
    before = published.count
    wait_for(lambda: published.count >= before + 2, "two more summaries on the robot")
    assert operator.board[summary_slot("robot7")].count <= counts + 1, "they did not travel"


def test_the_trouble_of_hosts_is_reported(hosts: dict[str, Host], start: Start) -> None:
    operator, robot = hosts["operator"], hosts["robot7"]
    with start(FleetServer, operator).live() as socket:
        fleet = Window(socket)
        wait_for(lambda: len(fleet.troubles()) == 3, "all hosts", between=fleet.receive)
        status = robot.board.get_message(status_slot("Counts"))
        assert status is not None
        hosts["robot8"].end(signal.SIGKILL)
        Forked(["sh", "-c", f"kill -9 {status.pid}"]).wait()
        reported = {"operator": "", "robot7": "failed", "robot8": "lost"}
        wait_for(lambda: fleet.troubles() == reported, "the troubles", between=fleet.receive)
        assert fleet.hosts["robot7"]["summary"]["troubles"] == [
            ["Counts", "died", f"its process {status.pid} has not ended it"]
        ]
        assert not fleet.hosts["robot8"]["there"]
        operator.end()
        wait_for(lambda: "no daemon" in fleet.trouble, "that", between=fleet.receive)


def test_a_board_may_be_made_later(tmp_path: Path, board: str, start: Start) -> None:
    with hosts_in(tmp_path) as make_host:
        host = make_host("later", board=board)
        host.board.remove()
        with start(FleetServer, host).live() as socket:
            fleet = Window(socket)
            wait_for(lambda: fleet.trouble, "its trouble", between=fleet.receive)
            assert f"there is no whiteboard {board!r} yet" in fleet.trouble
            host.reopen()
            wait_for(lambda: "no daemon" in fleet.trouble, "it", between=fleet.receive)


def test_access_is_as_for_one_board(tmp_path: Path, board: str, start: Start) -> None:
    with hosts_in(tmp_path) as make_host:
        host = make_host("operator", board=board)
        server = start(FleetServer, host, "--control")
        for path in ("/", "/host/robot7/", "/assets/fleet.js"):
            assert server.get(path, query="").status_code == 200
            assert server.get(path, headers={"Host": "evil.example"}).status_code == 403
        for path in ("/about", "/host/robot7/about", "/host/robot7/log"):
            assert server.get(path, query="").status_code == 401
            assert server.get(path).status_code == 200
        for at in ("/live", "/host/robot7/live"):
            for refused in ({"query": ""}, {"origin": "http://evil.example"}, {"origin": None}):
                with pytest.raises(InvalidStatus), server.live(at=at, **refused):
                    pass
        about = server.get("/host/robot7/about").json()
        facts = {"title": "robot7", "control": True, "lease_s": 6.0, "span": None, "back": "/"}
        assert about == facts
        assert "cannot be the name" in server.get("/host/-7/about").json()["problem"]
        with pytest.raises(InvalidStatus), server.live(at="/host/-7/live"):
            pass
        with server.live() as socket:
            socket.send('{"type": "post", "id": 3, "slot": "pose", "message": {}}')
            fleet = Window(socket)
            wait_for(lambda: fleet.answers, "an answer", between=fleet.receive)
            assert fleet.answers[0]["problem"] == "this page only shows; open the page of a host"
        assert "pose" not in {info.name for info in host.board.slots()}
