"""What can go wrong with a page.

ViewError
└── RequestError    what a page has asked for cannot be done
"""

from llfsm.errors import LlfsmError

__all__ = ["RequestError", "ViewError"]


class ViewError(LlfsmError):
    """Everything that showing a whiteboard raises."""


class RequestError(ViewError):
    """What a page has asked for cannot be done; the page shows why."""
