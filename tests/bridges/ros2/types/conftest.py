from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from llfsm.bridges.ros2.types import TypeLibrary


@pytest.fixture(autouse=True)
def _no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same definitions, whether or not a ROS 2 environment is sourced."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)


@pytest.fixture(scope="session")
def types() -> TypeLibrary:
    """What ships, and rosbags."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("AMENT_PREFIX_PATH", raising=False)
        return TypeLibrary()


@pytest.fixture
def recorded() -> Callable[[str], Any]:
    """Load a file that was recorded from ROS 2 Jazzy."""
    folder = Path(__file__).parents[3] / "data" / "ros2"
    return lambda name: msgspec.json.decode((folder / name).read_bytes())


@pytest.fixture
def define(tmp_path: Path) -> Callable[..., TypeLibrary]:
    """Make a library of definitions: ``define(Thing="int32 x")`` knows ``own_msgs/msg/Thing``."""

    def library(**texts: str) -> TypeLibrary:
        for name, text in texts.items():
            kind = ("msg", "srv", "action")[text.count("---")]
            folder = tmp_path / "own_msgs" / kind
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.{kind}").write_text(text)
        return TypeLibrary(share=[tmp_path])

    return library
