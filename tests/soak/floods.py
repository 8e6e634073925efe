"""Flood `llfsm turtlesim --ros` with calls of each kind, and measure how old its newest pose gets.

Two processes call as fast as they can: goals, parameters that are read, set and described, type
descriptions, a turtle's own services; and nodes come and go. The exit status is 1 if for a second
no pose comes:

    .venv/bin/python tests/soak/floods.py [--seconds 5] [KIND...]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import itertools

from free_ports import free_endpoint
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from waiting import wait_for

DOMAIN, MOST_S, PROCESSES = 77, 1.0, 2
TOKENS = "nodes that come and go, with another type"
LLFSM = [sys.executable, "-m", "llfsm.cli"]
TYPES = TypeLibrary()


def _fields(type_name: str, **fields: Any) -> Any:
    return TYPES.message(type_name).message(**fields)


def _goal() -> dict[str, Any]:
    return {
        "goal_id": _fields("unique_identifier_msgs/msg/UUID", uuid=uuid.uuid4().bytes),
        "goal": _fields("turtlesim/action/RotateAbsolute_Goal", theta=1.0),
    }


def _settings() -> dict[str, Any]:
    value = _fields("rcl_interfaces/msg/ParameterValue", type=2, integer_value=7)
    one = _fields("rcl_interfaces/msg/Parameter", name="background_r", value=value)
    return {"parameters": (one,) * 20}


KINDS: dict[str, tuple[str, str, Callable[[], dict[str, Any]]]] = {
    "goals": (
        "/turtle1/rotate_absolute/_action/send_goal",
        "turtlesim/action/RotateAbsolute_SendGoal",
        _goal,
    ),
    "parameters read": (
        "/turtlesim/get_parameters",
        "rcl_interfaces/srv/GetParameters",
        lambda: {"names": ("background_r",) * 50},
    ),
    "parameters set": (
        "/turtlesim/set_parameters",
        "rcl_interfaces/srv/SetParameters",
        _settings,
    ),
    "parameters described": (
        "/turtlesim/describe_parameters",
        "rcl_interfaces/srv/DescribeParameters",
        lambda: {"names": ("background_r",) * 50},
    ),
    "type descriptions": (
        "/turtlesim/get_type_description",
        "type_description_interfaces/srv/GetTypeDescription",
        lambda: {"type_name": "turtlesim/msg/Pose", "include_type_sources": True},
    ),
    "pens": ("/turtle1/set_pen", "turtlesim/srv/SetPen", lambda: {"r": 1, "width": 3}),
}


def flood(kind: str, router: str, seconds: float) -> None:
    """Call as fast as can be, or let nodes come and go, and print how often that was."""
    if kind == TOKENS:
        until_s, number = time.monotonic() + seconds, 0
        with ZenohTransport(DOMAIN, router=[router]) as transport:
            while time.monotonic() < until_s:
                with transport.node(f"node{os.getpid()}_{number}") as node:
                    node.publisher("/turtle1/cmd_vel", TYPES.message("turtlesim/msg/Pose"))
                number += 1
        print(f"{number / seconds:.0f}", flush=True)
        return
    service, type_name, make = KINDS[kind]
    of = TYPES.service(type_name)
    with ZenohTransport(DOMAIN, router=[router]) as transport:
        client = transport.node("flood").client(service, of)
        wait_for(lambda: client.ready, "the service is there")
        until_s, number = time.monotonic() + seconds, 0
        while time.monotonic() < until_s:
            client.call(of.request.message(**make()), timeout=1.0)
            number += 1
    print(f"{number / seconds:.0f}", flush=True)


def largest_gap(kind: str, seconds: float) -> tuple[float, float]:
    """Return the longest time without a pose during a flood, in seconds, and the calls a second."""
    router = free_endpoint()
    with ExitStack() as stack:
        environment = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)}
        for command in (
            ["router", "--listen", router],
            ["turtlesim", "--ros", "--transport", "zenoh", "--router", router],
        ):
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            process = subprocess.Popen([*LLFSM, *command], env=environment, **quiet)  # type: ignore[call-overload]
            stack.callback(process.wait)
            stack.callback(process.kill)
            wait_for(lambda router=router: _listens(router), "the router listens")
        transport = stack.enter_context(ZenohTransport(DOMAIN, router=[router]))
        poses: list[float] = []
        pose = TYPES.message("turtlesim/msg/Pose")
        transport.node("eye").subscription(
            "/turtle1/pose", pose, lambda _: poses.append(time.monotonic())
        )
        wait_for(lambda: len(poses) > 100, "poses come")
        del poses[:-1]
        command = [sys.executable, __file__, "--seconds", str(seconds), "--flood", router, kind]
        floods = [
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(PROCESSES)
        ]
        calls = sum(float(each.communicate()[0]) for each in floods)
        times = [*poses, time.monotonic()]
    return max(b - a for a, b in itertools.pairwise(times)), calls


def _listens(endpoint: str) -> bool:
    from llfsm.bridges.ros2.opening import loopback_address, serves

    address = loopback_address(endpoint)
    return address is not None and serves(address)


def main() -> int:
    """Try all kinds, and print the gaps; return 1 if one is too long."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--flood", metavar="ROUTER", help=argparse.SUPPRESS)
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    options = parser.parse_args()
    if options.flood:
        flood(options.kinds[0], options.flood, options.seconds)
        return 0
    late = False
    for kind in options.kinds or (*KINDS, TOKENS):
        gap_s, calls = largest_gap(kind, options.seconds)
        print(f"{kind}: {calls:.0f} calls a second; {gap_s:.2f} s without a pose at most")
        late |= gap_s > MOST_S
    return int(late)


if __name__ == "__main__":
    sys.exit(main())
