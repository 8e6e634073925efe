"""Opens a transport by its name; what it needs is imported when it is opened."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from .defaults import TRANSPORTS, choose_transport
from .errors import TransportUnavailableError
from .notices import log_notice
from .transport import Notice, Transport

__all__ = ["explaining_missing", "open_transport"]


def open_transport(
    name: str = "auto",
    domain: int | None = None,
    *,
    router: Sequence[str] = (),
    enclave: str = "",
    notify: Callable[[Notice], None] = log_notice,
) -> Transport:
    """Open a transport: ``rclpy``, ``zenoh``, or ``auto`` (see :func:`.choose_transport`).

    ``domain`` defaults to ``ROS_DOMAIN_ID``. ``router`` names Zenoh endpoints, as
    ``tcp/localhost:7447``; ``enclave`` is the security enclave of the nodes. Raise
    :class:`.TransportUnavailableError` and :class:`.DomainIdError`.
    """
    chosen = choose_transport(name, router=bool(router))
    if chosen == "rclpy":
        with explaining_missing():
            from .rclpy_transport.transport import RclpyTransport

            return RclpyTransport(domain, enclave=enclave, notify=notify)
    if chosen == "zenoh":
        with explaining_missing():
            from .zenoh_transport.transport import ZenohTransport

            return ZenohTransport(domain, router=router or None, enclave=enclave, notify=notify)
    known = ", ".join(TRANSPORTS)
    raise TransportUnavailableError(f"unknown transport {name!r}: not one of {known}")


_EXTRA = "install it with: pip install 'llfsm[ros]'"
_GET = {
    "zenoh": _EXTRA,
    "xxhash": _EXTRA,
    "rclpy": "source a ROS 2 environment that has it, as: source /opt/ros/jazzy/setup.bash",
}


@contextmanager
def explaining_missing() -> Iterator[None]:
    """Raise :class:`.TransportUnavailableError` for a missing library, with how to get it."""
    try:
        yield
    except ModuleNotFoundError as error:
        how = _GET.get((error.name or "").partition(".")[0])
        if how is None:
            raise
        raise TransportUnavailableError(f"{error.name} is not installed; {how}") from error
