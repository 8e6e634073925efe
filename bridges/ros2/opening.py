"""Ways into ROS by name; what one needs is imported when it is opened."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from .errors import TransportUnavailableError
from .telling import log_notice
from .transport import Notice, Transport

__all__ = ["WAYS", "explained", "open_transport"]

WAYS = ("auto", "rclpy", "zenoh")


def open_transport(
    way: str = "auto",
    domain: int | None = None,
    *,
    router: Sequence[str] = (),
    notify: Callable[[Notice], None] = log_notice,
) -> Transport:
    """Open a way into ROS: ``rclpy``, ``zenoh``, or ``auto``.

    ``auto`` is rclpy where a ROS environment is sourced (rclpy can be imported), as its nodes may
    use any middleware; else Zenoh, as with a ``router`` (endpoints as ``tcp/localhost:7447``),
    which says nothing to rclpy. ``domain`` defaults to ``ROS_DOMAIN_ID``. Raise
    :class:`.TransportUnavailableError` and :class:`.DomainIdError`.
    """
    if way == "auto":
        way = "rclpy" if importlib.util.find_spec("rclpy") and not router else "zenoh"
    if way == "rclpy":
        with explained():
            from .rclpy_transport.transport import RclpyTransport

            return RclpyTransport(domain, notify=notify)
    if way == "zenoh":
        with explained():
            from .zenoh_transport.transport import ZenohTransport

            return ZenohTransport(domain, router=router or None, notify=notify)
    raise TransportUnavailableError(f"no way into ROS is called {way!r}: {', '.join(WAYS)}")


_EXTRA = "install it with: pip install 'llfsm[ros]'"
_GET = {
    "zenoh": _EXTRA,
    "xxhash": _EXTRA,
    "rclpy": "source a ROS 2 environment that has it, as: source /opt/ros/jazzy/setup.bash",
}


@contextmanager
def explained() -> Iterator[None]:
    """Raise :class:`.TransportUnavailableError` where a library is missing, with how to get it."""
    try:
        yield
    except ModuleNotFoundError as error:
        how = _GET.get((error.name or "").partition(".")[0])
        if how is None:
            raise
        raise TransportUnavailableError(f"{error.name} is not installed; {how}") from error
