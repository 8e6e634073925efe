"""Where commands log to."""

from __future__ import annotations

import logging

__all__ = ["log_to_console"]


def log_to_console(level: int, *handlers: logging.Handler, is_on: bool = True) -> None:
    """Log the texts of messages from `level` on, by default to standard error.

    `handlers` log them elsewhere. If the console `is_on` is false, as ROS's arguments may say,
    nothing is logged.
    """
    used = handlers or (logging.StreamHandler(),)
    if not is_on:
        used = (logging.NullHandler(),)  # without a handler, Python would print warnings
    logging.basicConfig(level=level, format="%(message)s", handlers=used)
