"""What is to be explored: machine classes, or functions that make machines, in their order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from types import MemberDescriptorType
from typing import TYPE_CHECKING, Any, NamedTuple

from ..engine.loading import Factory
from ..engine.machine import Machine
from .errors import UnsupportedError

if TYPE_CHECKING:
    from ..engine.arrangement import Arrangement

__all__ = ["Member", "members_of", "require_explorable"]

_SUSPENDED = "Suspended"
_CACHED = type(lru_cache(lambda: None))


class Member(NamedTuple):
    """A machine to explore: its class, or a function that makes it, and how it is loaded.

    `name`, `variables` and `slots` are as for `Arrangement.load`; a `suspended` one is loaded in
    its suspend state. Suspended members come after the others.
    """

    machine: Factory
    name: str | None = None
    variables: Mapping[str, Any] = {}
    slots: Mapping[str, str] = {}
    suspended: bool = False

    def load(self, arrangement: Arrangement) -> None:
        """Load a new machine into `arrangement`."""
        made: Any = self.machine
        if not (isinstance(made, type) and issubclass(made, Machine)):
            made = made()
        load = arrangement.load_suspended if self.suspended else arrangement.load
        load(made, name=self.name, variables=self.variables or None, slots=self.slots)


def require_explorable(cls: type[Machine]) -> None:
    """Raise `UnsupportedError` for a class of which not all that its code depends on is known."""
    table = cls.table
    if table.suspend is None and any(state.name == _SUSPENDED for state in table.states):
        raise UnsupportedError(
            f"{cls.__qualname__} has a state {_SUSPENDED!r} but declares no suspend state, which "
            f"then gets the same name: rename it, or make it State(suspend=True)"
        )
    for base in cls.__mro__[: cls.__mro__.index(Machine)]:
        for name, value in vars(base).items():
            if isinstance(value, _CACHED):
                raise UnsupportedError(
                    f"{cls.__qualname__}.{name} keeps results from one call for the next: that is "
                    f"no part of a state, so this cannot be explored; keep them in a variable"
                )
            if isinstance(value, MemberDescriptorType):
                raise UnsupportedError(
                    f"{cls.__qualname__}.{name} is in __slots__, so it is no variable of the "
                    f"machine, and this cannot be explored: remove __slots__"
                )


def members_of(machines: Factory | Member | Iterable[Factory | Member]) -> tuple[Member, ...]:
    """Return what is to be explored, in order; raise `UnsupportedError` for anything else."""
    one = callable(machines) or isinstance(machines, Machine | Member)
    listed: list[Any] = [machines] if one else list(machines)  # type: ignore[arg-type]
    members = [each if isinstance(each, Member) else Member(each) for each in listed]
    for member in members:
        if not callable(member.machine):
            raise UnsupportedError(
                f"{member.machine!r} is neither a machine class nor a function that returns a "
                f"machine: give the class, or lambda: Class(variable=value)"
            )
    if not members:
        raise UnsupportedError("there are no machines to explore")
    return tuple(sorted(members, key=lambda member: member.suspended))
