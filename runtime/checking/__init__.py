"""Find errors in a machine from its text, without running it.

Read in this order: `subject` (what is checked), `uses` (what code does with its machine), `rules`
(what is wrong), with `assigned` (names without a value), `expression_types` and `typed_rules` (what
is wrong with values), with `operators`, `nothing` and `optional` (None), `pointless` and
`port_rules`, then `classes` and `bundles` (a class and a bundle as subjects) and
`arrangement_rules` (machines together).
`type_checkers`, with `bundle_module`, has mypy or pyright check the code.
"""

from llfsm.runtime.checking.arrangement_rules import check_arrangement, requests_of
from llfsm.runtime.checking.bundles import check_bundle
from llfsm.runtime.checking.classes import check_class
from llfsm.runtime.checking.subject import Finding
from llfsm.runtime.checking.type_checkers import check_types

__all__ = [
    "Finding",
    "check_arrangement",
    "check_bundle",
    "check_class",
    "check_types",
    "requests_of",
]
