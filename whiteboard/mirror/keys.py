"""The keys under which the hosts of a board exchange messages, and which host may use which.

::

    llfsm/VERSION/BOARD/batches/NAME                  published by the host NAME
    llfsm/VERSION/BOARD/beats/NAME                    the same; read by hosts of every version
    llfsm/VERSION/BOARD/state/NAME/ID/ASKER/ASKER-ID  a query of one host to another

NAME is the name in a host's certificate, and ``-`` for a host without one. Zenoh's access control
ties the name to the certificate: from a connection with another certificate, such a key is not
accepted. That the layout of the heartbeats' keys stays lets hosts of different versions report each
other.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from .batches import VERSION
from .peers import Source

__all__ = ["Keys", "access_control", "asker_in", "name_in", "usable_name", "version_in"]

_NAME = re.compile(r"[^/*$?#\s]{1,64}")


def usable_name(name: str | None) -> str:
    """Return the name of a certificate, or ``-`` if it cannot be part of a key."""
    return name if name and _NAME.fullmatch(name) else "-"


class Keys:
    """The keys of one host.

    Args:
        board: the board's name.
        host: the id of this host.
        name: the one in its certificate, or ``-``.

    """

    def __init__(self, board: str, host: int, name: str) -> None:
        root = f"llfsm/{VERSION}/{board}"
        self.batches = f"{root}/batches/{name}"
        self.beats = f"{root}/beats/{name}"
        self.all_batches = f"{root}/batches/*"
        self.all_beats = f"llfsm/*/{board}/beats/**"  # version 2 had no names
        self.queries = f"{root}/state/{name}/{host:016x}/*/*"
        self._state = f"{root}/state"
        self._asker = f"{name}/{host:016x}"

    def query(self, to: Source) -> str:
        """Return the key of a query to a host, whose name may be unknown."""
        return f"{self._state}/{to.name or '*'}/{to.host:016x}/{self._asker}"


def version_in(key: str) -> str:
    """Return the protocol's version in a key."""
    return key.split("/", 2)[1]


def name_in(key: str) -> str:
    """Return the name of the host that has published under a key."""
    return key.rpartition("/")[2]


def asker_in(key: str) -> str:
    """Return the name of the host that asks with a query's key."""
    return key.rsplit("/", 2)[1]


def access_control(names: Iterable[str]) -> dict[str, Any]:
    """Return Zenoh's configuration of access control: what hosts with these names may use.

    Each may read what this host sends, but publish, ask and reply under its own name only. What it
    forwards for others is not accepted, as their certificates are not seen here.
    """
    sent = ["put", "query", "reply", "declare_subscriber", "declare_queryable"]
    rules = [
        _rule("send", "egress", sent, ["**"]),
        _rule("read", "ingress", ["declare_subscriber"], ["llfsm/**"]),
    ]
    subjects: list[dict[str, Any]] = [{"id": "all"}]
    policies = [{"rules": ["send"], "subjects": ["all"]}]
    for name in names:
        published = [f"llfsm/*/*/batches/{name}", f"llfsm/*/*/beats/{name}"]
        own = [
            _rule(f"publish {name}", "ingress", ["put"], published),
            _rule(f"ask {name}", "ingress", ["query"], [f"llfsm/*/*/state/*/*/{name}/*"]),
            _rule(
                f"reply {name}",
                "ingress",
                ["declare_queryable", "reply"],
                [f"llfsm/*/*/state/{name}/**"],
            ),
        ]
        rules += own
        subjects.append({"id": f"host {name}", "cert_common_names": [name]})
        policies.append(
            {"rules": ["read", *(rule["id"] for rule in own)], "subjects": [f"host {name}"]}
        )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "messages": messages,
        "flows": [flow],
        "permission": "allow",
        "key_exprs": keys,
    }
