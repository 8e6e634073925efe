"""The root of all errors: catch `LlfsmError` for everything that llfsm raises on purpose.

Each package draws its own tree at the head of its `errors` module.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = [
    "LlfsmError",
    "did_you_mean",
    "nearby_file",
    "nothing_called",
    "one_line",
    "printable",
]

_LONGEST = 300  # characters of an error in one line
_MOST_LISTED = 20  # names in one


class LlfsmError(Exception):
    """The root of every error that llfsm raises."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Write the end of an error's message: "; did you mean 'x' or 'y'?", "" if none is similar.

    At most two names are suggested, without regard to case.
    """
    from difflib import get_close_matches  # only an error needs it

    names = {each.casefold(): each for each in known}
    near = [
        repr(names[each]) for each in get_close_matches(name.casefold(), names, n=2, cutoff=0.65)
    ]
    return f"; did you mean {' or '.join(near)}?" if near else ""


def listed(names: Iterable[str]) -> str:
    """List what there is, in an error's message: the first twenty, and how many more; or "none"."""
    known = list(names)
    more = f" and {len(known) - _MOST_LISTED} more" if len(known) > _MOST_LISTED else ""
    return (", ".join(known[:_MOST_LISTED]) or "none") + more


def nearby_file(path: Path) -> str:
    """Suggest a similar file for one that is not there, as `did_you_mean` does."""
    return "" if path.exists() else did_you_mean(path.name, (f.name for f in path.parent.glob("*")))


def nothing_called(name: str, known: Iterable[str]) -> str:
    """Write the message for a name in code that nothing defines, with a suggestion."""
    from sys import stdlib_module_names

    if name in stdlib_module_names:
        return f"nothing is called {name!r}; is an import missing?"
    return f"nothing is called {name!r}{did_you_mean(name, known)}"


_CONTROLS = {
    number: f"\\x{number:02x}" if number < 0x80 else f"\\u{number:04x}"
    for number in (*range(0x20), *range(0x7F, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A))
    if chr(number) not in "\n\t"
}


def printable(text: str) -> str:
    """Write characters that command a terminal, or turn the direction of a text, as escapes."""
    return text.translate(_CONTROLS)


def one_line(error: BaseException) -> str:
    """Return an error's message in one line of about 300 characters at most, as valid UTF-8."""
    line = printable(" ".join(str(error).split())).encode(errors="backslashreplace").decode()
    if len(line) <= _LONGEST:
        return line
    half = _LONGEST // 2
    return f"{line[:half]} … {line[-half:]}"  # the place in the code comes last
