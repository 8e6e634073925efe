"""Hosts of a mirrored whiteboard: folders with boards, and daemons as processes of their own.

Importable from every test: `from mirrored_hosts import Host`.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from calling import call
from forked import Forked
from free_ports import free_endpoint
from llfsm.whiteboard import Message, Slot, Whiteboard
from waiting import PATIENCE_S, wait_for

__all__ = ["LLFSM", "NAME", "NUMBER", "Host", "MakeHost", "Number", "hosts_in", "number_slot"]

LLFSM = [sys.executable, "-m", "llfsm.cli"]
NAME = "mirrored"


class Number(Message, type_name="test/Number"):
    value: int = 0
    data: bytes = b""


def number_slot(name: str = "number", capacity: int = 1024) -> Slot[Number]:
    return Slot(name, Number, capacity)


NUMBER = number_slot()


class Host:
    """A host: a folder with its board, and a daemon, which listens nowhere if `endpoint` is ""."""

    def __init__(
        self, directory: Path, endpoint: str, prefix: Sequence[str] = (), *, board: str = NAME
    ) -> None:
        directory.mkdir()
        self.directory = directory
        self.endpoint = endpoint
        self.name = board
        self.board = Whiteboard(board, directory=directory)
        self._prefix = prefix
        self.process: subprocess.Popen[str] | None = None

    def start(
        self, *arguments: str, connect: Sequence[Host] = (), program: Sequence[str] = LLFSM
    ) -> None:
        """Start its daemon and wait until it is ready."""
        connections = [part for host in connect for part in ("--connect", host.endpoint)]
        listen = ["--listen", self.endpoint] if self.endpoint else []
        with (self.directory / "log").open("a") as log:
            self.process = Forked(
                [*self._prefix, *program, "whiteboard", "daemon", *self.select, *listen,
                 *connections, *arguments],
                text=True, stdout=subprocess.PIPE, stderr=log,
            )  # fmt: skip
        assert self.process.stdout is not None
        ready = self.process.stdout.readline()
        assert ready == f"mirroring {self.name}, listening on {self.endpoint or 'nowhere'}\n", (
            self.log
        )

    def reopen(self) -> None:
        """Make its board anew, which was removed."""
        self.board.close()
        self.board = Whiteboard(self.name, directory=self.directory)

    @property
    def select(self) -> list[str]:
        return ["--board", self.name, "--directory", str(self.directory)]

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
        status = self.process.wait(PATIENCE_S)
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.process = None
        return status

    def status(self) -> dict[str, Any]:
        """Return what its daemon publishes, which begins just after it is ready."""
        status = ("whiteboard", "status", *self.select, "--json")
        printed = ""

        def is_published() -> bool:
            nonlocal printed
            done = call(*status, cwd=self.directory)
            printed = done.stdout
            return done.returncode == 0

        wait_for(is_published, "a status")
        return dict(json.loads(printed))

    def get(self, slot: Slot[Number] = NUMBER) -> int | None:
        message = self.board.get_message(slot)
        return None if message is None else message.value

    def add(self, value: int, slot: Slot[Number] = NUMBER) -> None:
        self.board.add_message(slot, Number(value))

    def close(self) -> None:
        if self.process is not None:
            self.end(signal.SIGKILL)
        self.board.close()


MakeHost = Callable[..., Host]


@contextmanager
def hosts_in(folder: Path) -> Iterator[MakeHost]:
    """Give a function that makes a host, which is closed in the end."""
    with ExitStack() as stack:

        def make(
            name: str,
            endpoint: str | None = None,
            prefix: Sequence[str] = (),
            *,
            board: str = NAME,
        ) -> Host:
            place = free_endpoint() if endpoint is None else endpoint
            host = Host(folder / name, place, prefix, board=board)
            stack.callback(host.close)
            return host

        yield make
