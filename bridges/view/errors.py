"""The errors of the page.

::

    LlfsmError
    └── ViewError
        └── RequestError    a request of a page cannot be met
"""

from llfsm.errors import LlfsmError


class ViewError(LlfsmError):
    """The base of the errors of showing a whiteboard."""


class RequestError(ViewError):
    """A request of a page cannot be met; the page shows the message."""
