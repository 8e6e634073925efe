"""Edits of a machine's texts: sections, expressions, variables and slots, includes, functions.

`SetText` is what a user writes. It names the text that it was made from, so that two windows cannot
overwrite each other. `Include` adds the imports that other texts use, such as the types of slots.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from typing import TypeAlias

import msgspec

from llfsm.runtime.bundles.read import PARTS
from llfsm.runtime.editing._draft import CodeEdit, Draft
from llfsm.runtime.editing.errors import EditConflictError, EditError

_OF_MACHINE = ("Includes", "Variables", "Methods")


class TextPlace(msgspec.Struct, frozen=True):
    """The place of a text in a machine: a section or declaration of a state, or an expression.

    Without a state, `part` is Includes, Variables (which declare the slots, too) or Methods of the
    machine. With `number`, it is the expression of that transition.
    """

    part: str
    state: str | None = None
    number: int | None = None


class SetText(CodeEdit, frozen=True, tag="set text"):
    """Set a text. It must still be `was`; else somebody else has changed it, and it is kept."""

    place: TextPlace
    text: str
    was: str

    def _change(self, draft: Draft) -> None:
        name = text_file(draft, self.place)
        if text_of(draft.files.get(name, b"")) != self.was:
            raise EditConflictError(f"not written: {name} has changed meanwhile; look at it first")
        if self.text != self.was:
            draft.put_text(name, self.text)
            if self.place.state is not None:
                draft.keep_a_file(self.place.state)


def text_file(draft: Draft, place: TextPlace) -> str:
    """Return the name of a text's file, which need not exist; raise `EditError`."""
    if place.state is None:
        if place.part not in _OF_MACHINE or place.number is not None:
            raise EditError(f"a machine has no text {place.part!r}")
        return f"{draft.bundle.name}_{place.part}.py"
    draft.state(place.state)
    if place.number is not None:
        draft.transition(place.state, place.number)
        return f"State_{place.state}_Transition_{place.number}.expr"
    if place.part not in PARTS:
        raise EditError(f"a state has no text {place.part!r}")
    return f"State_{place.state}_{place.part}.py"


def text_of(data: bytes) -> str:
    """Decode the text of a file, with lines that end in ``\\n``; a blank one is empty."""
    text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n")
    return text if text.strip() else ""


_IMPORTS = (ast.Import, ast.ImportFrom)
_BLOCKS = ("class ", "def ", "async ", "@")


class Include(CodeEdit, frozen=True, tag="include"):
    """Include statements for the whole machine, but for those that are there already.

    Imports are placed behind its imports, and others at the end.
    """

    text: str

    def _change(self, draft: Draft) -> None:
        name = text_file(draft, TextPlace("Includes"))
        draft.put_text(name, _with(text_of(draft.files.get(name, b"")), self.text))


TextEdit: TypeAlias = SetText | Include


def _with(old: str, new: str) -> str:
    """Add statements to a text of Python."""
    try:
        statements = ast.parse(new).body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise EditError(f"not included: {error}") from error
    try:
        there = ast.parse(old).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        there = []  # everything goes to its end
    known = {ast.unparse(part) for each in there for part in _parts(each)} | {*old.splitlines()}
    wanted = [
        part for each in statements for part in _parts(each) if ast.unparse(part) not in known
    ]
    imports = _joined(each for each in wanted if isinstance(each, _IMPORTS))
    others = [_source(new, each) for each in wanted if not isinstance(each, _IMPORTS)]
    lines = old.splitlines()
    at = _behind_imports(there) if there else len(lines)
    if imports and there and at == _end_of_doc(there):  # the first ones
        imports = [*([""] if at else []), *imports, *([] if at else [""])]
    text = "\n".join([*lines[:at], *imports, *lines[at:]]).rstrip("\n")
    for each in others:
        text += f"{_gap(text, each)}{each}"
    return f"{text}\n"


def _source(text: str, statement: ast.stmt) -> str:
    """Return the lines of a statement, with the comment behind it."""
    decorators = getattr(statement, "decorator_list", ())
    first = min([statement.lineno, *(each.lineno for each in decorators)])
    return "\n".join(text.splitlines()[first - 1 : statement.end_lineno])


def _gap(text: str, statement: str) -> str:
    """Return the blank lines between a text and a statement behind it."""
    last = text.rpartition("\n")[2]
    if statement.startswith(_BLOCKS) or last[:1].isspace():
        return "\n\n\n" if text else ""
    return "\n\n" if last.startswith(("from ", "import ", ")", '"""')) else "\n"


def _parts(statement: ast.stmt) -> list[ast.stmt]:
    """Return a statement, but one that imports several names as one for each."""
    if isinstance(statement, ast.ImportFrom):
        module, level = statement.module, statement.level
        return [ast.ImportFrom(module, [each], level) for each in statement.names]
    if isinstance(statement, ast.Import):
        return [ast.Import([each]) for each in statement.names]
    return [statement]


def _joined(imports: Iterable[ast.stmt]) -> list[str]:
    """Join imports of one name each to one line for each module."""
    lines: dict[str, str] = {}
    for each in imports:
        module, imported, name = ast.unparse(each).partition(" import ")
        lines[module] = f"{lines[module]}, {name}" if module in lines else module + imported + name
    return list(lines.values())


def _behind_imports(statements: list[ast.stmt]) -> int:
    """Return the number of lines up to the last import, or at least a docstring."""
    ends = [each.end_lineno or 0 for each in statements if isinstance(each, _IMPORTS)]
    return max(ends, default=_end_of_doc(statements))


def _end_of_doc(statements: list[ast.stmt]) -> int:
    match statements[:1]:
        case [ast.Expr(ast.Constant(str()), end_lineno=int(end))]:
            return end
    return 0
