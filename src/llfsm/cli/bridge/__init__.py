"""``llfsm bridge``: whiteboards and other worlds."""
