"""The rules that need no types: each yields what is wrong with a subject.

A rule is a function of a `Subject`, listed in `findings_of`. What it needs to know about code is in
`llfsm.runtime.expressions`, about machines in `subject`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from llfsm.errors import did_you_mean
from llfsm.runtime.checking._subject import Finding, Place, Subject
from llfsm.runtime.checking._time_rules import (
    contradictory_times,
    endless_loops,
    repeated_guards,
    restarted_times,
)
from llfsm.runtime.checking._value_rules import recursions, returned_values
from llfsm.runtime.engine.table import dead_transitions, unreachable_states
from llfsm.runtime.expressions.assignment import unassigned
from llfsm.runtime.expressions.reads import REQUESTS, Code, Uses, nodes_of, uses_of

_UNUSED = {"variable": "used", "sensor": "read", "actuator": "called"}


def findings_of(subject: Subject) -> list[Finding]:
    """Apply all rules; sort what they find by file and line, each thing once."""
    rules = (
        *(_unreachable, _dead, _unused, _unknown, _forgotten, _uninitialised),
        *(_guards, _unassigned, _single),
        *(endless_loops, contradictory_times, repeated_guards, restarted_times),
        *(recursions, returned_values),
    )
    return sorted({finding for rule in rules for finding in rule(subject)})


def _unreachable(subject: Subject) -> Iterator[Finding]:
    initial = subject.states[0].name
    targets = {state.name: [each.target for each in state.transitions] for state in subject.states}
    places = {state.name: state.where for state in subject.states}
    for name, what in unreachable_states([initial, subject.suspend or initial], targets):
        yield Finding(*places[name], "warning", what)


def _dead(subject: Subject) -> Iterator[Finding]:
    for state in subject.states:
        leads = [(each.target, bool(each.always)) for each in state.transitions]
        for number, what in dead_transitions(state.name, leads):
            yield Finding(*state.transitions[number].where, "error", what)
        for each in state.transitions:
            if each.always is False:
                never = f"state {state.name!r}: the transition to {each.target!r} can never fire"
                yield Finding(*each.where, "warning", f"{never}, as its condition is always False")


def _uses(subject: Subject) -> list[tuple[Code, Uses]] | None:
    """List what each piece of code names of its machine; None if one hands the machine on."""
    uses = [(code, uses_of(code)) for code in subject.all_code()]
    return None if any(each.escapes for _, each in uses) else uses


def _unused(subject: Subject) -> Iterator[Finding]:
    found = _uses(subject)
    if subject.opaque or found is None:
        return  # code that is not here may use them
    uses = [each for _, each in found]
    used = {name for each in uses for name in (*each.loaded, *each.stored)}
    read = {name for each in uses for name in each.loaded}
    for name, (kind, where) in subject.declared.items():
        if name not in (used if kind == "variable" else read):
            shown = name.rpartition(".")[2]
            yield Finding(*where, "warning", f"{kind} {shown!r} is never {_UNUSED[kind]}")


def _unknown(subject: Subject) -> Iterator[Finding]:
    uses = _uses(subject)
    if subject.attributes is None or uses is None:
        return  # code that is not here may set them
    known = subject.attributes.union(*(each.stored for _, each in uses))
    for piece, each in uses:
        for name, line in each.loaded.items():
            if name not in known:
                near = did_you_mean(name, known)
                yield Finding(piece.file, line, "error", f"the machine has no {name!r}{near}")


def _forgotten(subject: Subject) -> Iterator[Finding]:
    """Find attributes that are assigned though none is declared, and nothing reads them."""
    uses = _uses(subject)
    if subject.attributes is None or subject.opaque or uses is None:
        return  # code that is not here may read them
    known = subject.attributes.union(*(each.loaded for _, each in uses))
    variables = [name for name, each in subject.declared.items() if each.kind == "variable"]
    for piece, each in uses:
        for name, line in each.stored.items():
            if name not in known:
                text = f"{name!r} is not a variable of the machine, and nothing reads it"
                if name in _CURRENT:
                    text += ": transitions change the state"
                near = did_you_mean(name, variables)
                yield Finding(piece.file, line, "warning", text + near)


_CURRENT = ("current", "current_state", "next_state", "state")


def _uninitialised(subject: Subject) -> Iterator[Finding]:
    code = subject.methods.get("__init__")
    if code is None:
        return
    calls = (node.func for node in nodes_of(code) if isinstance(node, ast.Call))
    if not any(isinstance(each, ast.Attribute) and each.attr == "__init__" for each in calls):
        line = getattr(code.body[0], "lineno", 1)
        text = "__init__ must call super().__init__(**variables); better declare variables"
        yield Finding(code.file, line, "error", text)


def _guards(subject: Subject) -> Iterator[Finding]:
    for state in subject.states:
        for guard, where in ((each.guard, each.where) for each in state.transitions):
            if guard is None:
                continue
            if not uses_of(guard).returns and not isinstance(guard.body[-1], ast.Raise):
                yield Finding(*where, "error", "this guard returns no value: return True or False")
            yield from _effects(subject, guard)


def _effects(subject: Subject, guard: Code) -> Iterator[Finding]:
    """Find what a guard, which may be evaluated any number of times, does to others."""
    todo: list[tuple[Code, Place | None, str]] = [(guard, None, "")]
    seen = set()
    while todo:
        code, outside, through = todo.pop()
        for name, line in uses_of(code).called.items():
            where = outside or Place(code.file, line)
            if name in subject.actuators:
                yield Finding(*where, "warning", f"a guard posts to actuator {name!r}{through}")
            elif name in REQUESTS:
                yield Finding(*where, "warning", f"a guard makes the request {name!r}{through}")
            elif name in subject.methods and name not in seen:
                seen.add(name)
                todo.append((subject.methods[name], where, through or f", through {name!r}"))


def _single(subject: Subject) -> Iterator[Finding]:
    first, *others = subject.states
    if first.goes_on and not others and not first.transitions:
        text = f"the only state {first.name!r} has no transitions: the machine ends after one turn"
        text += "; one that goes on there has State(final=False)"
        yield Finding(*first.where, "warning", text)


def _unassigned(subject: Subject) -> Iterator[Finding]:
    if subject.opaque:
        return  # the name may be that of a variable whose declaration cannot be read
    for code in subject.all_code():
        for name, line, given_at in unassigned(code):
            if given_at:
                text = f"{name!r} has a value here only if line {given_at} ran"
                yield Finding(code.file, line, "warning", text)
            else:
                yield Finding(code.file, line, "error", f"{name!r} has no value yet")
