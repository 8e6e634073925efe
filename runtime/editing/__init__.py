"""Edit `.machine` bundles on disk: each edit changes the files that it must, and can be undone.

Read in this order: `draft` (a bundle's files, on disk and in memory while an edit changes them),
`text_edits`, `sketch` and `layout_edits` (where the machine is drawn), `state_edits`, then
`document` (edits, undo and what others do) and `class_document`.
"""

from llfsm.runtime.editing._document import Document, Edit, decode_edits
from llfsm.runtime.editing.errors import EditConflictError, EditError

__all__ = ["Document", "Edit", "EditConflictError", "EditError", "decode_edits"]
