"""Suspend the machine named `target` for three seconds, let it run for five, and repeat."""
