"""The slots in which llfsm's own processes find each other, by the folder of their names."""

from __future__ import annotations

OWN = "llfsm/"
"""What the names of these slots begin with."""


def is_own(name: str) -> bool:
    """Return whether a slot of that name is one of llfsm's own processes."""
    return name.startswith(OWN)
