"""``llfsm demo``: processes that work on one whiteboard."""
