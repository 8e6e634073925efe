"""The runtime's logger."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from logging import Logger


def logger() -> Logger:
    """Return the logger `llfsm.runtime`, importing logging only when there is something to log."""
    import logging

    return logging.getLogger("llfsm.runtime")
