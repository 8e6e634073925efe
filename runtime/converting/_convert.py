"""Write what a machine is converted to; nothing that is there is replaced."""

from __future__ import annotations

from pathlib import Path

from llfsm.runtime.bundles import SUFFIX, read_bundle, write_bundle
from llfsm.runtime.bundles.plist import layout_to_plist
from llfsm.runtime.converting._to_bundle import class_bundle
from llfsm.runtime.converting._to_class import class_text
from llfsm.runtime.converting.class_files import LAYOUT_SUFFIX, write_class
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.machine import Machine


def write_converted(machine: type[Machine] | Path, folder: Path) -> Path:
    """Make a bundle of a class, or a class of the bundle at a path, in `folder`; return its path.

    Raise `BundleError`, with file and line, for what cannot be converted, and for what is there.
    """
    if isinstance(machine, type):
        made = folder / f"{machine.__name__}{SUFFIX}"
        if made.exists():
            raise BundleError("not written: it is there already", made)
        write_bundle(class_bundle(machine, folder), made)
        return made
    bundle = read_bundle(machine)
    layout = folder / f"{bundle.name}{LAYOUT_SUFFIX}"
    if bundle.layout is not None and layout.exists():
        raise BundleError("not written: it is there already", layout)
    file = write_class(bundle.name, class_text(bundle, folder), folder)
    if bundle.layout is not None:
        layout.write_bytes(layout_to_plist(bundle.layout))
    return file
