"""What is used for packed states: the twins in C or, without the extension, the definitions."""

__all__ = ["SPREAD", "EffectTable", "Seen", "States"]

try:
    from ._states import EffectTable, Seen, States
except ImportError:
    from .packed_states import EffectTable, Seen, States  # type: ignore[assignment]

SPREAD = EffectTable.__module__.endswith("._states")
"""True if sets of states mix all bits; those of Python are fast only if the low ones differ."""
