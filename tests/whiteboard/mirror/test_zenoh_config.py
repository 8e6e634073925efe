"""Zenoh's configuration: settings override the file, which overrides our defaults."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from llfsm.whiteboard import NetworkError
from llfsm.whiteboard.mirror.settings import DEFAULT_ENDPOINT, Settings
from llfsm.whiteboard.mirror.zenoh_config import configure, endpoints


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "zenoh.json5"


def configured(settings: Settings, key: str, mode: str = "peer") -> Any:
    return json.loads(configure(settings, mode).get_json(key))


@pytest.mark.parametrize("named", [False, True])
def test_the_default_neither_accepts_nor_discovers_other_hosts(file: Path, named: bool) -> None:
    """Also with a file that speaks of other things: Zenoh by itself is open to the network."""
    file.write_text("{ transport: { link: { tls: { enable_mtls: true } } } }")
    settings = Settings(zenoh=str(file) if named else None)
    assert endpoints(configure(settings, "peer"), "listen") == (DEFAULT_ENDPOINT,)
    assert DEFAULT_ENDPOINT.startswith("tcp/127.0.0.1:")
    assert endpoints(configure(settings, "client"), "listen") == ()
    assert configured(settings, "scouting/multicast/enabled") is False
    assert configured(settings, "transport/link/tls/enable_mtls") is (True if named else None)


def test_what_the_file_says_counts(file: Path) -> None:
    file.write_text(
        """{
        mode: "router", scouting: { multicast: { enabled: true } },
        listen: { endpoints: { router: ["tcp/[::1]:0"], peer: [] } },
        transport: { unicast: { open_timeout: 7000 }, shared_memory: { enabled: true } },
        }"""
    )
    settings = Settings(zenoh=str(file))
    assert endpoints(configure(settings, "peer"), "listen") == ("tcp/[::1]:0",)
    assert configured(settings, "mode") == "router"
    assert configured(settings, "scouting/multicast/enabled") is True
    assert configured(settings, "transport/unicast/open_timeout") == 7000
    assert configured(settings, "transport/unicast/accept_timeout") == 4000
    assert configured(settings, "transport/shared_memory/enabled") is False
    assert configured(settings, "mode", "client") == "client"


def test_the_settings_count_more(file: Path) -> None:
    file.write_text('{ listen: { endpoints: ["tcp/[::1]:0"] }, scouting: {} }')
    listen, connect = ("tcp/127.0.0.1:1",), ("tcp/127.0.0.1:2", "tcp/127.0.0.1:3")
    settings = Settings(zenoh=str(file), listen=listen, connect=connect, multicast=True)
    config = configure(settings, "peer")
    assert endpoints(config, "listen") == listen
    assert endpoints(config, "connect") == connect
    assert configured(settings, "scouting/multicast/enabled") is True


def test_a_file_that_is_none_is_an_error(file: Path) -> None:
    with pytest.raises(NetworkError, match="no such Zenoh configuration file"):
        configure(Settings(zenoh=str(file)), "peer")
    file.write_text("{ nonsense")
    with pytest.raises(NetworkError, match=r"zenoh\.json5: "):
        configure(Settings(zenoh=str(file)), "peer")


def test_an_endpoint_that_is_none_is_an_error() -> None:
    with pytest.raises(NetworkError, match=r"^connect: 'robot.local' .* tcp/robot.local:7447"):
        configure(Settings(connect=("robot.local",)), "peer")


def test_what_zenoh_does_not_accept_is_reported_in_words() -> None:
    why = r"listen/endpoints = \['/here'\]: Endpoints must be of the form .*: /here$"
    with pytest.raises(NetworkError, match=why):
        configure(Settings(listen=("/here",)), "peer")
