"""``llfsm whiteboard daemon`` and ``status``: what they say, and what they refuse."""

from __future__ import annotations

import configparser
import json
import os
import resource
import shlex
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import llfsm.whiteboard.mirror.daemon as mirror_daemon
from llfsm.cli.options import BoardPlace
from llfsm.cli.root import main
from llfsm.cli.whiteboard import daemon, read_status
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    MIRROR,
    MirrorStatus,
    PeerStatus,
    QuotaStatus,
    Refusal,
)
from programs import program
from waiting import PATIENCE_S

UNIT = Path(mirror_daemon.__file__).with_name("llfsm-whiteboard@.service")


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["whiteboard", *arguments])
    return done.exit_code, done.output


@pytest.mark.parametrize("megabytes", [60, 70, 90, 200, 220])
def test_without_the_memory_that_it_needs_it_says_so(tmp_path: Path, megabytes: int) -> None:
    limit = megabytes << 20
    command = [sys.executable, "-m", "llfsm.cli", "whiteboard", "daemon", "-b", "small"]
    command += ["--directory", str(tmp_path), "--listen", "tcp/127.0.0.1:0"]
    printed = []
    with subprocess.Popen(
        command,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            printed.append(line)
            if line.startswith("mirroring"):  # then it was enough
                process.terminate()
    text = "".join(printed)
    assert process.returncode in (0, 1), text
    assert "Traceback" not in text
    assert process.returncode == 0 or "Error: " in text


def test_status_shows_all_that_the_daemon_reports(tmp_path: Path) -> None:
    reported = MirrorStatus(
        host="ab", pid=7, slots=3, left=10, entered=20, leave_rate=1.5, enter_rate=2.0,
        sent_rate=3456.0, received_rate=70.0, conflicts=4, held_back=5,
        peers=(PeerStatus("laptop", "cd", 2.5, 1.25, 8, 1, "robot"),),
        quotas=(QuotaStatus("", 3, 1024, 5 << 20, 512 << 20, 0),
                QuotaStatus("robot", 1, 1024, 0, 512 << 20, 9)),
        refused=(Refusal("it is not listed: x", 6),),
    )  # fmt: skip
    with Whiteboard("board", directory=tmp_path) as board:
        board.add_message(MIRROR, reported)
    status, output = run("status", "-b", "board", "--directory", str(tmp_path))
    assert status == 0
    assert output == (
        "board: mirrored by process 7, host ab\n"
        "slots      3 may leave\n"
        "left       10, 1.5 a second\n"
        "entered    20, 2 a second\n"
        "traffic    3.5 kB/s out, 0.1 in\n"
        "conflicts  4\n"
        "held back  5\n"
        "peer       cd laptop, certificate robot: lag 1.2 ms, 8 batches, the last 2.5 s ago, "
        "1 lost\n"
        "quota      other hosts: 3 of 1024 slots, 5 of 512 MiB, 0 over the rate\n"
        "quota      robot: 1 of 1024 slots, 0 of 512 MiB, 9 over the rate\n"
        "refused    6 x it is not listed: x\n"
    )
    status, output = run("status", "-b", "board", "--directory", str(tmp_path), "--json")
    assert json.loads(output)["peers"][0]["name"] == "laptop"


def test_status_says_that_there_is_no_daemon(tmp_path: Path) -> None:
    select = ("-b", "board", "--directory", str(tmp_path))
    status, output = run("status", *select)
    assert status == 1
    assert "no such whiteboard" in output
    with Whiteboard("board", directory=tmp_path) as board:
        status, output = run("status", *select)
        assert "no daemon mirrors the whiteboard 'board'" in output
        assert board.slots() == []


def test_status_says_that_the_daemon_is_silent(tmp_path: Path) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        board.add_message(MIRROR, MirrorStatus())
    with pytest.raises(click.ClickException, match="has ended or is stopped"):
        read_status(BoardPlace("board", str(tmp_path)), stale_s=0.0)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("listn = []", "hosts.toml:1: there is no key 'listn' here"),
        ("\nrate = 0", "hosts.toml:2: rate: Expected `float` > 0.0"),
        ("listen = 'tcp/x:1'", "hosts.toml:1: listen: Expected `array | null`, got `str`"),
        ('[rates]\n"a" = 1\n"b" = "fast"', "hosts.toml:1: rates: Expected `float`, got `str`"),
        ("rate = ", "hosts.toml:1"),
        ("zenoh = 'not-there.json5'", "not-there.json5: no such Zenoh configuration file"),
        ("\nzenoh = 'not-there.json5'", "hosts.toml:2: "),
        ("\nlisten = ['nonsense']", "hosts.toml:2: listen: 'nonsense' is not an endpoint"),
        ("connect = ['tcp/']", "hosts.toml:1: connect: 'tcp/' is not an endpoint"),
        ("rate = 5\n[access]\nrobot = ['*']", "hosts.toml:2: `access` names hosts by their"),
    ],
)
def test_a_mistake_in_the_settings_is_reported_with_its_place(
    tmp_path: Path, toml: str, message: str
) -> None:
    (tmp_path / "hosts.toml").write_text(toml)
    status, output = run("daemon", "--directory", str(tmp_path), "-c", str(tmp_path / "hosts.toml"))
    assert status == 1
    assert message in output


def test_a_flag_that_overrides_the_file_is_not_looked_for_there(tmp_path: Path) -> None:
    file = tmp_path / "hosts.toml"
    file.write_text("listen = ['tcp/127.0.0.1:0']")
    flags = ("--directory", str(tmp_path), "-c", str(file), "--listen", "nonsense")
    status, output = run("daemon", *flags)
    assert status == 1
    assert "Error: listen: 'nonsense' is not an endpoint" in output


def test_a_mistake_in_the_flags_is_one_of_usage(tmp_path: Path) -> None:
    status, output = run("daemon", "--directory", str(tmp_path), "--rate", "-5")
    assert status == 2
    assert "rate" in output


@pytest.mark.parametrize("endpoint", ["nonsense", "tcp/256.1.1.1:5", "carrier/pigeon:1"])
def test_an_impossible_endpoint_is_an_error(tmp_path: Path, endpoint: str) -> None:
    status, output = run("daemon", "--directory", str(tmp_path), "--listen", endpoint)
    assert status == 1, output
    assert endpoint in output


def test_without_zenoh_it_says_what_to_install(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['zenoh'] = None\n"
        "from llfsm.cli.root import main\n"
        f"main(['whiteboard', 'daemon', '--directory', {str(tmp_path)!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=False)
    assert done.returncode == 1
    assert "pip install 'llfsm[hosts]'" in done.stderr


def test_the_unit_calls_the_command_as_it_is() -> None:
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(UNIT)
    service = parser["Service"]
    assert service["Type"] == "notify"
    _, llfsm, group, command, *arguments = shlex.split(service["ExecStart"])
    assert (llfsm, group, command) == ("llfsm", "whiteboard", "daemon")
    options = {name for parameter in daemon.params for name in parameter.opts}
    assert {part for part in arguments if part.startswith("--")} <= options


def test_systemd_restarts_a_daemon_that_gives_no_sign_of_life() -> None:
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(UNIT)
    assert int(parser["Service"]["WatchdogSec"]) >= 3  # it gives one each second
    assert parser["Service"]["Restart"] == "on-failure"


def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path: Path) -> None:
    """Nor with what the unit says of itself; a mistake in it would be found."""
    text = UNIT.read_text()
    for name, content, good in (
        ("right", text, True),
        ("wrong", text.replace("WatchdogSec=10", "WatchdogSec=soon"), False),
    ):
        unit = tmp_path / f"{name}@board.service"
        unit.write_text(content)
        command = [program("systemd"), "verify", "--man=no", unit]
        done = subprocess.run(command, text=True, capture_output=True, check=False)
        assert (str(unit) not in done.stdout + done.stderr) is good, done


@contextmanager
def supervisor(address: str) -> Iterator[socket.socket]:
    """Listen as systemd does, which also takes the sender's process id from the kernel."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        listening.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        listening.settimeout(PATIENCE_S)
        yield listening


def received(listening: socket.socket) -> tuple[str, int]:
    """Return the next state, and the process id of its sender."""
    data, [(_, _, credentials)], _, _ = listening.recvmsg(100, socket.CMSG_SPACE(12))
    return data.decode(), struct.unpack("3i", credentials)[0]


@pytest.fixture(params=["{}/notify", "{}/user@1000.service/notify", "@llfsm/{}/no@tify"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return an address as systemd gives it: a path, or a name without a file after an @."""
    (tmp_path / "user@1000.service").mkdir()
    return str(request.param.format(tmp_path))


def test_each_status_is_a_sign_of_life(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    with supervisor(address) as systemd, Whiteboard("board", directory=tmp_path) as board:
        publish = mirror_daemon.status_publisher(board)
        for _ in range(2):
            publish(MirrorStatus())
            assert received(systemd) == ("WATCHDOG=1", os.getpid())


def test_a_daemon_reports_its_life_to_systemd_from_the_start_to_the_end(tmp_path: Path) -> None:
    """The process that systemd has started is the one that sends: `NotifyAccess=main`."""
    command = [sys.executable, "-m", "llfsm.cli", "whiteboard", "daemon", "--directory", tmp_path]
    with supervisor(f"@llfsm-test/{os.getpid()}") as systemd:
        environment = os.environ | {"NOTIFY_SOCKET": f"@llfsm-test/{os.getpid()}"}
        with subprocess.Popen(
            [*command, "--listen", "tcp/127.0.0.1:0"], env=environment, stdout=subprocess.DEVNULL
        ) as process:
            try:
                for state in ("READY=1", "WATCHDOG=1", "WATCHDOG=1"):
                    assert received(systemd) == (state, process.pid)
                process.terminate()
                while (last := received(systemd)) == ("WATCHDOG=1", process.pid):
                    pass
                assert last == ("STOPPING=1", process.pid)
                assert process.wait(PATIENCE_S) == 0
            finally:
                process.kill()
