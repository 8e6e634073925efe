"""A plugin of mypy that gives ``when=lambda self: ...`` the type of its machine.

No annotation can: a state is made before the class whose body it stands in. Name the plugin in
mypy's configuration, as ``plugins = ["llfsm.mypy_plugin"]``. Nothing of llfsm imports it.
"""

from __future__ import annotations

from collections.abc import Callable

from mypy.checker import TypeChecker
from mypy.nodes import TypeInfo
from mypy.plugin import MethodSigContext, Plugin
from mypy.types import CallableType, FunctionLike, Type, UnionType, get_proper_type
from mypy.typevars import fill_typevars

_TO = "llfsm.runtime.engine.state.State.to"


def plugin(version: str) -> type[Plugin]:
    """Return the class of the plugin, as mypy asks a module for it."""
    return _Guards


class _Guards(Plugin):
    def get_method_signature_hook(
        self, fullname: str
    ) -> Callable[[MethodSigContext], FunctionLike] | None:
        return _to if fullname == _TO else None


def _to(context: MethodSigContext) -> FunctionLike:
    """Return the signature of `State.to` with guards of the class in whose body it is called."""
    signature = context.default_signature
    machine = context.api.scope.active_class() if isinstance(context.api, TypeChecker) else None
    if machine is None:
        return signature
    types = [
        _of(machine, each) if name == "when" else each
        for name, each in zip(signature.arg_names, signature.arg_types, strict=True)
    ]
    return signature.copy_modified(arg_types=types)


def _of(machine: TypeInfo, guard: Type) -> Type:
    """Return the type of guards with that of their machine."""
    found = get_proper_type(guard)
    if isinstance(found, UnionType):
        return UnionType([_of(machine, each) for each in found.items])
    if isinstance(found, CallableType):
        return found.copy_modified(arg_types=[fill_typevars(machine)])
    return found
