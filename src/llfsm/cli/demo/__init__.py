"""``llfsm demo``: processes that meet on a whiteboard."""
