from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest

from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.bridges.ros2.opening import explaining_missing, open_transport


def test_auto_takes_rclpy_only_where_it_can_be_imported(monkeypatch, router):
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["{router}"]')
    if importlib.util.find_spec("rclpy") is None:
        with open_transport(domain=7) as transport:
            assert (type(transport).__name__, transport.domain, transport.up) == (
                "ZenohTransport",
                7,
                True,
            )
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name == "rclpy")
    monkeypatch.setitem(sys.modules, "rclpy", None)  # found, and gone when it is imported
    with pytest.raises(TransportUnavailableError, match=r"source /opt/ros/jazzy/setup\.bash"):
        open_transport()


def test_a_missing_library_is_explained(monkeypatch):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    for module in [name for name in sys.modules if ".ros2.zenoh_transport" in name]:
        monkeypatch.delitem(sys.modules, module)
    with pytest.raises(TransportUnavailableError, match=r"pip install 'llfsm\[ros\]'"):
        open_transport("zenoh")


def test_an_unknown_transport_is_refused():
    with pytest.raises(TransportUnavailableError, match=r"'dds'.*auto, rclpy, zenoh"):
        open_transport("dds")


def test_what_is_missing_otherwise_is_not_hidden():
    with pytest.raises(ModuleNotFoundError, match="no_such"), explaining_missing():
        import no_such  # noqa: F401


def test_the_interface_imports_no_middleware():
    code = (
        "import sys, llfsm.bridges.ros2.opening, llfsm.bridges.ros2.bridging.bridge\n"
        "sys.exit(any(name in sys.modules for name in ('zenoh', 'rclpy')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
