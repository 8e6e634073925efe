"""Find errors in a machine from its text, without running it.

`classes` and `bundles` make a `Subject` of a class or a bundle; the rules then find what is wrong
with it: those of `rules` from the text alone, those of `typed_rules` and `operand_rules` with the
types of its expressions, once it is loaded. `arrangement_rules` are about machines together. What
code reads, and which types it has, is found by `llfsm.runtime.expressions`. `type_checkers` has
mypy or pyright check the code, and `message_fields` completes names in an editor.
"""

from llfsm.runtime.checking._arrangement_rules import check_arrangement, requests_of
from llfsm.runtime.checking._classes import check_class
from llfsm.runtime.checking._subject import Finding
from llfsm.runtime.checking._type_checkers import check_types
from llfsm.runtime.checking.bundles import check_bundle

__all__ = [
    "Finding",
    "check_arrangement",
    "check_bundle",
    "check_class",
    "check_types",
    "requests_of",
]
