"""``llfsm verify``: machines are explored."""
