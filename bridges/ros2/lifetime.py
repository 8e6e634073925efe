"""Objects that are closed once, after the objects they own."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Self

from .errors import TransportClosedError

__all__ = ["Closable"]


class Closable(ABC):
    """An object that any thread may close at any time, more than once.

    The objects it owns are closed first, the newest first. It is a context manager. Code that
    creates an owned object holds ``_lifetime`` meanwhile, so that nothing is created in an object
    that is being closed.
    """

    def __init__(self, owner: Closable | None = None) -> None:
        """Belong to ``owner``; raise :class:`.TransportClosedError` if that is closed."""
        self._closed = False
        self._owned: dict[Closable, None] = {}
        self._owner = owner
        # One for a whole tree: an owner that is closing gets no new things.
        self._lifetime: threading.RLock = owner._lifetime if owner else threading.RLock()
        if owner:
            with self._lifetime:
                owner._check_open()
                owner._owned[self] = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def closed(self) -> bool:
        """Whether closing has begun."""
        return self._closed

    def close(self) -> None:
        """Close it and what it owns. Callbacks that have begun may still be running."""
        with self._lifetime:
            if self._closed:
                return
            self._closed = True
            owned = list(self._owned)
            if self._owner:
                self._owner._owned.pop(self, None)
        with ExitStack() as last_first:  # all of it, whatever one of them raises
            last_first.callback(self._close)
            for each in owned:
                last_first.callback(each.close)

    @abstractmethod
    def _close(self) -> None:
        """Release the resources of this object alone."""

    def _check_open(self) -> None:
        if self._closed:
            raise TransportClosedError(f"{self} is closed")
