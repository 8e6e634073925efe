from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from certificates import make_certificate
from llfsm.whiteboard.mirror.batches import VERSION
from llfsm.whiteboard.mirror.groups import group_of
from mirrored_hosts import LLFSM, NAME, NUMBER, Host, MakeHost, Number, hosts_in, number_slot
from programs import program

from .switch import HOSTS, Switch, address

__all__ = ["BATCHES", "LLFSM", "NAME", "NUMBER", "Host", "MakeHost", "Number", "number_slot"]

BATCHES = f"llfsm/{VERSION}/{NAME}/slots/-/{group_of('number')}/batch"


def plain_session(host: Host, zenoh_file: Path | None = None) -> Any:
    """Return a Zenoh session connected to a host, without llfsm."""
    import zenoh

    config = zenoh.Config() if zenoh_file is None else zenoh.Config.from_file(str(zenoh_file))
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{host.endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # whose file would stay
    return zenoh.open(config)


@pytest.fixture
def make_host(tmp_path: Path) -> Iterator[MakeHost]:
    with hosts_in(tmp_path) as make:
        yield make


Certify = Callable[..., Path]


@pytest.fixture
def certify(tmp_path: Path) -> Certify:
    """Make the Zenoh configuration of a host, with a certificate signed by an authority."""
    program("openssl")
    folder = tmp_path / "certificates"
    folder.mkdir()

    def certify(name: str, authority: str, trusts: str | None = None) -> Path:
        return make_certificate(folder, name, authority, trusts)

    return certify


@pytest.fixture
def switch() -> Iterator[Switch]:
    program("iproute2")
    switch = Switch()
    try:
        try:
            switch.make()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"network namespaces are not permitted here: {error.stderr.strip()}")
        yield switch
    finally:
        switch.remove()


@pytest.fixture
def hosts(switch: Switch, make_host: MakeHost) -> list[Host]:
    return [make_host(f"host{i}", f"tcp/{address(i)}:7447", switch.prefix(i)) for i in range(HOSTS)]
