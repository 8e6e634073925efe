"""Tokens of Zenoh by which hosts with names find each other: each lives as long as its host."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .keys import Keys, name_in

if TYPE_CHECKING:
    import zenoh

__all__ = ["HostTokens"]


class HostTokens:
    """The tokens of the hosts of a board, which are received while somebody looks for them."""

    def __init__(self, liveliness: Any, keys: Keys) -> None:
        self._liveliness = liveliness
        self._keys = keys
        self._declared: list[Any] = []
        self._subscriber: Any = None
        self._names: dict[str, str] = {}  # by token

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
        """Keep `names` up to date from now on, or no more."""
        if wanted and self._subscriber is None:
            import zenoh

            self._names = names = dict[str, str]()

            def receive(sample: zenoh.Sample) -> None:
                token = str(sample.key_expr)
                if sample.kind == zenoh.SampleKind.PUT:
                    names[token] = name_in(token)
                else:
                    names.pop(token, None)

            self._subscriber = self._subscribe(self._keys.named("*"), receive)
        elif not wanted and self._subscriber is not None:
            self._subscriber.undeclare()
            self._subscriber = None

    @property
    def names(self) -> tuple[str, ...] | None:
        """The names of the hosts that can be reached; None while nobody looks for them."""
        return None if self._subscriber is None else tuple(sorted({*self._names.copy().values()}))

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
