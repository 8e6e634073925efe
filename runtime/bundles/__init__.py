"""Machines as `.machine` folders, the format of clfsm's tools: read, run, write, import them.

Read in this order: `model` (the contents of a bundle), `read` with `plist` (reading it), `names`,
`code` and `compiling` (how a Python bundle runs), `write`, then `cpp` (how a C++ bundle is read and
becomes a Python one).
"""

from llfsm.runtime.bundles._write import write_bundle
from llfsm.runtime.bundles.compiling import compile_bundle, load_bundle, outline, require_python
from llfsm.runtime.bundles.cpp import import_bundle
from llfsm.runtime.bundles.model import PYTHON, Bundle, BundleState, BundleTransition, Fragment
from llfsm.runtime.bundles.names import UNTRANSLATED
from llfsm.runtime.bundles.read import SUFFIX, read_bundle

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
    "require_python",
    "write_bundle",
]
