"""Find errors in a machine from its text, without running it.

Read in this order: `subject` (what is checked), `uses` (what code does with its machine), `rules`
(what is wrong), `expression_types` and `typed_rules` (what is wrong with values), then `classes`
and `bundles` (a class and a bundle as subjects) and `arrangement_rules` (machines together).
"""

from .arrangement_rules import check_arrangement
from .bundles import check_bundle
from .classes import check_class
from .subject import Finding

__all__ = ["Finding", "check_arrangement", "check_bundle", "check_class"]
