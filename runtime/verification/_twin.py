"""Choose the code for packed states: the twins in C or, without the extension, the definitions."""

try:
    from ._states import EffectTable as EffectTable
    from ._states import Seen as Seen
    from ._states import States as States
except ImportError:
    from ._packed_states import EffectTable as EffectTable  # type: ignore[assignment]
    from ._packed_states import Seen as Seen  # type: ignore[assignment]
    from ._packed_states import States as States  # type: ignore[assignment]

SPREAD = EffectTable.__module__.endswith("._states")
"""True if sets of states mix all bits; those of Python are fast only if the low ones differ."""
