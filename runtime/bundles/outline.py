"""A table that can be drawn, made of the texts of a Python or C++ bundle without running them."""

from __future__ import annotations

from ..engine.source_text import TextOnly
from ..engine.state import State, Transition
from ..engine.table import Table
from .code import label_of, parse
from .cpp import without_comments
from .model import PYTHON, Bundle, Fragment

__all__ = ["cpp_label", "outline"]


def outline(bundle: Bundle) -> Table:
    """Return the states, transitions and layout of `bundle`, to be drawn but not run.

    Nothing is compiled or imported, so modules that the code needs may be missing. For a Python
    bundle, the states, labels, sections and layout equal those of the class that `compile_bundle`
    returns. Variables and ports are left out. Raise `BundleError` for Python that cannot be parsed.
    """
    python = bundle.language == PYTHON
    states = {each.name: State(each.name, suspend=each.name == bundle.suspend)
              for each in bundle.states}  # fmt: skip
    for each in bundle.states:
        state = states[each.name]
        for name, fragment in each.sections.items():
            if parse(fragment).body if python else without_comments(fragment.text).strip():
                state.sections[name] = TextOnly(fragment.text)
        for transition in each.transitions:
            expression = transition.expression or Fragment("true")
            label = label_of(expression) if python else cpp_label(expression)
            state.transitions.append(
                Transition(
                    state, states[transition.target], (expression.source, 1), None, None, label
                )
            )
    table = Table(str(bundle.path), tuple(states.values()), {}, {}, {})
    table.layout = bundle.layout
    return table


def cpp_label(fragment: Fragment) -> str:
    """Return a C++ expression on one line, without its comments."""
    lines = without_comments(fragment.text).split("\n")
    return " ".join(line.strip() for line in lines if line.strip()) or fragment.text.strip()
