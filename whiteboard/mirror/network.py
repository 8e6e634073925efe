"""A session of Zenoh: what is published, asked and heard on it."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from ctypes import pythonapi
from threading import Thread, get_ident
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from ..errors import BoardClosedError, NetworkError
from .configuration import LEASE_MS, configure, endpoints, plain
from .exchange import Question
from .links import let_go_in_time
from .settings import Settings
from .wire import VERSION

if TYPE_CHECKING:
    import zenoh

__all__ = ["Network", "Part"]

T = TypeVar("T")

_ANSWER_S = 5.0
_ASKED = 64  # questions that wait for their answers
_READY = 64  # threads of Zenoh's that stay known to Python; it may replace some now and then

# The thread that sees a message arrive hands it over itself, and wakes no other one to do so. What
# is sent keeps a thread of its own: a message that is passed on may wait for room there.
_THREADS = "(rx: (worker_threads: 4), net: (handover: rx), acc: (handover: rx))"


class Part(Protocol):
    """Who is behind a network: what arrives is handed to it, in threads of Zenoh's."""

    def linked(self) -> None:
        """Take note of a new connection."""

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
        mode: ``peer``, or ``client`` for one that connects to one host and is led by it.

    Raise :class:`.NetworkError` if Zenoh is not installed or cannot do what is asked.

    """

    def __init__(self, board: str, host: int, settings: Settings, mode: str = "peer") -> None:
        os.environ.setdefault("ZENOH_RUNTIME", _THREADS)  # looked at when its first session opens
        try:
            import zenoh
        except ImportError as error:
            raise NetworkError(
                "Zenoh is not installed; install llfsm with it: pip install 'llfsm[hosts]'"
            ) from error
        self._root = f"llfsm/{VERSION}/{board}"
        self._host = host
        config = configure(settings, mode)
        self.listens = endpoints(config, "listen")
        """Where other hosts reach this one."""
        try:
            self._session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            where = ", ".join((*self.listens, *endpoints(config, "connect")))
            raise NetworkError(f"cannot open {where}: {plain(error)}") from error
        # Never waiting for a host that does not listen: what is dropped is noticed by its number.
        outgoing: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "express": True,
            "allowed_destination": zenoh.Locality.REMOTE,
        }
        # One key for all hosts: Zenoh finds the way of a key that is listened to by its own name
        # once, and that of one which matches a wildcard anew for each message.
        self._batches = self._session.declare_publisher(f"{self._root}/batches", **outgoing)
        self._beats = self._session.declare_publisher(f"{self._root}/beats", **outgoing)
        self._declared: list[Any] = []
        self._threads: list[Thread] = []

    def join(self, part: Part) -> None:
        """Hear the other hosts, and be heard."""
        import zenoh
        from zenoh.handlers import FifoChannel

        self._part = part
        session, root = self._session, self._root
        remote: dict[str, Any] = {"allowed_origin": zenoh.Locality.REMOTE}
        questions = session.declare_queryable(
            f"{root}/state/{self._host:016x}", FifoChannel(_ASKED)
        )
        links = session.info.declare_link_events_listener(FifoChannel(_ASKED), history=True)
        self._declared += [
            session.declare_subscriber(f"{root}/batches", _at_once(part.hear), **remote),
            session.declare_subscriber(f"{root}/beats", _at_once(part.hear_beat), **remote),
            questions,
            links,
        ]
        self._serve(questions.handler.recv, self._answer)
        self._serve(links.handler.recv, self._link)

    def _serve(self, take: Callable[[], T], do: Callable[[T], None]) -> None:
        """Do what takes its time in a thread of its own, until what it takes from is closed."""
        import zenoh

        def run() -> None:
            while True:
                try:
                    thing = take()
                except zenoh.ZError:
                    return
                with suppress(BoardClosedError, zenoh.ZError):  # the board, or who asks, is gone
                    do(thing)

        # Zenoh would start one, too, but one that a process would wait for at its end.
        self._threads.append(Thread(target=run, name=f"mirror {do.__name__}", daemon=True))
        self._threads[-1].start()

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
            Callback(hear, end, indirect=False),  # else a thread a call
            payload=question.data,
            timeout=_ANSWER_S,
            consolidation=_no_consolidation(),
        )

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            payload = query.payload
            for data in self._part.answer(b"" if payload is None else payload.to_bytes()):
                query.reply(query.key_expr, data)

    def _link(self, event: zenoh.LinkEvent) -> None:
        from zenoh import SampleKind

        if event.kind == SampleKind.PUT:
            let_go_in_time(event.link, LEASE_MS)
            self._part.linked()

    def close(self) -> None:
        """Leave: nothing is heard any more."""
        for declared in self._declared:
            declared.undeclare()
        for thread in self._threads:
            thread.join()
        self._session.close()


def _at_once(hear: Callable[[bytes], None]) -> zenoh.handlers.Callback[zenoh.Sample]:
    """Return what hears in Zenoh's own thread: another one would have to be woken."""
    from zenoh.handlers import Callback

    ready: set[int] = set()

    def callback(sample: zenoh.Sample) -> None:
        thread = get_ident()
        if thread not in ready and len(ready) < _READY:
            ready.add(thread)
            pythonapi.PyGILState_Ensure()  # else Python sets the thread up anew for each message
        hear(sample.payload.to_bytes())

    return Callback(callback, indirect=False)


def _no_consolidation() -> zenoh.ConsolidationMode:
    from zenoh import ConsolidationMode

    return ConsolidationMode.NONE  # else only the last part of an answer arrives
