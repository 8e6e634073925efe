"""A fleet of real daemons, and the frames of its page."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection

from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    HOSTS,
    MIRROR,
    Hosts,
    HostSummary,
    MachineTrouble,
    MirrorStatus,
    summary_slot,
)
from mirrored_hosts import Host, MakeHost
from waiting import PATIENCE_S

from .conftest import Server

MACHINES = Path(__file__).parents[2] / "cli/machines.py"


def start_daemons(make_host: MakeHost, *robots: str) -> dict[str, Host]:
    """Return the hosts by name: an operator, to which robots connect; none is eager."""
    operator = make_host("operator")
    hosts = {"operator": operator, **{name: make_host(name, "") for name in robots}}
    for name, host in hosts.items():
        settings = host.directory / "settings.toml"
        listen = "" if host.endpoint else "listen = []\n"
        fleet = 'fleet = ["robot*", "operator"]\neager = false\n'
        settings.write_text(f'as = "{name}"\n{listen}{fleet}')
        connect = [] if host is operator else [operator]
        host.start("--config", str(settings), connect=connect)
    return hosts


class FleetServer(Server):
    """`llfsm view --fleet` on the board of a host."""

    def __init__(self, host: Host, *options: str, cwd: Path, port: int = 0) -> None:
        directory = "--directory", str(host.directory)
        super().__init__(host.name, *directory, "--fleet", *options, cwd=cwd, port=port)


class Window:
    """What a window of a page has received."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.hosts: dict[str, dict[str, Any]] = {}
        self.slots: dict[int, str] = {}
        self.samples: set[str] = set()
        self.trouble = ""
        self.answers: list[dict[str, Any]] = []

    def receive(self) -> None:
        """Take a frame."""
        frame = json.loads(self._socket.recv(PATIENCE_S))
        if "answer" in frame:
            self.answers.append(frame)
            return
        self._socket.send('{"type": "seen"}')
        self.trouble = frame.get("trouble", self.trouble)
        for name, host in frame.get("hosts", {}).items():
            if host is None:
                del self.hosts[name]
            else:
                self.hosts[name] = host
        self.slots |= {slot[0]: slot[1] for slot in frame.get("slots", ())}
        self.samples |= {self.slots[sample[0]] for sample in frame.get("samples", ())}

    def troubles(self) -> dict[str, str]:
        """Return the worst trouble of each host that has published a summary."""
        return {n: each["trouble"] for n, each in self.hosts.items() if each["summary"]}


ERROR = "machine Wall, state DRIVE, Internal: ValueError: no plan <b>at all</b> (wall.py:15)"


def publish(board: Whiteboard, host: str, *, ahead_ns: int = 0, **fields: Any) -> None:
    """Add the summary of a host, as it arrives from its daemon."""
    sent = {"sent_ns": time.time_ns() + ahead_ns, "system": f"{host or 'desk'}.local"}
    board.add_message(summary_slot(host), HostSummary(**sent, machines=4, **fields))


def fill(board: Whiteboard, robots: int, *, silent: str = "") -> None:
    """Add what a daemon leaves on an operator's board, of so many robots, two in trouble."""
    names = [f"robot{number}" for number in range(1, robots + 1)]
    board.add_message(MIRROR, MirrorStatus(name="operator", fleet=("robot*",)))
    board.add_message(HOSTS, Hosts(("operator", *names)))
    special: dict[str, dict[str, Any]] = {
        "robot12": {"troubled": 1, "troubles": (MachineTrouble("Wall", "failed", ERROR),)},
        "robot3": {"ahead_ns": 90_000_000_000},
    }
    for number, name in enumerate(["", *names]):
        traffic = {"sent_rate": 950.0 * number, "received_rate": 120.0, "leave_rate": 40.0}
        if name != silent:
            publish(board, name, **traffic, **special.get(name, {}))
