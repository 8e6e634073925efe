"""Daemons of hosts with names: what is bare at home is in a folder of that name for all others."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from free_ports import free_endpoint
from llfsm.whiteboard import NetworkError, Whiteboard
from llfsm.whiteboard.messages.llfsm import HOSTS
from llfsm.whiteboard.mirror.batches import VERSION
from waiting import wait_for

from .conftest import (
    LLFSM,
    NAME,
    NUMBER,
    Certify,
    Host,
    MakeHost,
    Number,
    number_slot,
    plain_session,
)
from .test_access import refused

CMD, POSE = number_slot("cmd"), number_slot("pose")
THEIR_CMD, THEIR_POSE = number_slot("robot7/cmd"), number_slot("robot7/pose")


def test_a_named_host_and_others_with_a_daemon_and_without(
    make_host: MakeHost, tmp_path: Path
) -> None:
    """The named one is not eager, and gets what is sent to its slots all the same."""
    robot, laptop = make_host("robot"), make_host("laptop")
    settings = tmp_path / "robot.toml"
    settings.write_text('as = "robot7"\neager = false\nfleet = ["operator"]\n')
    robot.add(1, POSE)
    robot.add(1, CMD)
    robot.start("--config", str(settings))
    laptop.start(connect=[robot])
    wait_for(lambda: laptop.get(THEIR_POSE) == 1)
    laptop.add(2, THEIR_CMD)
    wait_for(lambda: robot.get(CMD) == 2)
    with Whiteboard.connect(robot.endpoint, NAME, as_="operator", fleet=["robot*"]) as operator:
        assert operator.get_message(THEIR_CMD) == Number(2)
        operator.add_message(THEIR_CMD, Number(3))
        operator.add_message(NUMBER, Number(4))
        wait_for(lambda: robot.get(CMD) == laptop.get(THEIR_CMD) == 3)
        wait_for(lambda: laptop.get(number_slot("operator/number")) == 4)
    listed = {info.name for info in robot.board.slots()}
    assert listed >= {"cmd", "pose"}
    assert not any(name.startswith("robot7/") for name in listed)
    wait_for(lambda: robot.status()["name"] == "robot7")


def namesakes(make_host: MakeHost, certify: Certify | None) -> tuple[Host, Host]:
    if certify is None:
        one, other = make_host("one"), make_host("other")
        one.start("--as", "robot7")
        other.start("--as", "robot7", connect=[one])
        return one, other
    one, other = (make_host(name, free_endpoint("localhost", "tls")) for name in ("one", "other"))
    for host, its_peer, connect in (one, "other", []), (other, "one", [one]):
        name = host.directory.name
        settings = host.directory / "settings.toml"
        settings.write_text(f'as = "robot7"\n[access]\n{its_peer} = ["*"]\n')
        zenoh = str(certify(name, "ours"))
        host.start("--config", str(settings), "--zenoh", zenoh, connect=connect)
    return one, other


@pytest.mark.parametrize("with_access", [False, True])
def test_two_hosts_of_one_name_are_reported_at_both_ends(
    make_host: MakeHost, certify: Certify, with_access: bool
) -> None:
    what = (
        "another host that is 'robot7': slots of both are mixed up; give each host a name of its "
        "own (`as`)"
    )
    for host in namesakes(make_host, certify if with_access else None):
        wait_for(lambda host=host: what in refused(host))


def run_daemon(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*LLFSM, "whiteboard", "daemon", "-b", NAME, "--directory", str(tmp_path)]
    return subprocess.run([*command, *arguments], text=True, capture_output=True, check=False)


def test_what_cannot_be_a_hosts_name_is_an_error(tmp_path: Path) -> None:
    done = run_daemon(tmp_path, "--as", "robot/7")
    assert done.returncode == 2
    assert "'robot/7' cannot be the name of a host (`as`): use 1 to 64 letters" in done.stderr
    with pytest.raises(NetworkError, match="'llfsm' cannot be the name of a host"):
        Whiteboard.connect("tcp/127.0.0.1:1", NAME, as_="llfsm")
    with pytest.raises(NetworkError, match="fleet: a host that has others in its fleet needs a n"):
        Whiteboard.connect("tcp/127.0.0.1:1", NAME, fleet=["robot*"])


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('as = ""\n', "settings.toml:1: as: Expected `str` of length >= 1"),
        ('\nfleet = ["robot*"]\n', "settings.toml:2: fleet: a host that has others in its fleet"),
        (
            '[keep]\nfile = "kept"\nslots = ["map/*", "llfsm/*"]\n',
            "settings.toml:1: keep: slots: 'llfsm/*' keeps nothing",
        ),
    ],
)
def test_a_setting_without_an_effect_is_an_error(tmp_path: Path, text: str, what: str) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text(text)
    done = run_daemon(tmp_path, "--config", str(settings))
    assert done.returncode in (1, 2)
    assert what in done.stderr


@pytest.mark.parametrize(
    ("flags", "what"),
    [(["--as", ""], "as: Expected `str` of length >= 1"), (["--rate", "0"], "rate: Expected")],
)
def test_a_flag_with_an_impossible_value_is_an_error(
    tmp_path: Path, flags: list[str], what: str
) -> None:
    done = run_daemon(tmp_path, *flags)
    assert done.returncode == 2
    assert what in done.stderr


def test_hosts_that_another_one_makes_up_hide_no_other_for_long(make_host: MakeHost) -> None:
    """As many are looked at as it may make slots, and others again when these are gone."""
    operator, robot = make_host("operator"), make_host("robot")
    settings = operator.directory / "settings.toml"
    settings.write_text('as = "operator"\nfleet = ["*"]\n[quota]\nslots = 3\n')
    operator.start("--config", str(settings))

    def names() -> tuple[str, ...]:
        hosts = operator.board[HOSTS].get()
        return () if hosts is None else hosts.names

    with plain_session(operator) as session:
        root = f"llfsm/{VERSION}/{NAME}/hosts/-"
        tokens = [session.liveliness().declare_token(f"{root}/x{n}/{n}") for n in range(20)]
        wait_for(lambda: len(names()) == 3, "some of them")
        robot.start("--as", "robot7", connect=[operator])
        robot.add(1, POSE)
        wait_for(lambda: operator.get(THEIR_POSE) == 1)
        assert len(names()) == 3
        assert "robot7" not in names()
        tokens.clear()
    wait_for(lambda: names() == ("operator", "robot7"), "those that are there")
