"""How a machine touches the whiteboard: sensors are read once a ringlet, actuators post at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, overload

from .errors import NotLoadedError

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot
    from llfsm.whiteboard.message import M
else:
    M = TypeVar("M")  # importing the whiteboard is left to programs that use one
D = TypeVar("D")

__all__ = ["Actuator", "Sensor"]


class Sensor(Generic[M, D]):
    """Read a slot into every snapshot: the latest message, or `default` (None) before the first.

    The value is an ordinary attribute of the machine, set when a ringlet begins.
    """

    declared_once = True

    @overload
    def __init__(self: Sensor[M, None], slot: Slot[M]) -> None: ...
    @overload
    def __init__(self: Sensor[M, M], slot: Slot[M], *, default: M) -> None: ...
    def __init__(self, slot: Slot[M], *, default: Any = None):
        self.slot = slot
        self.default: D = default

    @overload
    def __get__(self, machine: None, owner: type) -> Self: ...
    @overload
    def __get__(self, machine: object, owner: type) -> M | D: ...
    def __get__(self, machine: object | None, owner: type) -> Self | M | D:
        """Return the default: once there is a snapshot, the machine's own attribute is found."""
        return self if machine is None else self.default


class Actuator(Generic[M]):
    """Post to a slot by calling: `self.drive(Twist())` adds the message and returns its count.

    `at_end` is posted once when the machine leaves its arrangement or the arrangement ends,
    however it ends.
    """

    declared_once = True

    def __init__(self, slot: Slot[M], *, at_end: M | None = None):
        self.slot = slot
        self.at_end = at_end

    @overload
    def __get__(self, machine: None, owner: type) -> Self: ...
    @overload
    def __get__(self, machine: object, owner: type) -> Callable[[M], int]: ...
    def __get__(self, machine: object | None, owner: type) -> Self | Callable[[M], int]:
        """Refuse: a loaded machine has a bound function of this name."""
        if machine is None:
            return self
        raise NotLoadedError(
            f"{owner.__qualname__} cannot post to {self.slot.name!r}: load it into an Arrangement"
        )
