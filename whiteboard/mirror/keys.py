"""The keys under which the hosts of a board exchange messages, and which host may use which.

::

    llfsm/VERSION/BOARD/slots/NAME/GROUP/batch              published by the host NAME
    llfsm/VERSION/BOARD/slots/NAME/GROUP/beat               the same: its heartbeats
    llfsm/VERSION/BOARD/beats/NAME                          the same; read by hosts of all versions
    llfsm/VERSION/BOARD/state/NAME/ID/GROUP/ASKER/ASKER-ID  a query of one host to another
    llfsm/VERSION/BOARD/hosts/NAME/AS/ID                    a token: a host that is called AS lives

GROUP is one of slots (see `groups`): a host subscribes to those that are read on it, and Zenoh
sends nothing to which nobody subscribes. A query for all groups has ``all`` in its place.

NAME is the name in a host's certificate, and ``-`` for a host without one. Zenoh's access control
ties the name to the certificate: from a connection with another certificate, such a key is not
accepted. That the layout of the keys under ``beats`` stays lets hosts of different versions report
each other, and those of different boards.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

from llfsm.whiteboard.mirror.batches import VERSION
from llfsm.whiteboard.mirror.groups import EVERY_GROUP
from llfsm.whiteboard.mirror.peers import EVERY_HOST, Source

_NAME = re.compile(r"[^/*$?#\s]{1,64}")
_PARTS = 9  # of the key of a query
_TOKENS = "liveliness_token", "declare_liveliness_subscriber", "liveliness_query"
_ALL = "all"  # for `EVERY_GROUP`, as no part of a key is empty


def usable_name(name: str | None) -> str:
    """Return the name in a certificate, or ``-`` if it cannot be part of a key."""
    return name if name and _NAME.fullmatch(name) else "-"


class Keys:
    """The keys of one host, by its id and the name in its certificate, or ``-``."""

    def __init__(self, board: str, host: int, name: str) -> None:
        self._root = f"llfsm/{VERSION}/{board}"
        self.hello = f"{self._root}/beats/{name}"
        self.all_hellos = "llfsm/*/*/beats/**"  # version 2 had no names
        self._name = name
        self._id = f"{host:016x}"
        self._me = f"{name}/{self._id}"

    def batches(self, group: str) -> str:
        """Return the key of this host's batches of a group."""
        return f"{self._root}/slots/{self._name}/{group}/batch"

    def beats(self, group: str) -> str:
        """Return the key of this host's heartbeats for a group."""
        return f"{self._root}/slots/{self._name}/{group}/beat"

    def received(self, group: str) -> str:
        """Return the keys of all hosts' batches and heartbeats of a group."""
        return f"{self._root}/slots/*/{group or '*'}/*"

    def answered(self, group: str) -> str:
        """Return the keys of queries to this host for a group."""
        return f"{self._root}/state/{self._me}/{group or _ALL}/*/*"

    def query(self, to: Source) -> str:
        """Return the key of a query to a host, whose name may be unknown, or to every host."""
        host = "*" if to.host == EVERY_HOST.host else f"{to.host:016x}"
        return f"{self._root}/state/{to.name or '*'}/{host}/{to.group or _ALL}/{self._me}"

    def alive(self, called: str) -> str:
        """Return the key of this host's token, if it is called so."""
        return f"{self._root}/hosts/{self._name}/{called}/{self._id}"

    def named(self, called: str) -> str:
        """Return the keys of the tokens of all hosts that are called so."""
        return f"{self._root}/hosts/*/{called}/*"

    def is_own(self, token: str) -> bool:
        """Check that a token is this host's."""
        return token.endswith(f"/{self._id}")

    def answer(self, asked: Asked) -> str:
        """Return the key of a reply, which proves whose it is."""
        return f"{self._root}/state/{self._me}/{asked.group or _ALL}/{asked.asker}/{asked.asker_id}"


def host_in(token: str) -> tuple[str, str]:
    """Read from a token the name in its host's certificate, and the host's own name."""
    _, name, called, _ = token.rsplit("/", 3)
    return name, called


def version_in(key: str) -> str:
    """Read the protocol's version from a key."""
    return key.split("/", 2)[1]


def board_in(key: str) -> str:
    """Read the name of the board from a key."""
    return key.split("/", 3)[2]


@lru_cache(maxsize=8192)
def sender_in(key: str) -> tuple[str, str, bool]:
    """Read from a key the name of its publisher, the group, and True if it is of heartbeats."""
    _, name, group, kind = key.rsplit("/", 3)
    return name, group, kind == "beat"


class Asked(NamedTuple):
    """The parts of the key of a query or a reply."""

    name: str
    """In the certificate of the host that replies."""
    group: str
    asker: str
    asker_id: str


def asked_in(key: str) -> Asked | None:
    """Split the key of a query or a reply; None for one that no host has made."""
    parts = key.split("/")
    if len(parts) != _PARTS:
        return None
    name, _, group, asker, asker_id = parts[-5:]
    return Asked(name, EVERY_GROUP if group == _ALL else group, asker, asker_id)


def access_control(names: Iterable[str]) -> dict[str, Any]:
    """Make Zenoh's configuration of access control for hosts with these names.

    Each may read all that this host sends, but publish, ask and reply under its own name only.
    Messages that it forwards for others are not accepted, as their certificates are not seen here.
    """
    sent = ["put", "query", "reply", "declare_subscriber", "declare_queryable", *_TOKENS]
    read = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
    rules = [
        _rule("send", "egress", sent, ["**"]),
        _rule("read", "ingress", read, ["llfsm/**"]),
    ]
    subjects: list[dict[str, Any]] = [{"id": "all"}]
    policies = [{"rules": ["send"], "subjects": ["all"]}]
    for name in names:
        published = [f"llfsm/*/*/slots/{name}/**", f"llfsm/*/*/beats/{name}"]
        own = [
            _rule(f"publish {name}", "ingress", ["put"], published),
            _rule(f"live {name}", "ingress", ["liveliness_token"], [f"llfsm/*/*/hosts/{name}/**"]),
            _rule(f"ask {name}", "ingress", ["query"], [f"llfsm/*/*/state/*/*/*/{name}/*"]),
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
