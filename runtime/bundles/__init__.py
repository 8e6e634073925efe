"""Machines as `.machine` folders, as clfsm's tools keep them: read, run, written, imported.

Read in this order: `model` (what a bundle says), `read` with `cpp` and `plist` (how it is read),
`names`, `code`, `scope` and `compiling` (how a Python bundle runs), `outline` (how any bundle is
drawn), `write`, then `expressions` and `importing` (how a C++ bundle becomes a Python one).
"""

from .compiling import compile_bundle, load_bundle
from .importing import import_bundle
from .model import PYTHON, Bundle, BundleState, BundleTransition, Fragment
from .names import UNTRANSLATED
from .outline import outline
from .read import SUFFIX, read_bundle
from .write import write_bundle

__all__ = [
    "PYTHON",
    "SUFFIX",
    "UNTRANSLATED",
    "Bundle",
    "BundleState",
    "BundleTransition",
    "Fragment",
    "compile_bundle",
    "import_bundle",
    "load_bundle",
    "outline",
    "read_bundle",
    "write_bundle",
]
