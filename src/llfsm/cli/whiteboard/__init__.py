"""``llfsm whiteboard``: whiteboards and their slots; one whiteboard on several hosts."""
