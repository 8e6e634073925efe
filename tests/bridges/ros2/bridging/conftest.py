from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest

from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.whiteboard import Whiteboard
from memory_transport import MemoryTransport, MemoryWorld


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
def told(seen: Any) -> Any:
    """List what the bridge gave notice of."""
    return seen()


@pytest.fixture
def start(board: Whiteboard, memory: MemoryWorld, told: Any) -> Iterator[Callable[..., Bridge]]:
    """Start a bridge: ``start(relay=[...])``, as in a configuration file."""
    with ExitStack() as open_ones:

        def starting(*, history: float = 1.0, **config: Any) -> Bridge:
            plan, faults = make_plan(msgspec.convert(config, BridgeConfig), Path(), board.slots())
            assert not faults
            transport = open_ones.enter_context(MemoryTransport(memory, notify=told))
            bridge = Bridge(plan, board, transport, told, history=history)
            open_ones.callback(bridge.close)
            return bridge

        yield starting
