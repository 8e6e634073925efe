"""Bundles that are open in windows, without a browser; the server is a thread."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Thread
from typing import Any

import httpx
import pytest
import uvicorn
from websockets.sync.client import ClientConnection, connect

from llfsm.bridges.edit.edit_app import OpenedPlan, make_edit_app
from llfsm.bridges.view.access import configured
from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.editing import Document
from waiting import PATIENCE_S

FILES = {
    "Language": "python\n",
    "States": "A\nB\nLost\n",
    "M_Variables.py": "count: int = 0\n",
    "State_A_OnEntry.py": "count += 1\n",
    "State_A_Transition_0.target": "B\n",
    "State_A_Transition_1.target": "A\n",
    "State_A_Transition_1.expr": "count > 3\n",
    "State_B_OnEntry.py": "\n",
    "State_Lost_OnEntry.py": "\n",
}


LAMP = {
    "Language": "python\n",
    "States": "Off\nOn\nEnd\n",
    "Lamp_Includes.py": (
        "from llfsm.runtime import Actuator, Sensor\n"
        "from llfsm.whiteboard import Message, Slot\n\n\n"
        "class Level(Message):\n    value: float = 0.0\n    on: bool = False\n"
    ),
    "Lamp_Variables.py": (
        "level = Sensor(Slot('level', Level), default=Level(), max_age_ms=1000)\n"
        "lamp = Actuator(Slot('lamp', Level))\n"
        "count: int = 0\n"
    ),
    "State_Off_OnEntry.py": "count += 1\nlamp(Level(on=False))\n",
    "State_Off_Transition_0.target": "On\n",
    "State_Off_Transition_0.expr": "level.on and level.value > 2\n",
    "State_On_OnEntry.py": "print('on')\nlamp(Level(on=True))\n",
    "State_On_Transition_0.target": "End\n",
    "State_On_Transition_0.expr": "count >= 2\n",
    "State_On_Transition_1.target": "Off\n",
    "State_On_Transition_1.expr": "not level.on\n",
    "State_End_OnEntry.py": "\n",
}


def made(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return made(tmp_path / "M.machine", FILES)


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    return made(tmp_path / "Lamp.machine", LAMP)


@pytest.fixture(autouse=True)
def quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for no disk: the server is a thread of the tests."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


class FakeWindow:
    """A page as far as the server sees it: what it shows, and what it asks."""

    def __init__(self, socket: ClientConnection):
        self.socket = socket
        self.shown: dict[str, Any] = {}
        self.frames: list[dict[str, Any]] = []
        self.number = 0

    def receive(self) -> dict[str, Any]:
        """Return the next message; a frame is shown before."""
        message: dict[str, Any] = json.loads(self.socket.recv(PATIENCE_S))
        if "answer" in message:
            return message
        self.frames.append(message)
        for key, value in message.items():
            if key in ("boxes", "edges", "texts"):
                kept = {**self.shown.get(key, {}), **value}
                value = {name: each for name, each in kept.items() if each is not None}
            self.shown[key] = value
        self.socket.send('{"type": "seen"}')
        return message

    def wait(self, holds: Callable[[dict[str, Any]], Any]) -> None:
        """Take frames until what is shown is as it should be."""
        while not (self.shown and holds(self.shown)):
            self.receive()

    def ask(self, kind: str, **fields: Any) -> dict[str, Any]:
        self.number += 1
        self.socket.send(json.dumps({"type": kind, "id": self.number, **fields}))
        while True:
            message = self.receive()
            if message.get("answer") == self.number:
                return message

    def apply(self, *edits: dict[str, Any]) -> dict[str, Any]:
        return self.ask("apply", shape=self.shown["shape"], edits=edits)


class EditServer:
    """The editor's server of one machine, or of those of a plan."""

    def __init__(
        self,
        opened: Path | Document | OpenedPlan,
        source: PageSource | None = None,
        *,
        control: bool = False,
        port: int = 0,
    ):
        opened = Document(opened) if isinstance(opened, Path) else opened
        app = make_edit_app(
            opened, host="127.0.0.1", token="secret", source=source, control=control
        )
        self.listener = socket.create_server(("127.0.0.1", port))
        self.host = f"127.0.0.1:{self.listener.getsockname()[1]}"
        self.server = uvicorn.Server(configured(app))
        self.thread = Thread(target=self.server.run, args=([self.listener],))
        self.thread.start()

    def end(self) -> None:
        self.server.should_exit = True
        self.thread.join()

    def get(self, path: str, **headers: str) -> httpx.Response:
        address = f"http://{self.host}{path}"
        return httpx.get(address, headers=headers, trust_env=False, verify=False)

    def connect(
        self, query: str = "?token=secret", origin: str = "", page: str = "/"
    ) -> ClientConnection:
        address = f"ws://{self.host}{page}live{query}"
        return connect(address, origin=origin or f"http://{self.host}", proxy=None)  # type: ignore[arg-type]


@pytest.fixture
def server(bundle: Path) -> Iterator[EditServer]:
    server = EditServer(bundle)
    yield server
    server.end()


@pytest.fixture
def windows(server: EditServer) -> Iterator[Callable[[], FakeWindow]]:
    """Give a function that opens windows of one server."""
    with ExitStack() as stack:

        def open_window() -> FakeWindow:
            window = FakeWindow(stack.enter_context(server.connect()))
            window.wait(lambda shown: "shape" in shown and shown["names"])
            return window

        yield open_window
