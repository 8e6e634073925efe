"""Make a bundle of a machine class, and a class of a bundle, that do the same.

Read in this order: `edited_text` (a text that is changed at nodes), `to_class`, `to_bundle`,
`class_files`, `convert` and `class_process` (a class whose text changes, in a process of its own).
"""

from llfsm.runtime.converting._convert import write_converted
from llfsm.runtime.converting._to_bundle import class_bundle
from llfsm.runtime.converting._to_class import class_text
from llfsm.runtime.converting.class_files import class_layout, layout_file, module_name, write_class

__all__ = [
    "class_bundle", "class_layout", "class_text", "layout_file", "module_name", "write_class",
    "write_converted",
]  # fmt: skip
