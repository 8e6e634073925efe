"""Events of publishers and subscriptions, such as a missed deadline."""

from __future__ import annotations


class UnsupportedEventTypeError(Exception):
    pass


class EventCallbacks:
    supported = True
    """Whether the middleware reports deadlines and liveliness, as those of DDS do."""

    def __init__(self, *, use_default_callbacks, deadline=None, liveliness=None):
        assert not use_default_callbacks
        self.deadline, self.liveliness = deadline, liveliness

    def check(self):
        if not self.supported and (self.deadline or self.liveliness):
            raise UnsupportedEventTypeError
