"""C++ bundles: read their generated code, and convert them to Python.

The targets of transitions and the suspend state are only in generated code. Generators differ in
white space, and the newest one gives targets where transitions are created, not where their classes
are declared.

Conversion translates what is certain and marks the rest: a robot must never run a guess. An
expression is translated where C++ and Python certainly mean the same. Refused is what differs or
cannot be decided from the bundle alone: integer division, unsigned arithmetic, pointers, macros,
and all calls but those of clfsm's own predicates. A mark is the name `UNTRANSLATED`; a bundle with
one does not run, and the error gives file and line. The C++ stays beside each mark, as comments.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from llfsm.runtime.bundles.code import too_deep
from llfsm.runtime.bundles.model import PYTHON, Bundle, BundleState, Fragment
from llfsm.runtime.bundles.names import UNTRANSLATED
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.table import MAY_BE_OWN

_COMMENT = re.compile(r'"(?:\\.|[^"\\\n])*"|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)
_COUNT = re.compile(r"\bnumberOfTransitions\s*\(\s*(?:void)?\s*\)[^;{}]*\{\s*return\s+(\d+)\s*;")
_SUSPEND = re.compile(r"\bsetSuspendState\s*\(\s*([^;]*?)\s*\)\s*;")
_NOTHING = ("NULL", "nullptr", "0L")


def targets(
    state: str, header: Fragment, code: Fragment | None, names: Sequence[str]
) -> tuple[str, ...]:
    """Find the states that the transitions of `state` lead to, in order.

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
    """Find the state given to ``setSuspendState``: an index, ``_states[i]`` or a state's name.

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
    """Blank the comments of C++ text; lines keep their numbers."""

    def blank(match: re.Match[str]) -> str:
        found = match[0]
        return found if found[0] == '"' else re.sub(r"[^\n]", " ", found)

    return _COMMENT.sub(blank, text)


KINDS = {
    "bool": ("bool", "False"),
    "int": ("int", "0"),
    "long": ("int", "0"),  # may be too long for a double to hold exactly
    "unsigned": ("int", "0"),
    "float": ("float", "0.0"),
    "single": ("float", "0.0"),  # rounded more coarsely in C++
    "string": ("str", '""'),
}
"""The kinds of values that are distinguished, with their Python types and zero values."""

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<float>(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?P<single>[fF]?)(?![\w.])
    |(?P<int>0[xX][0-9a-fA-F]+|[1-9]\d*|0)(?P<suffix>[uUlL]*)(?![\w.'])
    |(?P<name>[A-Za-z_]\w*)
    |"(?P<string>[^"\\\n]*)"
    |(?P<sign>&&|\|\||[=!<>]=|--|[<>!+*/()-])
    )""",
    re.VERBOSE,
)
_TIMES = ("after", "after_ms", "timeout")
_QUESTIONS = ("is_suspended", "is_running")
_SIGNS = {"&&": "and", "||": "or", "!": "~"}
_LARGEST_INT = 2**31 - 1


class CppVariable(NamedTuple):
    """A C++ variable as it is in Python: its name there, and one of `KINDS`."""

    name: str
    kind: str


def translate_condition(text: str, variables: Mapping[str, CppVariable]) -> str | None:
    """Translate a C++ condition to Python with the same truth value; None if that is uncertain.

    A C++ ``float`` becomes Python's, which is a ``double``: variables of that type are only
    compared, and only with what is exact in both.
    """
    try:
        condition = _truth(_parsed(text, variables))
        return None if too_deep(condition) else ast.unparse(condition)
    except _RefusedError:
        return None


def translate_value(text: str, kind: str) -> str | None:
    """Translate a constant with which a variable of `kind` begins; None if that is uncertain."""
    try:
        value = _parsed(text, {})
    except _RefusedError:
        return None
    literal = value.node.operand if isinstance(value.node, ast.UnaryOp) else value.node
    if not isinstance(literal, ast.Constant):
        return None
    if value.kind == kind or (value.kind, kind) == ("int", "long"):
        return ast.unparse(value.node)
    if kind == "unsigned" and value.kind == "int" and literal is value.node:
        return ast.unparse(value.node)
    if kind == "float" or (kind == "single" and _exact(value)):
        if value.kind == "int":
            return f"{ast.unparse(value.node)}.0"
        return ast.unparse(value.node) if value.kind == "float" else None
    return None


class _RefusedError(Exception):
    """The text is not translated."""


class _Value(NamedTuple):
    node: ast.expr
    kind: str


class _Reader(NamedTuple):
    """Reads the tree of an expression, in which ``~`` is C++'s ``!`` and ``_[i]`` a literal."""

    literals: Sequence[_Value]
    variables: Mapping[str, CppVariable]

    def value(self, node: ast.expr) -> _Value:
        match node:
            case ast.Subscript(_, ast.Constant(int(number))):
                return self.literals[number]
            case ast.Name("true" | "false" as name):
                return _Value(ast.Constant(name == "true"), "bool")
            case ast.Name(name) if name in self.variables:
                variable = self.variables[name]
                return _Value(ast.Name(variable.name), variable.kind)
            case ast.Call(ast.Name(name), [argument], []) if name not in self.variables:
                value = self.value(argument)
                if name in (_QUESTIONS if value.kind == "string" else _TIMES):
                    return _Value(ast.Call(ast.Name(name), [value.node], []), "bool")
            case ast.BoolOp(op, values):
                return _Value(ast.BoolOp(op, [_truth(self.value(e)) for e in values]), "bool")
            case ast.UnaryOp(ast.Invert(), operand):
                return _Value(ast.UnaryOp(ast.Not(), _truth(self.value(operand))), "bool")
            case ast.UnaryOp(ast.USub(), operand):
                value = self.value(operand)
                kind = "int" if value.kind == "bool" else value.kind
                if kind not in ("unsigned", "string"):
                    return _Value(ast.UnaryOp(ast.USub(), value.node), kind)
            case ast.Compare(left, ops, comparators):
                return self.compared(left, ops, comparators)
            case ast.BinOp(left, op, right):
                one, other = self.value(left), self.value(right)
                divisor = other.node.value if isinstance(other.node, ast.Constant) else 0
                # C++ cuts whole quotients, and divides by zero
                if not isinstance(op, ast.Div) or (divisor and "float" in (one.kind, other.kind)):
                    return _arithmetic(one, op, other)
        raise _RefusedError

    def compared(
        self, left: ast.expr, ops: Sequence[ast.cmpop], others: Sequence[ast.expr]
    ) -> _Value:
        """Compare two at a time: in C++, ``<`` binds more tightly than ``==``."""
        values, equalities = [self.value(left)], []
        for op, other in zip(ops, map(self.value, others), strict=True):
            if isinstance(op, ast.Eq | ast.NotEq):
                equalities.append(op)
                values.append(other)
            else:
                values[-1] = _comparison(values[-1], op, other)
        first, *rest = values
        for equality, other in zip(equalities, rest, strict=True):
            first = _comparison(first, equality, other)
        return first


def _parsed(text: str, variables: Mapping[str, CppVariable]) -> _Value:
    """Parse an expression by Python's parser: its signs become Python's, which bind alike."""
    literals: list[_Value] = []
    words: list[str] = []
    text, at = without_comments(text).rstrip(), 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        word = match and (match["name"] or match["sign"])
        if match is None or word == "--" or (word and keyword.iskeyword(word)):
            raise _RefusedError
        at = match.end()
        if word is None:
            word = f"_[{len(literals)}]"
            literals.append(_literal(match))
        words.append(_SIGNS.get(word, word))
    try:
        tree = ast.parse(" ".join(words), mode="eval").body
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise _RefusedError from error
    if too_deep(tree):
        raise _RefusedError
    return _Reader(literals, variables).value(tree)


def _literal(match: re.Match[str]) -> _Value:
    if match["float"]:
        value = _Value(ast.Constant(float(match["float"])), "float")
        if float(match["float"]) == math.inf or (match["single"] and not _exact(value)):
            raise _RefusedError
        return value
    if match["int"]:
        return _whole_number(int(match["int"], 0), match["suffix"].lower())
    return _Value(ast.Constant(match["string"]), "string")


def _whole_number(number: int, suffix: str) -> _Value:
    kinds = {"": "int", "u": "unsigned", "l": "long", "ll": "long"}
    if number > _LARGEST_INT or suffix not in kinds:
        raise _RefusedError
    return _Value(ast.Constant(number), kinds[suffix])


def _truth(value: _Value) -> ast.expr:
    """Make the node that is True or False as C++ takes `value`."""
    if value.kind == "bool":
        return value.node
    if value.kind == "string":
        raise _RefusedError
    if isinstance(value.node, ast.Constant):
        return ast.Constant(bool(value.node.value))
    return ast.Compare(value.node, [ast.NotEq()], [ast.Constant(0)])


def _comparison(one: _Value, op: ast.cmpop, other: _Value) -> _Value:
    kinds = {one.kind, other.kind}
    for value, beside in ((one, other), (other, one)):
        if (
            value.kind == "string"
            or (value.kind == "unsigned" and not (_never_negative(beside) or "float" in kinds))
            or (value.kind == "long" and kinds & {"float", "single"})
            or (value.kind == "single" and beside.kind != "single" and not _exact(beside))
        ):
            raise _RefusedError
    return _Value(ast.Compare(one.node, [op], [other.node]), "bool")


def _never_negative(value: _Value) -> bool:
    is_literal = value.kind == "int" and isinstance(value.node, ast.Constant)
    return is_literal or value.kind in ("bool", "unsigned")


def _exact(value: _Value) -> bool:
    """Check that `value` is a constant, or a bool, that a C++ ``float`` holds exactly."""
    node = value.node.operand if isinstance(value.node, ast.UnaryOp) else value.node
    if not isinstance(node, ast.Constant) or not isinstance(node.value, int | float):
        return value.kind == "bool"
    try:
        rounded: float = struct.unpack("f", struct.pack("f", node.value))[0]
    except OverflowError:
        return False
    return rounded == node.value


def _arithmetic(one: _Value, operator: ast.operator, other: _Value) -> _Value:
    kinds = {one.kind, other.kind}
    if kinds & {"unsigned", "single", "string"} or kinds == {"long", "float"}:
        raise _RefusedError
    kind = next((kind for kind in ("float", "long") if kind in kinds), "int")
    return _Value(ast.BinOp(one.node, operator, other.node), kind)


_DECLARATION = re.compile(
    r"(?P<type>(?:[A-Za-z_][\w:]*[ \t]+)*[A-Za-z_][\w:]*(?:[ \t]*\*)?)[ \t]*"
    r"\b(?P<name>[A-Za-z_]\w*)[ \t]*(?:=[ \t]*(?P<value>[^;]+?)[ \t]*)?;"
)
_KIND_OF_TYPE = {
    "bool": "bool",
    "double": "float",
    "float": "single",
    "std::string": "string",
    "string": "string",
    "const char *": "string",
    **dict.fromkeys(("int", "short", "signed", "int8_t", "int16_t", "int32_t"), "int"),
    **dict.fromkeys(("uint8_t", "uint16_t", "unsigned char", "unsigned short"), "int"),
    **dict.fromkeys(("long", "long long", "int64_t", "time_t"), "long"),
    **dict.fromkeys(("unsigned", "unsigned int", "uint32_t", "uint64_t", "size_t"), "unsigned"),
    **dict.fromkeys(("unsigned long", "unsigned long long"), "unsigned"),
}
_RESERVED = ("self", "table", UNTRANSLATED)
_NO_STATEMENT = re.compile(r"[{};\s]|using\s+namespace\s+[\w:]+\s*;")


def import_bundle(bundle: Bundle) -> Bundle:
    """Convert a C++ bundle to Python, with the same layout, names and targets.

    Raise `BundleError` for one that is in Python already.
    """
    if bundle.language == PYTHON:
        raise Fragment("", bundle.folder).error("this is already a Python bundle")
    variables, declared = _variables(bundle.variables, {})
    return Bundle(
        bundle.name,
        tuple(_state(state, declared) for state in bundle.states),
        PYTHON,
        bundle.suspend,
        _quoted(bundle.includes),
        variables,
        _section(bundle.methods),
        layout=bundle.layout,
    )


def _state(state: BundleState, machine: Mapping[str, CppVariable]) -> BundleState:
    variables, known = _variables(state.variables, machine)
    return BundleState(
        state.name,
        {name: text for name, each in state.sections.items() if (text := _section(each))},
        tuple(
            transition
            if transition.expression is None
            else replace(transition, expression=_expression(transition.expression, known))
            for transition in state.transitions
        ),
        _quoted(state.includes),
        variables,
        _section(state.methods),
    )


def _expression(fragment: Fragment, known: Mapping[str, CppVariable]) -> Fragment:
    python = translate_condition(fragment.text, known)
    if python is None:
        python = f"{UNTRANSLATED}  # {' '.join(fragment.text.split())}"
    return Fragment(f"{python}\n")


def _variables(
    fragment: Fragment | None, outer: Mapping[str, CppVariable]
) -> tuple[Fragment | None, dict[str, CppVariable]]:
    """Translate declarations; return them, and all variables known now, by their C++ names."""
    known = dict(outer)
    if fragment is None:
        return None, known
    lines = []
    whole = fragment.text.split("\n")
    for text, bare in zip(whole, without_comments(fragment.text).split("\n"), strict=True):
        code = bare.strip()
        if not code:
            continue  # comments on their own lines are the generators'
        comment = " ".join(text[len(bare.rstrip()) :].strip(" \t/*!<").split())
        line = _declare(code, known)
        lines.append(f"{line}  # {comment}" if comment else line)
    return (Fragment("\n".join(lines) + "\n") if lines else None), known


def _declare(code: str, known: dict[str, CppVariable]) -> str:
    """Translate one declaration, and add its variable to those known."""
    match = _DECLARATION.fullmatch(code)
    if match is not None:
        kind = _KIND_OF_TYPE.get(re.sub(r"\s*\*", " *", " ".join(match["type"].split())))
        if kind is not None:
            annotation, zero = KINDS[kind]
            value = zero if match["value"] is None else translate_value(match["value"], kind)
            if value is not None:
                name = _python_name(match["name"], known)
                known[match["name"]] = CppVariable(name, kind)
                return f"{name}: {annotation} = {value}"
    for word in re.findall(r"\w+", code):  # it may hide a variable of the machine
        known.pop(word, None)
    return f"{UNTRANSLATED}  # {code}"


def _python_name(name: str, known: Mapping[str, CppVariable]) -> str:
    """Return `name`, or a similar free one if it has another meaning in a Python bundle."""
    taken = {variable.name for key, variable in known.items() if key != name}
    reserved = {*dir(Machine), *keyword.kwlist, *_RESERVED} - MAY_BE_OWN
    while name in reserved or name in taken or name[:2] == "__":
        name = f"{name.lstrip('_')}_"
    return name


def _section(fragment: Fragment | None) -> Fragment | None:
    """Turn C++ statements into comments, with a mark unless they do nothing."""
    quoted = _quoted(fragment)
    if fragment is None or quoted is None:
        return None
    if _NO_STATEMENT.sub("", without_comments(fragment.text)):
        return Fragment(f"{UNTRANSLATED}\n{quoted.text}")
    return quoted


def _quoted(fragment: Fragment | None) -> Fragment | None:
    if fragment is None:
        return None
    lines = fragment.text.strip("\n").split("\n")
    return Fragment("".join(f"# {line}".rstrip() + "\n" for line in lines))
