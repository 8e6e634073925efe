"""The one module that knows Zenoh: a session, what is published, asked and heard on it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from ..errors import NetworkError
from .exchange import Question
from .settings import DEFAULT_ENDPOINT, Settings
from .wire import VERSION

if TYPE_CHECKING:
    import zenoh

__all__ = ["Network", "Part"]

_ANSWER_S = 5.0

# A cut is noticed within this time and bridged again at this pace, so that boards agree soon after
# it. (A connection that outlived a cut would wait for TCP's own, doubling pauses.)
_LEASE_MS = 1500
_OPEN_MS = 500
_CONNECT_MS = 3000
_ROOM = 1 << 22  # bytes of what travels with the largest message, or without it: names and types
_RETRY = {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1.0}


# Each host connects to all that it hears of, so that no host is between two others.
_EVERYBODY = {"router": ["router", "peer"], "peer": ["router", "peer"], "client": []}

# Zenoh closes a connection by waiting up to ten seconds in one of its threads for what the other
# side has not received (eclipse-zenoh/zenoh#2350). With its default of one or two threads, a host
# that is cut off would silence all others for so long.
_THREADS = "(rx: (worker_threads: 4), tx: (worker_threads: 4))"


class Part(Protocol):
    """Who is behind a network: what arrives is handed to it, in threads of Zenoh's."""

    def hear(self, data: bytes) -> None:
        """Take a batch."""

    def hear_beat(self, data: bytes) -> None:
        """Take a sign of life."""

    def answer(self, data: bytes) -> list[bytes]:
        """Answer another host's question."""

    def hear_answer(self, data: bytes) -> None:
        """Take a part of the answer to one of ours."""

    def answered(self, question: Question, *, whole: bool) -> None:
        """Take note that no more comes of its answer; if not `whole`, there was none."""


class Network:
    """The hosts of one board, as a Zenoh session reaches them.

    Args:
        board: its name, by which hosts find each other.
        host: the id of this one.
        settings: endpoints, and what else Zenoh is told.
        part: who is told what arrives.
        mode: ``peer``, or ``client`` for one that connects to one host and is led by it.

    Raise :class:`.NetworkError` if Zenoh is not installed or cannot do what is asked.

    """

    def __init__(
        self, board: str, host: int, settings: Settings, part: Part, mode: str = "peer"
    ) -> None:
        os.environ.setdefault("ZENOH_RUNTIME", _THREADS)  # looked at when its first session opens
        try:
            import zenoh
        except ImportError as error:
            raise NetworkError(
                "Zenoh is not installed; install llfsm with it: pip install 'llfsm[hosts]'"
            ) from error
        self._part = part
        root = f"llfsm/{VERSION}/{board}"
        self._root = root
        try:
            self._session: Any = zenoh.open(_config(zenoh, settings, mode))
        except zenoh.ZError as error:
            raise NetworkError(f"cannot open {_endpoints(settings)}: {_first(error)}") from error
        # Never waiting for a host that does not listen: what is dropped is noticed by its number.
        outgoing: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "express": True,
        }
        self._batches = self._session.declare_publisher(f"{root}/batches/{host:016x}", **outgoing)
        self._beats = self._session.declare_publisher(f"{root}/beats/{host:016x}", **outgoing)
        remote: dict[str, Any] = {"allowed_origin": zenoh.Locality.REMOTE}
        self._declared: list[Any] = [
            self._session.declare_subscriber(f"{root}/batches/*", _bytes(part.hear), **remote),
            self._session.declare_subscriber(f"{root}/beats/*", _bytes(part.hear_beat), **remote),
            self._session.declare_queryable(f"{root}/state/{host:016x}", self._answer),
        ]

    def send(self, data: bytes) -> None:
        """Send a batch to all other hosts."""
        self._batches.put(data)

    def send_beat(self, data: bytes) -> None:
        """Send a sign of life to all other hosts."""
        self._beats.put(data)

    def ask(self, question: Question) -> None:
        """Ask one host; its answer arrives at the part."""
        from zenoh.handlers import Callback

        heard = False

        def hear(reply: zenoh.Reply) -> None:
            nonlocal heard
            if reply.ok is not None:
                heard = True
                self._part.hear_answer(reply.ok.payload.to_bytes())

        def end() -> None:
            self._part.answered(question, whole=heard)

        self._session.get(
            f"{self._root}/state/{question.host:016x}",
            Callback(hear, end),
            payload=question.data,
            timeout=_ANSWER_S,
            consolidation=_no_consolidation(),
        )

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            payload = query.payload
            for data in self._part.answer(b"" if payload is None else payload.to_bytes()):
                query.reply(query.key_expr, data)

    def close(self) -> None:
        """Leave: nothing is heard any more."""
        for declared in self._declared:
            declared.undeclare()
        self._session.close()


def _bytes(hear: Callable[[bytes], None]) -> Callable[[zenoh.Sample], None]:
    return lambda sample: hear(sample.payload.to_bytes())


def _no_consolidation() -> zenoh.ConsolidationMode:
    from zenoh import ConsolidationMode

    return ConsolidationMode.NONE  # else only the last part of an answer arrives


def _config(zenoh: Any, settings: Settings, mode: str) -> Any:
    """Return Zenoh's configuration: the file if one is given, and what the settings say."""
    if settings.zenoh is None:
        config = zenoh.Config()
        values: dict[str, Any] = {
            "listen/endpoints": [DEFAULT_ENDPOINT] if mode == "peer" else [],
            "scouting/multicast/enabled": False,
            "mode": mode,
        }
    else:
        if not Path(settings.zenoh).is_file():
            raise NetworkError(f"{settings.zenoh}: no such file of Zenoh's configuration")
        try:
            config = zenoh.Config.from_file(settings.zenoh)
        except zenoh.ZError as error:
            raise NetworkError(f"{settings.zenoh}: {_first(error)}") from error
        values = {"mode": mode} if mode == "client" else {}
    values |= {
        "scouting/delay": 1,
        "scouting/gossip/autoconnect": _EVERYBODY,
        "connect/exit_on_failure": mode == "client",
        "connect/timeout_ms": _CONNECT_MS if mode == "client" else -1,
        "connect/retry": _RETRY,
        "transport/shared_memory/enabled": False,  # not used, and left behind when killed
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/rx/max_message_size": settings.largest + _ROOM,
        "transport/unicast/open_timeout": _OPEN_MS,
        "transport/unicast/accept_timeout": _OPEN_MS,
    }
    if settings.listen is not None:
        values["listen/endpoints"] = list(settings.listen)
    if settings.connect is not None:
        values["connect/endpoints"] = list(settings.connect)
    if settings.multicast:
        values["scouting/multicast/enabled"] = True
        values["scouting/multicast/autoconnect"] = _EVERYBODY
    for key, value in values.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise NetworkError(f"Zenoh does not take {key} = {value}: {_first(error)}") from error
    return config


def _endpoints(settings: Settings) -> str:
    listen = settings.listen or ((DEFAULT_ENDPOINT,) if settings.zenoh is None else ())
    return ", ".join((*listen, *(settings.connect or ()))) or str(settings.zenoh)


def _first(error: Exception) -> str:
    """Return what an error of Zenoh's says, without where in its sources."""
    return str(error).partition(" at /")[0]
