"""The root of all errors: catch `LlfsmError` for everything that llfsm raises on purpose.

Each package draws its own tree at the head of its `errors` module.
"""

__all__ = ["LlfsmError"]


class LlfsmError(Exception):
    """The root of every error that llfsm raises."""
