"""How functions are called, whatever their annotations name."""

from __future__ import annotations

import inspect
import sys
from types import FunctionType

__all__ = ["signature_of"]


def signature_of(function: FunctionType) -> inspect.Signature:
    """Return what a function can be called with; in bundles, what stands for self has no name."""
    try:
        return _unevaluated(function)
    except ValueError:
        code = function.__code__
        names = tuple(each if each.isidentifier() else "self" for each in code.co_varnames)
        code = code.replace(co_varnames=names)
        named = FunctionType(code, {}, function.__name__, function.__defaults__)
        named.__kwdefaults__ = function.__kwdefaults__
        return _unevaluated(named)


def _unevaluated(function: FunctionType) -> inspect.Signature:
    """Leave annotations that wait to be evaluated: they may name what only type checkers import."""
    if sys.version_info >= (3, 14):
        import annotationlib

        return inspect.signature(function, annotation_format=annotationlib.Format.STRING)
    return inspect.signature(function)
