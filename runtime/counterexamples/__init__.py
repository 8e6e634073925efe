"""Counterexamples of verification: played, as tables, and turned into tests.

Read in this order: `regression` (what an environment did, as a script and a test), `replaying`,
`holding` (a property as an invariant) and `narrative` (tables).
"""

from .holding import holds
from .replaying import replay

__all__ = ["holds", "replay"]
