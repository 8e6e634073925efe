"""The graph, from tokens that come and go."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any

import zenoh

from ..graph import Endpoint, Graph, Role
from ..notices import Notifier
from ..timer_thread import TimerThread
from .receiving import hand_over
from .tokens import Token, domain_tokens, parse

__all__ = ["Discovery"]


class Discovery:
    """Knows the tokens of a domain, and reports endpoints that are incompatible with ours."""

    def __init__(
        self, session: zenoh.Session, domain: int, notifier: Notifier, events: TimerThread
    ) -> None:
        self._ours = str(session.zid())
        self._notifier = notifier
        self._tokens: dict[str, Token] = {}
        self._by_name: dict[str, dict[str, Token]] = {}
        self._graph: Graph | None = None
        self._changed = threading.Condition()
        self._over = False
        self._subscriber: zenoh.Subscriber[Any] = session.liveliness().declare_subscriber(
            domain_tokens(domain), hand_over(self._on_token, events), history=True
        )

    def close(self) -> None:
        """Stop listening; waits return."""
        self._subscriber.undeclare()
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def graph(self) -> Graph:
        """Return the graph as it is known now."""
        with self._changed:
            if self._graph is None:
                tokens = self._tokens.values()
                self._graph = Graph.of(
                    (token.node for token in tokens if token.endpoint is None), _endpoints(tokens)
                )
            return self._graph

    def wait(self, ready: Callable[[Graph], bool], timeout: float) -> bool | None:
        """Wait until ``ready(graph)`` is true; return None if it is closed meanwhile."""
        with self._changed:
            done = self._changed.wait_for(lambda: self._over or ready(self.graph()), timeout)
            return None if self._over else done

    def look_again(self, _: zenoh.MatchingStatus) -> None:
        """Wake all waits: something changed that no token shows."""
        with self._changed:
            self._changed.notify_all()

    def why_unserved(self, service: str) -> str:
        """Return why a call found no server with its type."""
        types = {end.type_name for end in self.named(service) if end.role is Role.SERVER}
        if types:
            return f"{service} is served, but with another type: {', '.join(sorted(types))}"
        return f"no server for {service}"

    def named(self, name: str) -> list[Endpoint]:
        """Return the endpoints of one name."""
        with self._changed:
            return list(_endpoints(self._by_name.get(name, {}).values()))

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        token = parse(key)
        if token is None:
            return  # of a newer version of ROS, or of another program
        if sample.kind == zenoh.SampleKind.DELETE:
            self._remove(key, token)
        else:
            self._add(key, token)

    def _remove(self, key: str, token: Token) -> None:
        with self._changed:
            self._tokens.pop(key, None)
            if token.endpoint is not None:
                of_name = self._by_name.get(token.endpoint.name, {})
                of_name.pop(key, None)
                if not of_name:
                    self._by_name.pop(token.endpoint.name, None)
            self._announce()

    def _add(self, key: str, token: Token) -> None:
        with self._changed:
            self._tokens[key] = token
            others = []
            if token.endpoint is not None:
                of_name = self._by_name.setdefault(token.endpoint.name, {})
                others = list(of_name.values())
                of_name[key] = token
            self._announce()
        for other in others:
            for ours, theirs in ((other, token), (token, other)):
                if ours.session == self._ours and ours.endpoint and theirs.endpoint:
                    self._notifier.compare(ours.endpoint, theirs.endpoint)

    def _announce(self) -> None:
        self._graph = None
        self._changed.notify_all()


def _endpoints(tokens: Iterable[Token]) -> list[Endpoint]:
    return [token.endpoint for token in tokens if token.endpoint is not None]
