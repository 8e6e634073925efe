"""What is wrong with a machine, as far as its text tells: nothing of it is run.

Read in this order: `subject` (what is checked), `uses` (what code does with its machine), `rules`
(what is wrong), then `classes` and `bundles` (what is checked, of a class and of a bundle).
"""

from .bundles import check_bundle
from .classes import check_class
from .subject import Finding

__all__ = ["Finding", "check_bundle", "check_class"]
