"""What may be done with values without an effect: operators, and functions that only compute.

Values are data: numbers, texts, containers and messages of such. A class whose operators are
written in Python is none, because they may do anything.
"""

from __future__ import annotations

import ast
import enum
import inspect
import math
import operator
from collections.abc import Callable, ItemsView, Iterable, Iterator, KeysView, Mapping, ValuesView
from functools import lru_cache
from itertools import chain
from types import BuiltinFunctionType, MemberDescriptorType
from typing import Any, Final, TypeAlias

import msgspec

from llfsm.runtime.engine.machine import Submachine


class UnseenError(Exception):
    """A part of an expression cannot be evaluated without an effect, or there is no such name."""


class MissingError(UnseenError):
    """An object has no attribute of that name."""


class Elements:
    """The elements of a generator in an expression; they are data, and nobody else reads them."""

    def __init__(self, elements: Iterator[Any]):
        self._elements = elements

    def __iter__(self) -> Iterator[Any]:
        return self._elements


Function: TypeAlias = Callable[..., Any]

_OPERATORS: Final[Mapping[type[ast.AST], Function]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda value, found: value in found,
    ast.NotIn: lambda value, found: value not in found,
}
FUNCTIONS: Final[tuple[Function, ...]] = (
    *(abs, all, any, bool, dict, enumerate, float, frozenset, int, isinstance, len, list),
    *(max, min, range, reversed, round, set, sorted, str, sum, tuple, zip),
)
"""Those of Python itself; those of `math` are besides them."""

_LONG: Final = 100_000  # elements of a value at which every element is looked
_MOST: Final = 64  # an exponent, bits of a shift, and of what is raised: others may take for ever
_SCALARS: Final = frozenset({bool, int, float, complex, str, bytes, slice, type(None)})
_KINDS: Final = (
    *(bool, int, float, complex, str, bytes, tuple, list, dict, set, frozenset, range),
    *(enum.Enum, msgspec.Struct, Submachine),
)
_LIBRARIES: Final = frozenset({"builtins", "collections", "enum", "msgspec", Submachine.__module__})
_LIFE: Final = frozenset(
    f"__{name}__"
    for name in (
        *("class_getitem", "delattr", "dir", "getnewargs", "getstate", "init", "init_subclass"),
        *("new", "reduce", "reduce_ex", "repr", "setattr", "sizeof", "subclasshook"),
    )
)
"""Methods that no operator calls, though every class has them."""
_OPERATIONS: Final = (
    frozenset({"__bool__", "__missing__", *chain.from_iterable(map(dir, (dict, float, int)))})
    | {*dir(set), *dir(str)}
) - _LIFE
_ITERATED: Final = (Iterator, KeysView, ValuesView, ItemsView)  # they become lists
_SLOW: Final = frozenset({math.comb, math.factorial, math.perm, math.prod})
_TEXTS: Final = (
    "casefold count endswith find index isalnum isalpha isascii isdigit islower isspace istitle "
    "isupper lower lstrip partition removeprefix removesuffix rfind rindex rpartition rsplit "
    "rstrip split splitlines startswith strip swapcase title upper"
)
_SETS: Final = (
    "copy difference intersection isdisjoint issubset issuperset symmetric_difference union"
)
_METHODS: Final[Mapping[type, frozenset[str]]] = {
    kind: frozenset(names.split())
    for kind, names in {
        str: f"{_TEXTS} encode isdecimal isidentifier isnumeric isprintable",
        bytes: f"{_TEXTS} decode hex",
        int: "bit_count bit_length conjugate",
        float: "conjugate hex is_integer",
        tuple: "count index",
        list: "copy count index",
        range: "count index",
        dict: "copy get items keys values",
        set: _SETS,
        frozenset: _SETS,
    }.items()
}


def data(value: Any) -> Any:
    """Return a value on which operators have no effect; raise `UnseenError` for others."""
    if _is_data(value, 20):
        return value
    raise UnseenError(f"{type(value).__name__} is not data")


def _is_data(value: Any, depth: int) -> bool:
    kind: Any = type(value)
    if kind in _SCALARS:
        return True
    if not depth or not _is_plain(kind):
        return False
    parts = _parts(value)
    if len(parts) > _LONG:
        return False
    others = {*map(type, chain.from_iterable(parts))} - _SCALARS
    nested = (each for each in chain.from_iterable(parts) if type(each) in others)
    return not others or all(_is_data(each, depth - 1) for each in nested)


def _parts(value: Any) -> list[Iterable[Any]]:
    match value:
        case dict():
            return [*value.items()]
        case tuple() | list() | set() | frozenset():
            return [(each,) for each in value]
        case msgspec.Struct():
            return [(member(value, name),) for name in value.__struct_fields__]
    return []


@lru_cache(maxsize=1024)
def _is_plain(kind: Any) -> bool:
    """Return whether the operators of a class are not written in Python, but by a library."""
    if not issubclass(kind, _KINDS):
        return False
    own = [vars(each) for each in kind.__mro__ if each.__module__ not in _LIBRARIES]
    found = (each[name] for each in own for name in each.keys() & _OPERATIONS)
    return not any(
        callable(each)
        and not inspect.ismethoddescriptor(each)
        and getattr(each, "__module__", "") not in _LIBRARIES  # as an enumeration's are
        for each in found
    )


def applied(op: ast.operator | ast.unaryop | ast.cmpop, *operands: Any) -> Any:
    """Return what an operator makes of values; raise `UnseenError` if that may take for ever."""
    if len(operands) == 2 and not _is_small(op, *operands):
        raise UnseenError("this may take too long")
    return _OPERATORS[type(op)](*operands)


def _is_small(op: ast.AST, left: Any, right: Any) -> bool:
    """Return whether an operator's result takes little time and room, whatever the values are."""
    numbers = isinstance(left, int | float | complex) and isinstance(right, int | float | complex)
    match op:
        case ast.Mult() | ast.Mod():
            return numbers  # a text may become as long as you like
        case ast.Pow() if numbers:
            is_short = not isinstance(left, int) or left.bit_length() <= _MOST
            return is_short and abs(right) <= _MOST
        case ast.Pow() | ast.LShift():
            return isinstance(right, int) and right <= _MOST
    return True


def item(container: Any, key: Any) -> Any:
    """Return an item of a container; a `defaultdict` would make one that is not there."""
    if hasattr(type(container), "__missing__") and key not in container:
        raise UnseenError(f"there is no item {key!r} yet")
    return container[key]


def called(function: Function, arguments: list[Any], keywords: Mapping[str, Any]) -> Any:
    """Return what a function that only computes returns; raise `UnseenError` for any other.

    Arguments are data, or `Elements`.
    """
    if function is isinstance:
        return _is_instance(*arguments)
    if not _only_computes(function) or not keywords.keys().isdisjoint({"key", ""}):
        raise UnseenError(f"{getattr(function, '__name__', 'this')} is not called")
    values = [each if isinstance(each, Elements) else data(each) for each in arguments]
    if any(isinstance(each, range) and each[_LONG:] for each in values) or (
        function is round and any(abs(each) > _MOST for each in arguments[1:])
    ):
        raise UnseenError("this may take too long")
    found = function(*values, **{name: data(each) for name, each in keywords.items()})
    return [*found] if isinstance(found, _ITERATED) else found


def _only_computes(function: Any) -> bool:
    if any(function is each for each in FUNCTIONS):
        return True
    if not isinstance(function, BuiltinFunctionType):
        return False
    if function.__self__ is math:
        return function not in _SLOW
    return function.__name__ in _METHODS.get(type(function.__self__), ())


def _is_instance(value: Any, kinds: Any) -> bool:
    classes = kinds if isinstance(kinds, tuple) else (kinds,)
    for each in classes:
        check = inspect.getattr_static(type(each), "__instancecheck__", None)
        if not isinstance(each, type) or check is not vars(type)["__instancecheck__"]:
            raise UnseenError("isinstance is not called for this class")
    return any(each in type(value).__mro__ for each in classes)


def member(owner: Any, name: str) -> Any:
    """Return an attribute as it is found, without code that would run for it.

    Raise `MissingError` if there is none.
    """
    if name in _METHODS.get(type(owner), ()):
        return getattr(data(owner), name)
    if name.startswith("__"):
        raise UnseenError(name)
    try:
        found = inspect.getattr_static(owner, name)
    except AttributeError:
        raise MissingError(f"{type(owner).__name__} has no {name!r}") from None
    if isinstance(owner, type):
        is_member = isinstance(found, owner) and issubclass(owner, enum.Enum)
        return getattr(owner, name) if is_member else found
    if isinstance(owner, enum.Enum) and found is vars(enum.Enum).get(name):
        return owner.value if name == "value" else owner.name
    is_of_tuple = isinstance(owner, tuple) and type(found).__name__ == "_tuplegetter"
    if is_of_tuple or isinstance(found, MemberDescriptorType):
        return found.__get__(owner, type(owner))
    if type(owner) in _SCALARS and inspect.isgetsetdescriptor(found):
        return getattr(owner, name)  # as the parts of a complex number
    return found
