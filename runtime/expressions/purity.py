"""Purity: the operators, functions, methods and classes that compute and have no effect.

Two questions are answered here. What may be *done* to evaluate an expression beside a running
machine, without changing anything (`apply`, `item`, `call`, `member`): operators on data, and the
functions and methods that are listed. And what a call *depends on* (`reads_outside`,
`reaches_outside`): the host's clock, chance, files, sockets and threads, because of which code does
not do the same again.

Data are numbers, texts, containers and messages of such. A class whose operators are written in
Python is none, because they may do anything. Nothing that is listed may take for ever, either: what
grows with a value's size or magnitude is refused beyond a bound.
"""

from __future__ import annotations

import _thread
import ast
import datetime
import enum
import inspect
import io
import math
import operator
import os
import random
import time
from collections.abc import Callable, ItemsView, Iterable, Iterator, KeysView, Mapping, ValuesView
from functools import lru_cache
from itertools import chain
from types import BuiltinFunctionType, MemberDescriptorType, UnionType
from typing import Annotated, Any, Final, Literal, TypeAlias, Union, get_args, get_origin

import msgspec

from llfsm.runtime.engine.submachine import Polled


class EvaluationError(Exception):
    """A part of an expression cannot be evaluated without an effect, or there is no such name."""


class MissingError(EvaluationError):
    """An object has no attribute of that name."""


class Elements:
    """The elements of a generator in an expression: data that nobody else reads."""

    def __init__(self, elements: Iterator[Any]):
        self._elements = elements

    def __iter__(self) -> Iterator[Any]:
        return self._elements


Function: TypeAlias = Callable[..., Any]

_OPERATORS: Final[Mapping[type[ast.AST], Function]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod,
    ast.Pow: operator.pow, ast.LShift: operator.lshift, ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_, ast.BitOr: operator.or_, ast.BitXor: operator.xor,
    ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos,
    ast.Invert: operator.invert, ast.Eq: operator.eq, ast.NotEq: operator.ne,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda value, found: value in found, ast.NotIn: lambda value, found: value not in found,
}  # fmt: skip
FUNCTIONS: Final[tuple[Function, ...]] = (
    *(abs, all, any, bool, dict, enumerate, float, frozenset, int, isinstance, len, list),
    *(max, min, range, reversed, round, set, sorted, str, sum, tuple, zip),
)
"""The functions of Python itself that only compute; those of `math` do, too."""

_LONG: Final = 100_000  # elements of a value at which every element is looked
_MOST: Final = 64  # an exponent, bits of a shift, and of what is raised: others may take for ever
_SCALARS: Final = frozenset({bool, int, float, complex, str, bytes, slice, type(None)})
_KINDS: Final = (
    *(bool, int, float, complex, str, bytes, tuple, list, dict, set, frozenset, range),
    *(enum.Enum, msgspec.Struct, Polled),
)
_LIBRARIES: Final = frozenset({"builtins", "collections", "enum", "msgspec"})
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
METHODS: Final[Mapping[type, frozenset[str]]] = {
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
"""The methods of built-in classes that only compute."""


def as_data(value: Any) -> Any:
    """Let a value through on which operators have no effect; raise `EvaluationError` for others."""
    if _is_data(value, 20):
        return value
    raise EvaluationError(f"{type(value).__name__} is not data")


def as_argument(value: Any) -> Any:
    """Let data through, and the `Elements` of a generator; raise `EvaluationError` for others."""
    return value if isinstance(value, Elements) else as_data(value)


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
    """Check that the operators of a class are a library's, and not written in Python."""
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


def apply(op: ast.operator | ast.unaryop | ast.cmpop, *operands: Any) -> Any:
    """Apply an operator to data; raise `EvaluationError` if that may take for ever."""
    if len(operands) == 2 and not _is_small(op, *operands):
        raise EvaluationError("this may take too long")
    return _OPERATORS[type(op)](*operands)


def _is_small(op: ast.AST, left: Any, right: Any) -> bool:
    """Check that an operator takes little time and room, by the magnitude of what it is given."""
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
    """Take an item out of a container; raise where a `defaultdict` would make a new one."""
    if hasattr(type(container), "__missing__") and key not in container:
        raise EvaluationError(f"there is no item {key!r} yet")
    return container[key]


def call(function: Function, arguments: list[Any], keywords: Mapping[str, Any]) -> Any:
    """Call a function that only computes; raise `EvaluationError` for any other.

    Arguments are data, or `Elements`.
    """
    if function is isinstance:
        return _is_instance(*arguments)
    if not only_computes(function) or not keywords.keys().isdisjoint({"key", ""}):
        raise EvaluationError(f"{getattr(function, '__name__', 'this')} is not called")
    values = [*map(as_argument, arguments)]
    if any(isinstance(each, range) and each[_LONG:] for each in values) or (
        function is round and any(abs(each) > _MOST for each in arguments[1:])
    ):
        raise EvaluationError("this may take too long")
    found = function(*values, **{name: as_data(each) for name, each in keywords.items()})
    return [*found] if isinstance(found, _ITERATED) else found


def only_computes(function: Any) -> bool:
    """Check that a function is listed here: called with data, it has no effect.

    `isinstance` is listed, too, but may call code of a class (`is_ordinary`); and so may what has a
    function as its ``key``.
    """
    if any(function is each for each in FUNCTIONS):
        return True
    if not isinstance(function, BuiltinFunctionType):
        return False
    if function.__self__ is math:
        return function not in _SLOW
    return function.__name__ in METHODS.get(type(function.__self__), ())


def _is_instance(value: Any, kinds: Any) -> bool:
    classes = kinds if isinstance(kinds, tuple) else (kinds,)
    if not all(map(is_ordinary, classes)):
        raise EvaluationError("isinstance is not called for this class")
    return any(each in type(value).__mro__ for each in classes)


def is_ordinary(cls: object) -> bool:
    """Check that what is given is a class, and that `isinstance` runs no code of its own for it."""
    check = inspect.getattr_static(type(cls), "__instancecheck__", None)
    return isinstance(cls, type) and check is vars(type)["__instancecheck__"]


def member(owner: Any, name: str) -> Any:
    """Look up an attribute as it is, without code that would run for it.

    Raise `MissingError` if there is none.
    """
    if name in METHODS.get(type(owner), ()):
        return getattr(as_data(owner), name)
    if name.startswith("__"):
        raise EvaluationError(name)
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


# Classes of data, by what annotations say


def is_constant(name: str, value: object) -> bool:
    """Check that what a name of a module stands for does not change while machines run.

    That is a member of an enumeration, and data that cannot change, if the name is in capitals.
    """
    if isinstance(value, enum.Enum):
        return _is_plain(type(value))
    return name.isupper() and cannot_change(value)


def cannot_change(value: object) -> bool:
    """Check that a value is data that nothing can change."""
    if isinstance(value, tuple | frozenset):
        return type(value) in (tuple, frozenset) and all(map(cannot_change, value))
    if isinstance(value, msgspec.Struct):
        fields = (member(value, name) for name in value.__struct_fields__)
        is_frozen = value.__struct_config__.frozen and _is_plain(type(value))
        return is_frozen and all(map(cannot_change, fields))
    return type(value) in _SCALARS or (isinstance(value, enum.Enum) and _is_plain(type(value)))


def holds_data(annotation: Any) -> bool:
    """Check that all values of an annotation's types are data."""
    return _holds_data(annotation, frozenset())


def _holds_data(annotation: Any, above: frozenset[Any]) -> bool:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _holds_data(arguments[0], above)
    if origin is Literal or annotation is None or annotation in above:
        return True
    kind: Any = origin or annotation
    if kind not in (Union, UnionType):
        if kind in (tuple, list, dict, set, frozenset) and not arguments:
            return False  # of what, is not known
        if not isinstance(kind, type) or not (kind in _SCALARS or _is_plain(kind)):
            return False
        if issubclass(kind, Polled):
            return False
    parts = [each for each in arguments if each is not ...]
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        try:
            parts += [each.type for each in msgspec.structs.fields(kind)]
        except (NameError, AttributeError, TypeError):
            return False  # its annotations do not resolve
    return all(_holds_data(each, above | {annotation}) for each in parts)


# What a call depends on, besides its arguments

_CLOCKS: Final = frozenset(
    function
    for name, function in vars(time).items()
    if name.removesuffix("_ns") in ("time", "monotonic", "perf_counter", "process_time")
    or name in ("thread_time", "localtime", "gmtime", "ctime", "strftime")
)
_NOW: Final = ("now", "utcnow", "today")
_CHANCE: Final = ("uuid", "secrets")
_SYSTEM: Final = ("posix", "nt", "_posixsubprocess", "_winapi", "_socket", "select")
_PURE: Final = ("fspath", "_path_")
"""How the names of functions of the system begin that only compute."""
_THREADS: Final = ("start_new_thread", "start_joinable_thread")


def reads_outside(function: object) -> bool:
    """Check if what a function returns depends on the host's clock or on chance."""
    try:
        if function in _CLOCKS or function is os.urandom:
            return True
    except TypeError:  # a method of what has no hash
        return False
    owner = getattr(function, "__self__", None)
    if isinstance(owner, type) and issubclass(owner, datetime.date):
        return getattr(function, "__name__", "") in _NOW
    by_chance = getattr(function, "__module__", None) in _CHANCE and not isinstance(function, type)
    return isinstance(owner, random.Random) or by_chance


def reaches_outside(function: object) -> bool:
    """Check if a function reads or changes files, processes or sockets, or starts threads."""
    name, module = (getattr(function, each, None) for each in ("__name__", "__module__"))
    if module in _SYSTEM:
        return not str(name).startswith(_PURE)
    if module == _thread.__name__:
        return name in _THREADS
    owner = getattr(function, "__self__", None)
    reads = isinstance(owner, io.IOBase) and str(name).startswith("read")
    return reads or function is open or function is input
