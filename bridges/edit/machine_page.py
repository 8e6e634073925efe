"""A document as plain data for the editor's page, in parts that change independently."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache, partial
from typing import Any, cast

from llfsm.bridges.edit.message_types import ros_class
from llfsm.bridges.view.frames import plain_diagram
from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.bundles.code import parse_expression
from llfsm.runtime.bundles.compiling import outline, outline_beside
from llfsm.runtime.bundles.model import CLASS, PYTHON, Bundle, Fragment
from llfsm.runtime.bundles.read import SUFFIX
from llfsm.runtime.checking import Finding
from llfsm.runtime.checking.message_fields import class_fields, message_fields
from llfsm.runtime.drawing import arrange
from llfsm.runtime.editing import Document
from llfsm.runtime.editing.sketch import sketch
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.table import dead_transitions, unreachable_states
from llfsm.runtime.expressions.reads import truth_of
from llfsm.runtime.presence.remote import condition_of
from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus


def machine_data(document: Document) -> dict[str, Any]:
    """Describe the machine of a document; raise `BundleError` if it cannot be read.

    `boxes`, `edges` and `texts` have keys, by which only what has changed is sent.
    """
    bundle = document.bundle
    dead = _dead(bundle)
    drawn = plain_diagram(sketch(bundle))
    layout = bundle.layout.states if bundle.layout else {}
    texts = bundle.texts()
    return {
        "name": bundle.name,
        "language": bundle.language,
        "editable": bundle.language == PYTHON,
        "converts": _CONVERTS.get(bundle.language),
        "shape": document.shape,
        "states": [state.name for state in bundle.states],
        "suspend": bundle.suspend,
        "runs": {state.name: state.runs for state in bundle.states if state.runs},
        "histories": [state.name for state in bundle.states if state.history],
        "machines": _machines_beside(document),
        "lasting": [state.name for state in bundle.states if not state.final],
        "expanded": [name for name, box in layout.items() if box.expanded],
        "frame": drawn["frame"],
        "start": drawn["start"],
        "boxes": {box["state"]: box for box in drawn["boxes"]},
        "edges": {f"{edge['source']}:{edge['number']}": edge for edge in drawn["edges"]},
        "texts": {f"{state}|{part}": [_name(text), text.text] for state, part, text in texts},
        "unreachable": _unreachable(bundle, set(dead)),
        "dead": dead,
        "undo": document.can_undo,
        "redo": document.can_redo,
    }


def unfolded_data(document: Document) -> dict[str, Any]:
    """Draw the machine with those that its states run inside of them, or report why not."""
    try:
        bundle = document.bundle
        table = outline(bundle)
    except BundleError as error:
        return {"problem": str(error)}
    return plain_diagram(arrange(table, title=bundle.name, unfold=partial(outline_beside, bundle)))


def findings_data(document: Document) -> dict[str, Any]:
    """Check the texts as `llfsm check` does; add the names and fields that code can use.

    `fields` are those of the messages that names hold, `classes` those of message classes.
    """
    found, names = document.findings()
    data: dict[str, Any] = {"findings": [_finding(each) for each in found], "names": names}
    try:
        bundle = document.bundle
    except BundleError:
        return data | {"fields": {}, "classes": {}}
    fields, classes = message_fields(bundle, ros_class), class_fields(bundle, ros_class)
    return data | {"fields": fields, "classes": classes}


def live_data(source: PageSource, name: str) -> dict[str, Any]:
    """Return state and condition of the machine of a name on a board; no state if none is live."""
    snapshot = source.snapshot()
    sample = snapshot.samples.get(MACHINES + name)
    live: dict[str, Any] = {"board": source.title, "state": None, "condition": "ended"}
    live |= {"pending": "", "refusal": ""}
    if sample is None or not isinstance(sample.message, MachineStatus):
        return live
    status = cast("Sample[MachineStatus]", sample)
    if source.is_live(status):
        silent_s = (snapshot.now_ns - sample.stamp_ns) / 1e9
        failed = sample.message.error_state if sample.message.failed else None
        live |= {"state": sample.message.state, "condition": condition_of(sample.message, silent_s)}
        live |= {"failed": failed, "pending": sample.message.pending}
        live |= {"refusal": sample.message.refusal, "obeyed": sample.message.obeyed}
    return live


def _machines_beside(document: Document) -> list[str]:
    """Name the bundles beside this one, which its states can run."""
    if document.bundle.language != PYTHON:
        return []
    found = sorted(path.stem for path in document.path.parent.glob(f"*{SUFFIX}"))
    return [name for name in found if name != document.bundle.name]


def _finding(finding: Finding) -> dict[str, Any]:
    return {**finding._asdict(), "file": finding.file.rpartition("/")[2]}


def _name(text: Fragment) -> str:
    return "" if text.file is None else text.file.name


def _unreachable(bundle: Bundle, dead: Collection[str]) -> list[str]:
    """Find the states to which no transitions lead that can fire."""
    first = bundle.states[0].name
    targets = {
        state.name: [
            each.target
            for number, each in enumerate(state.transitions)
            if f"{state.name}:{number}" not in dead
        ]
        for state in bundle.states
    }
    starts = [first, bundle.suspend or first]
    return [name for name, _ in unreachable_states(starts, targets)]


def _dead(bundle: Bundle) -> list[str]:
    """Find the transitions that can never fire, by their condition or one before them."""
    dead = []
    for state in bundle.states:
        truths = [_truth(each.expression, bundle.language) for each in state.transitions]
        leads = [(each.target, bool(t)) for each, t in zip(state.transitions, truths, strict=True)]
        numbers = {number for number, _ in dead_transitions(state.name, leads)}
        numbers |= {number for number, truth in enumerate(truths) if truth is False}
        dead += [f"{state.name}:{number}" for number in sorted(numbers)]
    return dead


def _truth(expression: Fragment | None, language: str) -> bool | None:
    """Return the constant value of a condition; None if its text alone does not show one."""
    if expression is None or expression.text.strip() == "true":
        return True
    return _python_truth(expression.text) if language in (PYTHON, CLASS) else None


@lru_cache(maxsize=4096)
def _python_truth(text: str) -> bool | None:
    try:
        return truth_of(parse_expression(Fragment(text)))
    except BundleError:
        return None


_CONVERTS = {PYTHON: "class", CLASS: "bundle"}
