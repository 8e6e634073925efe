"""Find the targets of transitions and the suspend state of a C++ bundle in its generated code.

Generators differ in white space. The newest one gives the targets where transitions are created
instead of where their classes are declared.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from .model import Fragment

__all__ = ["suspend_state", "targets", "without_comments"]

_COMMENT = re.compile(r'"(?:\\.|[^"\\\n])*"|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)
_COUNT = re.compile(r"\bnumberOfTransitions\s*\(\s*(?:void)?\s*\)[^;{}]*\{\s*return\s+(\d+)\s*;")
_SUSPEND = re.compile(r"\bsetSuspendState\s*\(\s*([^;]*?)\s*\)\s*;")
_NOTHING = ("NULL", "nullptr", "0L")


def targets(
    state: str, header: Fragment, code: Fragment | None, names: Sequence[str]
) -> tuple[str, ...]:
    """Return the names of the states that the transitions of `state` lead to, in order.

    `header` gives their number. The target of each is the argument with which `code` creates it,
    or else the default of that argument in `header`. Raise `BundleError`.
    """
    declared = without_comments(header.text)
    made = "" if code is None else without_comments(code.text)
    count = _COUNT.search(declared)
    if count is None:
        raise header.error(f"it does not give the number of transitions of state {state!r}")
    found = []
    for number in range(int(count[1])):
        for text, fragment, before in ((made, code, "new"), (declared, header, "default")):
            match = re.search(_PATTERNS[before].format(number), text)
            if match and fragment:
                index, line = int(match[1]), text.count("\n", 0, match.start(1)) + 1
                if index >= len(names):
                    raise fragment.error(
                        f"transition {number} of state {state!r} leads to state number {index}, "
                        f"but there are {len(names)}, counted from 0",
                        line,
                    )
                found.append(names[index])
                break
        else:
            raise header.error(f"it gives transition {number} of state {state!r} no target")
    return tuple(found)


_PATTERNS = {
    "new": r"\bnew\s+(?:\w+\s*::\s*)*Transition_{}\s*[({{]\s*(\d+)\s*[)}}]",
    "default": r"\bTransition_{}\s*\(\s*int\s+\w*\s*=\s*(\d+)\s*\)",
}


def suspend_state(code: Fragment, names: Sequence[str]) -> str | None:
    """Return the state given to ``setSuspendState``: an index, ``_states[i]`` or a state's name.

    None if there is no such call. Raise `BundleError`.
    """
    text = without_comments(code.text)
    match = _SUSPEND.search(text)
    if match is None or match[1] in _NOTHING:
        return None
    given = match[1]
    index = re.fullmatch(r"(?:\w+\s*\[\s*)?(\d+)(?:\s*\])?", given)
    named = re.search(r"(\w+)\W*\Z", given)
    if index and int(index[1]) < len(names):
        return names[int(index[1])]
    if not index and named and named[1] in names:
        return named[1]
    line = text.count("\n", 0, match.start()) + 1
    raise code.error(f"setSuspendState is given {given!r}, which is not a state", line)


def without_comments(text: str) -> str:
    """Return C++ text with its comments blanked; lines keep their numbers."""

    def blank(match: re.Match[str]) -> str:
        found = match[0]
        return found if found[0] == '"' else re.sub(r"[^\n]", " ", found)

    return _COMMENT.sub(blank, text)
