from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fake_rclpy import action_module
from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard import Whiteboard
from memory_transport import MemoryTransport, MemoryWorld

EXAMPLE = Path(__file__).parents[4] / "examples" / "nav2_patrol"


@pytest.fixture
def nav2_msgs(request: pytest.FixtureRequest, world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the package with rclpy, too."""
    name = request.node.callspec.params["world"]
    if name == "fake rclpy":
        of = TypeLibrary(share=[EXAMPLE / "nav2_msgs"]).action("nav2_msgs/action/NavigateToPose")
        monkeypatch.setitem(sys.modules, "nav2_msgs.action", action_module(of))
    elif name == "rclpy" and importlib.util.find_spec("nav2_msgs") is None:
        pytest.skip("nav2_msgs cannot be imported: the sourced environment does not have it")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Whiteboard]:
    """Open a board that sees messages by their schema, as that of other processes does."""
    with Whiteboard("test", directory=tmp_path) as board:
        yield board


@pytest.fixture
def memory() -> MemoryWorld:
    return MemoryWorld()


@pytest.fixture
def peer(memory: MemoryWorld) -> Iterator[MemoryTransport]:
    """Open a transport of somebody else."""
    with MemoryTransport(memory, notify=lambda _: None) as transport:
        yield transport


@pytest.fixture
def reported(seen: Any) -> Any:
    """List what the bridge gave notice of."""
    return seen()


@pytest.fixture
def start(board: Whiteboard, memory: MemoryWorld, reported: Any) -> Iterator[Callable[..., Bridge]]:
    """Start a bridge: ``start(relay=[...])``, as in a configuration file."""
    with ExitStack() as open_ones:

        def starting(**config: Any) -> Bridge:
            plan, faults = make_plan(msgspec.convert(config, BridgeConfig), Path(), board.slots())
            assert not faults
            transport = open_ones.enter_context(MemoryTransport(memory, notify=reported))
            bridge = Bridge(plan, board, transport, reported)
            open_ones.callback(bridge.close)
            return bridge

        yield starting
