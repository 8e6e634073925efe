"""What all tests need of the process that runs them."""

import signal
from collections.abc import Iterator

import pytest

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def pytest_configure() -> None:
    """Take SIGINT as a terminal's program does, also when a shell's background job runs us.

    There it is ignored, and every process that a test starts would inherit that.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _signal_handlers() -> Iterator[None]:
    """Give back the handlers that a command called in this process, not in its own, has taken."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
