"""A counterexample as a script of the testing kit, and as a test that plays it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.machine import MachineType
from ..testing.python_text import KIT, PythonText
from ..testing.scripted import Ask, Step
from ..verification.witness import Witness

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot

    from ..verification.members import Member
    from ..verification.space import Space
    from ..verification.witness import ChosenTurn

__all__ = ["between_of", "regression_of", "script_of"]

_SUFFIX = ".machine"


def script_of(witness: Witness, slots: Mapping[str, Slot[Any]]) -> list[Step]:
    """Return what the environment did as a script; `slots` are the machines', by name."""
    steps = list(_steps(witness, slots))
    if witness.at_end:
        steps[-1] = steps[-1]._replace(after=witness.at_end)
    return steps


def between_of(witness: Witness) -> tuple[float, float] | None:
    """Return the times of `holds`: what is due when a loop begins must come before its end."""
    if witness.loop is None:
        return None
    return witness.turns[witness.loop].time_ms, witness.turns[-1].time_ms


def _steps(witness: Witness, slots: Mapping[str, Slot[Any]]) -> Iterator[Step]:
    contents: dict[str, Any] = {}
    now_ms = 0.0
    for _, turns in groupby((*witness.turns, *witness.rest), key=lambda turn: turn.round):
        first, *others = turns
        before: dict[str, dict[Slot[Any], Any]] = {}
        asks: dict[str, list[Ask]] = {}
        messages = _news(first, contents, slots)
        for turn in (first, *others):
            asked: list[Ask] = ["suspend"] if turn.withdraws else []
            if turn.request is not None:
                asked.append(turn.request.value)
            if turn.stop:
                asked.append("stop")
            if asked:
                asks[turn.machine] = asked
        for turn in others:
            if news := _news(turn, contents, slots):
                before[turn.machine] = news
        yield Step(first.time_ms - now_ms, messages, before, asks)
        now_ms = first.time_ms


def _news(
    turn: ChosenTurn, contents: dict[str, Any], slots: Mapping[str, Slot[Any]]
) -> dict[Slot[Any], Any]:
    """Return what the environment changes at a turn, and note it in `contents`."""
    news = {}
    for name, message in turn.found.items():
        if contents.get(name) is not message:  # equal ones are one object
            contents[name] = message
            news[slots[name]] = message
    return news


def regression_of(space: Space, witness: Witness, where: str, *, folder: Path | None) -> str:
    """Return Python text of a test that fails until the machines are mended.

    It plays what violates a property, which is called ``module:name`` as in `where`. Bundles are
    found from `folder`, which is to hold the test; None is the current one.
    """
    text = PythonText()
    module, _, name = where.partition(":")
    name = text.imported(module, name)
    holds = text.imported("llfsm.runtime.counterexamples", "holds")
    play = text.imported(KIT, "play")
    machines = "".join(f"            {_machine(text, each, folder)},\n" for each in space.members)
    steps = "".join(f"            {text.step(step)},\n" for step in script_of(witness, space.slots))
    keep = "        unload_accepting=True,\n" if space.unload_accepting else ""
    keep += "        to_end=True,\n" if space.suspend else ""
    between, given = between_of(witness), name
    if between is not None:
        given += f", between_ms=({between[0]:.15g}, {between[1]:.15g})"
    call = (
        f"    {play}(\n        [\n{machines}        ],\n        [\n{steps}        ],\n"
        f"        invariant={holds}({given}),\n{keep}    )\n"
    )
    return f"{text.imports()}\n\n\ndef test_{name.replace('.', '_')}() -> None:\n{call}"


def _machine(text: PythonText, member: Member, folder: Path | None) -> str:
    """Return what makes a machine as `play` takes it."""
    machine = member.machine
    bundle = Path(machine.table.path) if isinstance(machine, MachineType) else Path()
    if bundle.suffix == _SUFFIX:
        load = text.imported("llfsm.runtime.bundles", "load_bundle")
        path = text.imported("pathlib", "Path")
        here = "" if folder is None else f"{path}(__file__).parent / "
        beside = os.path.relpath(bundle, folder)
        made = f"{load}({here}{beside!r})" if here else f"{load}({path}({beside!r}))"
    else:
        made = text.named(machine, "machine")
    options = [
        f"{name}={value!r}"
        for name, value in member._asdict().items()
        if name != "machine" and value not in (None, {}, False)
    ]
    if not options:
        return made
    return f"{text.imported('llfsm.runtime.verification', 'Member')}({', '.join([made, *options])})"
