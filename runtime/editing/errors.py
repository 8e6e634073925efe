"""The errors of `llfsm.runtime.editing`.

FsmError
└── EditError              a bundle cannot be edited as asked; nothing was changed
    └── EditConflictError  another program, or another window, has changed what was to be changed
"""

from __future__ import annotations

from llfsm.runtime.engine.errors import FsmError


class EditError(FsmError):
    """A bundle cannot be edited as asked; the message says why. Nothing was changed."""


class EditConflictError(EditError):
    """The text or file to be changed is not as it was when the edit was made; it is kept."""
