"""Edit `.machine` bundles on disk: each edit changes the files that it must, and can be undone.

Read in this order: `bundle_folder` (files on disk), `draft` (files in memory while an edit changes
them), `state_edits`, `transition_edits` and `text_edits`, `property_list`, `sketch`, `layout_text`
and `layout_edits` (where the machine is drawn), then `document` (edits, undo and what others do)
and `class_document`.
"""

from llfsm.runtime.editing.document import Document, Edit, decode_edits
from llfsm.runtime.editing.errors import EditConflictError, EditError

__all__ = ["Document", "Edit", "EditConflictError", "EditError", "decode_edits"]
