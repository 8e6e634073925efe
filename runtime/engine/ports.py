"""Sensors, which are read once a ringlet, and actuators, which post at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, Generic, NoReturn, Self, TypeVar, overload

from llfsm.runtime.engine.errors import ActuatorClosedError, DefinitionError, NotLoadedError

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot
    from llfsm.whiteboard.message import M
else:
    M = TypeVar("M")  # importing the whiteboard is left to programs that use one
D = TypeVar("D")

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


class Sensor(Generic[M, D]):
    """Read a slot into every snapshot: the latest message, or `default` (None) before the first.

    The value is an ordinary attribute of the machine, set when a ringlet begins. A message that is
    older than `max_age_ms` milliseconds then, by the arrangement's clock, reads as `default`; so
    does, with `since_start`, a message from before the machine was loaded.

    `domain` holds the messages, and None for no message, that verification expects there: see
    `llfsm.runtime.verification`. A machine that runs makes no use of it.
    """

    declared_once = True

    @overload
    def __init__(
        self: Sensor[M, None],
        slot: Slot[M],
        *,
        max_age_ms: float | None = None,
        since_start: bool = False,
        domain: Iterable[M | None] | None = None,
    ) -> None: ...
    @overload
    def __init__(
        self: Sensor[M, M],
        slot: Slot[M],
        *,
        default: M,
        max_age_ms: float | None = None,
        since_start: bool = False,
        domain: Iterable[M | None] | None = None,
    ) -> None: ...
    def __init__(
        self,
        slot: Slot[M],
        *,
        default: Any = None,
        max_age_ms: float | None = None,
        since_start: bool = False,
        domain: Iterable[Any] | None = None,
    ):
        if max_age_ms is not None and not max_age_ms > 0:
            raise DefinitionError(
                f"a sensor of {slot.name!r}: max_age_ms is {max_age_ms!r}; it must be more than 0"
            )
        _check_slot("a sensor", slot)
        self.slot = slot
        self.default: D = default
        self.max_age_ms = max_age_ms
        self.since_start = since_start
        self.domain = tuple(domain) if isinstance(domain, Iterator) else domain

    @overload
    def __get__(self, machine: None, owner: type) -> Self: ...
    @overload
    def __get__(self, machine: object, owner: type) -> M | D: ...
    def __get__(self, machine: object | None, owner: type) -> Self | M | D:
        """Return the default: once there is a snapshot, the machine's own attribute is found."""
        return self if machine is None else self.default


class Keep(Enum):
    """Instead of a safe value: a suspension posts nothing."""

    KEEP = "KEEP"


KEEP: Final = Keep.KEEP
"""As `at_suspend`: a suspension posts nothing, as the suspend state brings the robot to rest."""


class Actuator(Generic[M]):
    """Post to a slot by calling: `self.drive(Twist())` adds the message and returns its count.

    Safe values are posted by the arrangement itself: `at_suspend` when a suspension of the machine
    takes effect, before its OnSuspend; `at_failure` when code of the machine raises; `at_end` once
    when the machine leaves its arrangement or the arrangement ends, however it ends. By default
    `at_failure` is `at_suspend`, and that is `at_end`; without any, nothing is posted. A restart
    posts `at_suspend`, too. With `at_suspend=KEEP` a suspension posts nothing: the suspend state's
    own code brings the robot to rest; a restart and a failure then post `at_end` by default.

    With `exclusive`, no other machine on the board may have an exclusive actuator of the slot:
    the second one is not loaded (`ActuatorTakenError`), whichever process runs it.
    """

    declared_once = True

    def __init__(
        self,
        slot: Slot[M],
        *,
        at_suspend: M | Keep | None = None,
        at_end: M | None = None,
        at_failure: M | None = None,
        exclusive: bool = False,
    ):
        _check_slot("an actuator", slot)
        self.slot = slot
        self.exclusive = exclusive
        self.at_end = at_end
        self.at_restart = at_end if at_suspend in (None, KEEP) else at_suspend
        self.at_suspend = None if at_suspend is KEEP else self.at_restart
        self.at_failure = self.at_restart if at_failure is None else at_failure

    def closed(self, machine: str) -> Callable[[M], NoReturn]:
        """Make the stand-in for the actuator of a machine that has ended: it refuses to post."""

        def refuse(message: M) -> NoReturn:
            raise ActuatorClosedError(
                f"{machine} has ended and cannot post to {self.slot.name!r} any more; "
                f"did a thread of it go on?"
            )

        return refuse

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


def _check_slot(what: str, slot: object) -> None:
    """Refuse what is no slot: the whiteboard is not imported for it."""
    if not (hasattr(slot, "name") and hasattr(slot, "type")):
        given = slot.__name__ if isinstance(slot, type) else repr(slot)
        raise DefinitionError(f"{what} needs a slot, as Slot('name', Type), not {given}")
