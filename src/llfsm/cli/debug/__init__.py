"""``llfsm debug``."""
