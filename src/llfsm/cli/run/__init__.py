"""``llfsm run``: machines as one arrangement."""
