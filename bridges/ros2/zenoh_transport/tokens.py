"""Zenoh keys of ROS 2: where messages go, and the liveliness tokens that describe the graph.

    data      <domain>/<name>/<DDS type>/<type hash>
    node      @ros2_lv/<domain>/<session>/<node id>/<node id>/NN/<enclave>/<namespace>/<node>
    endpoint  @ros2_lv/<domain>/<session>/<node id>/<id>/<MP MS SS SC>/<enclave>/<namespace>/<node>
              /<name>/<DDS type>/<type hash>/<qos>

In a token a ``/`` inside a part is written ``%``, and so is an empty part. The qos is
``<reliability>:<durability>:<history>,<depth>:<deadline>:<lifespan>:<liveliness>``; what is left
out is the default.
"""

from __future__ import annotations

from typing import NamedTuple

from ..graph import Endpoint, Role
from ..qos import DurabilityPolicy, HistoryPolicy, Qos, ReliabilityPolicy

__all__ = ["Token", "data_key", "domain_tokens", "endpoint_token", "node_token", "parse"]

_ROOT = "@ros2_lv"
_CODES = {"MP": Role.PUBLISHER, "MS": Role.SUBSCRIPTION, "SS": Role.SERVER, "SC": Role.CLIENT}
_ROLES = {role: code for code, role in _CODES.items()}
_NODE_CODE = "NN"
_NODE_PARTS = 9
_ENDPOINT_PARTS = 13
_DEFAULT_DEPTH = 42  # of rmw_zenoh's default profile, which peers leave out of tokens
_DEFAULT = Qos(depth=_DEFAULT_DEPTH)


class Token(NamedTuple):
    """A parsed token."""

    session: str
    node: str
    """The node's full name."""
    endpoint: Endpoint | None
    """None: the token is the node's own."""


def data_key(domain: int, name: str, dds_type: str, type_hash: str) -> str:
    """Return the key under which a topic's messages are put, or a service is asked."""
    return f"{domain}/{name.strip('/')}/{dds_type}/{type_hash}"


def domain_tokens(domain: int) -> str:
    """Return the key expression of all tokens of a domain."""
    return f"{_ROOT}/{domain}/**"


def node_token(domain: int, session: str, number: int, namespace: str, node: str) -> str:
    """Return a node's token; ``number`` is its own within the session."""
    return "/".join(
        (
            _ROOT,
            str(domain),
            session,
            str(number),
            str(number),
            _NODE_CODE,
            "%",  # the enclave: none
            _mangle(namespace),
            node,
        )
    )


def endpoint_token(node: str, number: int, end: Endpoint, dds_type: str) -> str:
    """Return the token of an endpoint of the node whose token is ``node``."""
    root, domain, session, node_number, _, _, *named = node.split("/")
    return "/".join(
        (
            root,
            domain,
            session,
            node_number,
            str(number),
            _ROLES[end.role],
            *named,
            _mangle(end.name),
            dds_type,
            end.type_hash or "%",
            _qos_text(end.qos or _DEFAULT),
        )
    )


def parse(key: str) -> Token | None:
    """Parse a token; return None if the key is not one."""
    parts = key.split("/")
    if len(parts) < _NODE_PARTS or parts[0] != _ROOT:
        return None
    session, code = parts[2], parts[5]
    node = f"{_demangle(parts[7]).rstrip('/')}/{parts[8]}"
    if code == _NODE_CODE and len(parts) == _NODE_PARTS:
        return Token(session, node, None)
    role = _CODES.get(code)
    if role is None or len(parts) != _ENDPOINT_PARTS:
        return None
    name, dds_type, type_hash, qos_text = parts[9:]
    try:
        qos = _parse_qos(qos_text)
    except ValueError:
        return None
    end = Endpoint(role, node, _demangle(name), _ros_type(dds_type), type_hash, qos)
    return Token(session, node, end)


def _mangle(name: str) -> str:
    return name.replace("/", "%") or "%"


def _demangle(part: str) -> str:
    return part.replace("%", "/")


def _ros_type(dds_type: str) -> str:
    """Return ``package/msg/Name`` of ``package::msg::dds_::Name_``, else what was given."""
    package, *kind, name = dds_type.split("::")
    if len(kind) == 2 and kind[1] == "dds_" and name.endswith("_"):
        return f"{package}/{kind[0]}/{name[:-1]}"
    return dds_type


def _qos_text(qos: Qos) -> str:
    reliability, durability, history, depth = (
        "" if ours == default else str(int(ours))
        for ours, default in zip(qos, _DEFAULT, strict=True)
    )
    return f"{reliability}:{durability}:{history},{depth}:,:,:,,"


def _parse_qos(text: str) -> Qos:
    reliability, durability, history, *_ = text.split(":")
    kind, depth = history.split(",")
    return Qos(
        ReliabilityPolicy(_number(reliability, _DEFAULT.reliability)),
        DurabilityPolicy(_number(durability, _DEFAULT.durability)),
        HistoryPolicy(_number(kind, _DEFAULT.history)),
        _number(depth, _DEFAULT_DEPTH),
    )


def _number(text: str, default: int) -> int:
    return int(text or "0") or default  # 0 is "system default"
