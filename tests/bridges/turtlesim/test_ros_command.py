"""`llfsm turtlesim --ros`: a node in a process of its own, and who talks to it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner

from calling import own_logging
from forked import Forked
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from llfsm.cli.root import main
from llfsm.whiteboard.shared import boards
from waiting import PATIENCE_S

DOMAIN = 92
HASHES = Path(__file__).parents[2] / "data" / "ros2" / "type_hashes.json"
BOARD = f"ros-turtlesim-{os.getpid()}"


@pytest.fixture
def start(router: str) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    with ExitStack() as processes:

        def start(*options: str) -> subprocess.Popen[str]:
            process = processes.enter_context(
                Forked(
                    [sys.executable, "-m", "llfsm.cli", "turtlesim", "--ros", "--until-eof",
                     "--transport", "zenoh", "--domain", str(DOMAIN), "--router", router, *options],
                    stdin=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                    env=os.environ | {"WHITEBOARD_NAME": BOARD},
                )
            )  # fmt: skip
            processes.callback(process.kill)
            return process

        yield start


@pytest.fixture
def transport(router: str) -> Iterator[ZenohTransport]:
    with ZenohTransport(DOMAIN, router=[router], notify=lambda _: None) as transport:
        yield transport


def has(transport: ZenohTransport, *topics: str) -> bool:
    return transport.wait_graph(
        lambda graph: all(graph.ends(t, Role.PUBLISHER) for t in topics), PATIENCE_S
    )


def test_a_user_who_knows_nothing_of_us_is_served(start, transport, router):
    start()
    assert has(transport, "/turtle1/rotate_absolute/_action/status")
    peer = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("ros_peer.py")),
         router.rpartition(":")[2], str(DOMAIN), str(HASHES)],
        stdout=subprocess.PIPE,
        check=True,
    )  # fmt: skip
    seen = json.loads(peer.stdout)
    feedback = seen.pop("feedback")
    delta = seen.pop("delta")
    assert {"background_r", "holonomic", "use_sim_time"} <= set(seen["parameters"])
    assert seen == {
        "moved": True,
        "spawned": ["bob", "", "", "turtle2"],
        "killed": True,
        "parameters": seen["parameters"],
        "accepted": True,
        "status": 4,
        "ids": [list(range(1, 17))],
    }
    assert delta == pytest.approx(-18 * 0.016, abs=1e-6)
    assert feedback == sorted(feedback, reverse=True)
    rounded = {round(left, 4) for left in feedback}
    assert rounded <= {round(0.3 - step * 0.016, 4) for step in range(19)}
    assert rounded


def test_arguments_of_ros_rename_it_set_it_and_its_lines_are_those_of_ros(start, transport):
    process = start(
        "--ros-args", "-r", "__ns:=/pond", "-r", "turtle1/pose:=/where",
        "-p", "background_r:=1", "--log-level", "warn",
    )  # fmt: skip
    assert has(transport, "/where", "/pond/turtle1/color_sensor")
    assert transport.graph().nodes == ("/pond/turtlesim",)
    types = TypeLibrary()
    node = transport.node("tool")
    of = types.service("rcl_interfaces/srv/GetParameters")
    client = node.client("/pond/turtlesim/get_parameters", of)
    assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
    request = of.request.message(names=("background_r",))
    (value,) = client.call(request, timeout=PATIENCE_S).result(PATIENCE_S).values
    assert value.integer_value == 1
    of = types.service("turtlesim/srv/Kill")
    client = node.client("/pond/kill", of)
    assert transport.wait_graph(lambda _: client.ready, PATIENCE_S)
    client.call(of.request.message(name="bob"), timeout=PATIENCE_S).result(PATIENCE_S)
    process.send_signal(signal.SIGTERM)
    (line,) = process.stderr.read().splitlines()  # those for information are not printed
    assert re.fullmatch(
        r"\[ERROR\] \[\d+\.\d{9}\] \[pond\.turtlesim\]: Tried to kill turtle \[bob\], .*", line
    )


@pytest.mark.parametrize("end", ["SIGINT", "SIGTERM", "EOF"])
def test_it_ends_cleanly_leaves_the_graph_and_touches_no_whiteboard(
    start, transport, tmp_path, end
):
    picture = tmp_path / "field.svg"
    process = start("--turtle", "bob,2,3,0.5", "--picture", str(picture))
    assert has(transport, "/bob/pose", "/turtle1/pose")
    assert BOARD not in {board.name for board in boards()}
    if end == "EOF":
        process.stdin.close()
    else:
        process.send_signal(signal.Signals[end])
    errors = process.stderr.read()
    assert process.wait(PATIENCE_S) == 0, errors
    assert "Traceback" not in errors
    assert transport.wait_graph(lambda graph: not graph.nodes and not graph.endpoints, PATIENCE_S)
    assert "bob" in picture.read_text()


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--ros", "--board", "x"], 2, "--ros touches no whiteboard: leave out --board"),
        (["--ros", "--remove-board"], 2, "--ros touches no whiteboard: leave out --remove-board"),
        (["--domain", "3"], 2, "--ros is needed for --domain"),
        (["--transport", "zenoh"], 2, "--ros is needed for --transport"),
        (["--router", "tcp/localhost:1"], 2, "--ros is needed for --router"),
        (
            ["--ros", "--transport", "rclpy", "--router", "tcp/localhost:1"],
            2,
            "for --transport zenoh",
        ),
        (["--ros-args", "-p", "holonomic:=true"], 2, "--ros is needed for --ros-args"),
        (["--ros", "--ros-args", "-p", "holonomic"], 2, "write [NODE:]NAME:=VALUE"),
        (["--ros", "--transport", "dds"], 2, "'dds' is not one of"),
        (
            ["--ros", "--transport", "zenoh", "--domain", "233"],
            2,
            "233 is not in the range 0<=x<=232",
        ),
        (["--ros", "--router", "nonsense"], 1, "nonsense"),
    ],
)
def test_options_that_cannot_be_are_refused(options, code, message):
    with own_logging():
        result = CliRunner().invoke(main, ["turtlesim", *options])
    assert (result.exit_code, message in result.output) == (code, True), result.output


def test_a_turtle_that_cannot_be_is_refused(router):
    options = [
        "turtlesim",
        "--ros",
        "--transport",
        "zenoh",
        "--domain",
        str(DOMAIN),
        "--router",
        router,
    ]
    with own_logging():
        result = CliRunner().invoke(main, [*options, "--turtle", "turtle1,1,1,0"])
    assert result.exit_code == 2
    assert "--turtle turtle1: see the line above" in result.output
