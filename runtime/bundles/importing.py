"""Convert a C++ bundle to Python: what is certain is translated, the rest is marked.

A mark is the name `UNTRANSLATED`; a bundle with a mark does not run, and the error gives its
file and line. The C++ text is kept beside each mark, as comments.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from dataclasses import replace

from ..engine.machine import Machine
from .cpp import without_comments
from .expressions import KINDS, CppVariable, translate_condition, translate_value
from .model import PYTHON, Bundle, BundleState, Fragment
from .names import UNTRANSLATED

__all__ = ["import_bundle"]

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
    """Return the Python bundle for a C++ one, with the same layout, names and targets."""
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
    """Return the declarations in Python, and all variables known after them, by their C++ names."""
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
    """Return one declaration in Python, and add the variable to those known."""
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
    reserved = (*dir(Machine), *keyword.kwlist, *_RESERVED)
    while name in reserved or name in taken or name[:2] == "__":
        name = f"{name.lstrip('_')}_"
    return name


def _section(fragment: Fragment | None) -> Fragment | None:
    """Return the C++ statements as comments, marked unless they do nothing."""
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
