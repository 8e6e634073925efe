"""The machines of an arrangement file that are open for editing, and the overview of them."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from llfsm.bridges.view.diagram_data import plain_diagram
from llfsm.runtime.converting.class_process import read_links
from llfsm.runtime.drawing import MachineLinks, overview
from llfsm.runtime.editing.document import Document
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.plans.plan import PlannedMachine

__all__ = ["OpenedMachine", "OpenedPlan", "overview_data"]

_PROCESSES = 4  # at once, each of which loads a machine


class OpenedMachine(NamedTuple):
    """A machine of an arrangement file: a document, or the reason why it cannot be opened."""

    planned: PlannedMachine
    document: Document | None
    problem: str = ""


class OpenedPlan(NamedTuple):
    """An arrangement file with its machines, by the names that they get."""

    path: Path
    machines: Mapping[str, OpenedMachine]


def overview_data(plan: OpenedPlan) -> dict[str, Any]:
    """Return the overview as the page draws it, and by machine why it cannot be loaded.

    Each machine is loaded, as its text is now, in a process of its own.
    """
    with ThreadPoolExecutor(_PROCESSES) as pool:
        found = dict(zip(plan.machines, pool.map(_links, plan.machines.values()), strict=True))
    links = {
        name: each if isinstance(each, MachineLinks) else _NONE for name, each in found.items()
    }
    problems = {name: each for name, each in found.items() if isinstance(each, str)}
    return {"diagram": plain_diagram(overview(plan.path.name, links)), "problems": problems}


def _links(machine: OpenedMachine) -> MachineLinks | str:
    if machine.document is None:
        return machine.problem
    try:
        return read_links(machine.document.found_by, machine.planned)
    except BundleError as error:
        return str(error)


_NONE = MachineLinks()
