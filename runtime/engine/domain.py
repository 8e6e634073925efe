"""What a sensor's `domain` must be: messages of its slot, each once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from .errors import DefinitionError

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot

__all__ = ["MOST", "messages_of_domain"]

MOST = 100_000
"""Values of a domain; far fewer already make too many states."""


def messages_of_domain(slot: Slot[Any], domain: object) -> tuple[Any, ...]:
    """Return the messages, and None for no message, of a domain for `slot`, each once.

    Raise `DefinitionError`, which says what is wrong with the domain but not where it is.
    """
    wanted = slot.type.__qualname__
    if isinstance(domain, str | bytes) or not isinstance(domain, Iterable):
        name = getattr(domain, "__qualname__", "")
        given = f"the {'class' if isinstance(domain, type) else 'function'} {name}"
        raise DefinitionError(
            f"the domain is {given if name else repr(domain)}; it must list {wanted} messages, "
            f"as every({wanted}) does"
        )
    found: dict[bytes | None, Any] = {}
    for message in domain:
        if message is None:
            found[None] = None
            continue
        if isinstance(message, type):
            raise DefinitionError(
                f"the class {message.__qualname__} is in the domain: it must list messages, as "
                f"{wanted}()"
            )
        if type(message) is not slot.type:
            raise DefinitionError(
                f"{message!r} in the domain is of type {type(message).__qualname__}, "
                f"not {wanted} (or None, for no message)"
            )
        try:
            data = slot.encoder.encode(message)
            found[data] = slot.decoder.decode(data)
        except Exception as error:  # a field's own code may raise anything
            raise DefinitionError(f"{message!r} in the domain: {error}") from error
        if len(found) > MOST:
            raise DefinitionError(f"the domain has more than {MOST} messages")
    if not found:
        raise DefinitionError("the domain is empty")
    return tuple(found.values())
