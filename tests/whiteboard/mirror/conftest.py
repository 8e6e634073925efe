from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from certificates import make_certificate
from free_ports import free_endpoint
from llfsm.whiteboard import Message, Slot, Whiteboard
from programs import program

from .switch import HOSTS, Switch, address

LLFSM = [sys.executable, "-m", "llfsm.cli"]
NAME = "mirrored"


class Number(Message, type_name="test/Number"):
    value: int = 0
    data: bytes = b""


def number_slot(name: str = "number", capacity: int = 1024) -> Slot[Number]:
    return Slot(name, Number, capacity)


NUMBER = number_slot()


class Host:
    """A host: a folder with its board, and a daemon."""

    def __init__(self, directory: Path, endpoint: str, prefix: Sequence[str] = ()) -> None:
        directory.mkdir()
        self.directory = directory
        self.endpoint = endpoint
        self.board = Whiteboard(NAME, directory=directory)
        self._prefix = prefix
        self.process: subprocess.Popen[str] | None = None

    def start(
        self, *arguments: str, connect: Sequence[Host] = (), program: Sequence[str] = LLFSM
    ) -> None:
        """Start its daemon and wait until it is ready."""
        connections = [part for host in connect for part in ("--connect", host.endpoint)]
        with (self.directory / "log").open("a") as log:
            self.process = subprocess.Popen(
                [*self._prefix, *program, "whiteboard", "daemon", *self.select, "--listen",
                 self.endpoint, *connections, *arguments],
                text=True, stdout=subprocess.PIPE, stderr=log,
            )  # fmt: skip
        assert self.process.stdout is not None
        ready = self.process.stdout.readline()
        assert ready == f"mirroring {NAME}, listening on {self.endpoint}\n", self.log

    @property
    def select(self) -> list[str]:
        return ["--board", NAME, "--directory", str(self.directory)]

    @property
    def log(self) -> str:
        return (self.directory / "log").read_text()

    @property
    def pid(self) -> int:
        assert self.process is not None
        return self.process.pid

    def send(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def end(self, number: int = signal.SIGTERM) -> int:
        """End its daemon; return the exit status."""
        assert self.process is not None
        self.process.send_signal(signal.SIGCONT)
        self.process.send_signal(number)
        status = self.process.wait(30)
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.process = None
        return status

    def status(self) -> dict[str, Any]:
        command = [*LLFSM, "whiteboard", "status", *self.select, "--json"]
        done = subprocess.run(command, text=True, capture_output=True, check=True)
        return dict(json.loads(done.stdout))

    def get(self, slot: Slot[Number] = NUMBER) -> int | None:
        message = self.board.get_message(slot)
        return None if message is None else message.value

    def add(self, value: int, slot: Slot[Number] = NUMBER) -> None:
        self.board.add_message(slot, Number(value))

    def close(self) -> None:
        if self.process is not None:
            self.end(signal.SIGKILL)
        self.board.close()


def plain_session(host: Host, zenoh_file: Path | None = None) -> Any:
    """Return a Zenoh session connected to a host, without llfsm."""
    import zenoh

    config = zenoh.Config() if zenoh_file is None else zenoh.Config.from_file(str(zenoh_file))
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{host.endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


MakeHost = Callable[..., Host]


@pytest.fixture
def make_host(tmp_path: Path) -> Iterator[MakeHost]:
    with ExitStack() as stack:

        def make(name: str, endpoint: str | None = None, prefix: Sequence[str] = ()) -> Host:
            host = Host(tmp_path / name, endpoint or free_endpoint(), prefix)
            stack.callback(host.close)
            return host

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
