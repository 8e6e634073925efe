"""The bundles that other bundles may call: breakpoints can be set before these run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FunctionType

from llfsm.runtime.bundles import SUFFIX, load_bundle
from llfsm.runtime.engine.machine import Machine

__all__ = ["with_called_bundles"]


def with_called_bundles(classes: Mapping[str, type[Machine]]) -> dict[str, type[Machine]]:
    """Return machines, by name, and the bundles beside theirs that their code names.

    Raise what `load_bundle` raises.
    """
    found, waiting = dict(classes), [*classes.values()]
    while waiting:
        for other in _named_by(waiting.pop()):
            if other.stem not in found:
                found[other.stem] = load_bundle(other)
                waiting.append(found[other.stem])
    return found


def _named_by(cls: type[Machine]) -> Iterator[Path]:
    folder = Path(cls.table.path)
    if folder.suffix != SUFFIX:
        return
    for state in cls.table.states:
        for code in state.sections.values():
            for text in code.__code__.co_consts if isinstance(code, FunctionType) else ():
                if isinstance(text, str) and text.isidentifier():
                    other = folder.with_name(f"{text}{SUFFIX}")
                    if other.is_dir():
                        yield other
