"""Find errors in a machine from its text, without running it.

Read in this order: `subject` (what is checked), `uses` (what code does with its machine), `rules`
(what is wrong), then `classes` and `bundles` (a class and a bundle as subjects).
"""

from .bundles import check_bundle
from .classes import check_class
from .subject import Finding

__all__ = ["Finding", "check_bundle", "check_class"]
