"""What all tests need of the process that runs them."""

import signal


def pytest_configure() -> None:
    """Take SIGINT as a terminal's program does, also when a shell's background job runs us.

    There it is ignored, and every process that a test starts would inherit that.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
