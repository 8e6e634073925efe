"""Hosts, each in namespaces of its own, and a switch between them that can be cut."""

from __future__ import annotations

import os
import subprocess

__all__ = ["HOSTS", "Switch", "address", "run"]

HOSTS = 3


def run(command: str) -> None:
    subprocess.run(command.split(), check=True, capture_output=True, text=True)


class Switch:
    """Namespaces `hosts`, connected by a bridge in one more."""

    def __init__(self) -> None:
        base = f"llfsm{os.getpid()}"
        self.name = f"{base}s"
        self.hosts = [f"{base}h{i}" for i in range(HOSTS)]

    def make(self) -> None:
        for name in (self.name, *self.hosts):
            run(f"ip netns add {name}")
            run(f"ip -n {name} link set lo up")
        run(f"ip -n {self.name} link add bridge type bridge")
        run(f"ip -n {self.name} link set bridge up")
        for i, host in enumerate(self.hosts):
            run(f"ip -n {self.name} link add port{i} type veth peer name eth netns {host}")
            run(f"ip -n {host} addr add {address(i)}/24 dev eth")
            run(f"ip -n {host} link set eth address {hardware(i)} up")
            for other in set(range(HOSTS)) - {i}:  # else a host is looked for, once a second
                run(f"ip -n {host} neigh add {address(other)} lladdr {hardware(other)} dev eth")
            run(f"ip -n {self.name} link set port{i} up")
            self.join(i)

    def prefix(self, host: int) -> list[str]:
        """Make the command that runs another one on a host: in its network, and under its name."""
        rename = ["sh", "-c", f'hostname {self.hosts[host]} && exec "$@"', "sh"]
        return ["ip", "netns", "exec", self.hosts[host], "unshare", "--uts", *rename]

    def cut(self, host: int) -> None:
        """Drop all packets from and to a host, without an error."""
        run(f"ip -n {self.name} link set port{host} nomaster")

    def join(self, host: int) -> None:
        run(f"ip -n {self.name} link set port{host} master bridge")

    def remove(self) -> None:
        for name in (self.name, *self.hosts):
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def address(host: int) -> str:
    return f"10.99.0.{host + 1}"


def hardware(host: int) -> str:
    return f"02:00:00:00:00:{host + 1:02x}"
