from __future__ import annotations

import json
from pathlib import Path

import pytest

from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.bridges.ros2.zenoh_transport.transport import open_node_session, open_with


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("ZENOH_SESSION_CONFIG_URI", raising=False)
    monkeypatch.delenv("ZENOH_CONFIG_OVERRIDE", raising=False)


def endpoints(*arguments):
    session, found = open_node_session(*arguments)
    session.close()
    return found


def test_a_router_is_looked_for_where_the_argument_or_the_environment_says(monkeypatch, tmp_path):
    assert endpoints(None) == ["tcp/localhost:7447"]
    assert endpoints(["tcp/127.0.0.1:1"]) == ["tcp/127.0.0.1:1"]
    monkeypatch.setenv(
        "ZENOH_CONFIG_OVERRIDE",
        "connect/endpoints=['tcp/127.0.0.1:2'] ; scouting/multicast/enabled=false;",
    )
    assert endpoints(None) == ["tcp/127.0.0.1:2"]
    assert endpoints(["tcp/127.0.0.1:1"]) == ["tcp/127.0.0.1:1"]
    monkeypatch.delenv("ZENOH_CONFIG_OVERRIDE")
    file = tmp_path / "session.json5"
    file.write_text(
        "{mode: 'peer', connect: {endpoints: ['tcp/127.0.0.1:3']}, "
        "scouting: {multicast: {enabled: false}}}"
    )
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", str(file))
    assert endpoints(None) == ["tcp/127.0.0.1:3"]


@pytest.mark.parametrize("text", ["mode", "mode=", "no/such/key=1", "mode='queen'", "=1"])
def test_an_override_that_is_none_is_reported(monkeypatch, text):
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", text)
    with pytest.raises(
        TransportUnavailableError, match=f"ZENOH_CONFIG_OVERRIDE: {text}: "
    ) as raised:
        open_node_session(None)
    assert ".rs" not in str(raised.value)


def test_a_router_that_is_no_endpoint_is_reported():
    with pytest.raises(TransportUnavailableError, match=r"^router: 'nonsense' is not an endpoint"):
        open_node_session(["nonsense"])


@pytest.mark.parametrize("content", [None, "{", "{mode: 'queen'}"])
def test_a_file_that_is_none_is_reported(monkeypatch, tmp_path, content):
    file = tmp_path / "session.json5"
    if content is not None:
        file.write_text(content)
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", str(file))
    with pytest.raises(
        TransportUnavailableError, match=r"ZENOH_SESSION_CONFIG_URI=.*session\.json5"
    ):
        open_node_session(None)


@pytest.mark.parametrize("opened", ["node", "router"])
def test_nothing_is_in_shared_memory_that_a_killed_process_would_leave(opened):
    session = open_node_session(["tcp/127.0.0.1:1"])[0] if opened == "node" else open_with({})
    try:
        mapped = Path("/proc/self/maps").read_text()
    finally:
        session.close()
    assert "/dev/shm/" not in "".join(line for line in mapped.splitlines() if "zenoh" in line)


@pytest.mark.parametrize("opened", ["node", "router"])
def test_a_large_message_has_room_in_the_queue_of_a_connection(monkeypatch, opened):
    sizes = []
    monkeypatch.setattr(
        "zenoh.open",
        lambda config: sizes.append(config.get_json("transport/link/tx/queue/size/data")),
    )
    if opened == "node":
        open_node_session(["tcp/127.0.0.1:1"])
        monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", "transport/link/tx/queue/size/data=4")
        open_node_session(["tcp/127.0.0.1:1"])
        assert sizes == ["16", "4"]
    else:
        open_with({})
        assert sizes == ["16"]


@pytest.mark.parametrize("opened", ["node", "router"])
def test_who_stalls_for_half_a_minute_keeps_its_connections(monkeypatch, opened):
    """As nodes of rmw_zenoh do; it would get nothing from who connects to it again."""
    leases = []
    monkeypatch.setattr(
        "zenoh.open",
        lambda config: leases.append(json.loads(config.get_json("transport/link/tx/lease"))),
    )
    open_node_session(["tcp/127.0.0.1:1"]) if opened == "node" else open_with({})
    assert leases == [60_000]


def test_a_router_that_is_none_is_reported():
    with pytest.raises(TransportUnavailableError, match="nonsense"):
        open_node_session(["nonsense"])
