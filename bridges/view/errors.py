"""The error of pages: a request that cannot be met."""

from llfsm.errors import LlfsmError


class RequestError(LlfsmError):
    """A request of a page cannot be met; the page shows the message."""
