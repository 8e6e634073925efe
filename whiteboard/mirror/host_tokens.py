"""Tokens of Zenoh by which hosts with names find each other: each lives as long as its host."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .keys import Keys, host_in
from .settings import Settings

if TYPE_CHECKING:
    import zenoh

__all__ = ["HostTokens"]


class HostTokens:
    """The tokens of the hosts of a board, which are received while somebody looks for them.

    Args:
        liveliness: that of a Zenoh session.
        keys: of this host.
        settings: of the daemon. As many tokens are looked at as a host may make slots, as those who
            show the hosts have slots for each: of each certificate if these are known, else of all.

    """

    def __init__(self, liveliness: Any, keys: Keys, settings: Settings) -> None:
        self._liveliness = liveliness
        self._keys = keys
        self._most = settings.quota.slots
        self._access = settings.access
        self._declared: list[Any] = []
        self._subscriber: Any = None
        self._tokens = defaultdict[str, set[str]](set)
        self._names: tuple[str, ...] = ()
        self._has_changed = True  # since `_names` was made
        self._has_ignored = False

    def declare(self, name: str, refuse: Callable[[str, str], None]) -> None:
        """Let other hosts know the name of this one, and report those that have it, too."""
        import zenoh

        def receive(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT and not self._keys.is_own(str(sample.key_expr)):
                refuse(
                    f"another host that is {name!r}",
                    "slots of both are mixed up; give each host a name of its own (`as`)",
                )

        self._declared += [
            self._subscribe(self._keys.named(name), receive),
            self._liveliness.declare_token(self._keys.alive(name)),
        ]

    def look(self, wanted: bool) -> None:
        """Keep `names` up to date from now on, or no more; call it about once a second."""
        has_room = self._has_ignored and min(map(len, [*self._tokens.values()])) < self._most
        if self._subscriber is not None and (has_room or not wanted):
            self._subscriber.undeclare()
            self._subscriber = None
        if wanted and self._subscriber is None:
            self._receive_tokens()

    def _receive_tokens(self) -> None:
        import zenoh

        self._tokens = tokens = defaultdict[str, set[str]](set)
        self._has_changed, self._has_ignored = True, False

        def receive(sample: zenoh.Sample) -> None:
            token = str(sample.key_expr)
            of_one = tokens[host_in(token)[0] if self._access else ""]
            if sample.kind != zenoh.SampleKind.PUT:
                of_one.discard(token)
            elif len(of_one) < self._most:
                of_one.add(token)
            else:
                self._has_ignored = True
            self._has_changed = True

        self._subscriber = self._subscribe(self._keys.named("*"), receive)

    @property
    def names(self) -> tuple[str, ...] | None:
        """The names of the hosts that can be reached; None while nobody looks for them."""
        if self._subscriber is None:
            return None
        if self._has_changed:
            self._has_changed = False
            tokens = [token for of_one in [*self._tokens.values()] for token in of_one.copy()]
            self._names = tuple(sorted({host_in(token)[1] for token in tokens}))
        return self._names

    def close(self) -> None:
        """Withdraw this host's token, and receive no more."""
        self.look(False)
        for declared in self._declared:
            declared.undeclare()

    def _subscribe(self, keys: str, receive: Callable[[zenoh.Sample], None]) -> Any:
        from zenoh.handlers import Callback

        return self._liveliness.declare_subscriber(
            keys, Callback(receive, indirect=False), history=True
        )
