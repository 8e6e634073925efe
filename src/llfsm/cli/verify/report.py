"""What an exploration found, as text and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import indent
from typing import Any

import msgspec

from llfsm.runtime.counterexamples.narrative import rows_of, table_of
from llfsm.runtime.counterexamples.regression import script_of
from llfsm.runtime.verification import Space, Verdict, Witness

__all__ = ["as_data", "as_text", "verdict_of"]

_VERDICTS = {True: "holds", False: "violated", None: "undecided"}


def verdict_of(verdict: Verdict) -> str:
    """Return "holds", "violated" or "undecided"."""
    return _VERDICTS[verdict.holds]


def as_text(space: Space, verdicts: Sequence[Verdict], period_ms: float | None, ended: str) -> str:
    """Return the report; `ended` is why the exploration ended early, "" if it did not."""
    lines = [
        f"{space.states:,} states, {space.transitions:,} transitions, {space.depth:,} turns deep, "
        f"{space.ringlets:,} ringlets run, in {space.seconds:.1f} s; "
        + ("any time between rounds" if period_ms is None else f"a round every {period_ms:g} ms")
    ]
    if ended:
        lines.append(f"not all is decided: {ended}")
        lines += space.hints()
    for verdict in verdicts:
        why = ": what triggers it never happens" if verdict.vacuous else ""
        lines.append(f"{verdict_of(verdict)}: {verdict.property}{why}")
        if verdict.holds is False and verdict.witness is not None:
            lines += _story(space, verdict.witness)
    if space.complete:
        lines += [f"never reached: {each}" for each in space.unreached]
        lines += [f"never taken: {each}" for each in space.untaken]
    return "\n".join(lines)


def _story(space: Space, witness: Witness) -> list[str]:
    """Return what happens on a way, line by line."""
    number = len(witness.turns)
    if not number:
        return ["  in the initial state"]
    script = script_of(witness, space.slots)
    rows = rows_of(space.members, script, unload_accepting=space.unload_accepting)
    table = table_of(rows[:number], number - 1)
    lines = [f"  after {number} turn{'s' if number != 1 else ''}:", indent(table, "  ")]
    if witness.loop is not None:
        first = witness.turns[witness.loop].round
        lines.append(f"  and so on for ever: all from round {first} on repeats")
    lines += [f"  {line}" for line in witness.end_lines()]
    return lines


def as_data(space: Space, verdicts: Sequence[Verdict], period_ms: float | None, ended: str) -> Any:
    """Return the report as data for JSON."""
    return {
        "states": space.states,
        "transitions": space.transitions,
        "depth": space.depth,
        "ringlets": space.ringlets,
        "seconds": round(space.seconds, 3),
        "period_ms": period_ms,
        "complete": space.complete,
        "ended": ended or None,
        "hints": list(space.hints()) if ended else [],
        "properties": [
            {
                "property": str(verdict.property),
                "kind": verdict.property.kind,
                "verdict": verdict_of(verdict),
                "vacuous": verdict.vacuous,
                "loop": None if verdict.witness is None else verdict.witness.loop,
                "at_end": {} if verdict.witness is None else dict(verdict.witness.at_end),
                "witness": None
                if verdict.witness is None
                else [msgspec.to_builtins(turn._asdict()) for turn in verdict.witness.turns],
            }
            for verdict in verdicts
        ],
        "unreached": list(space.unreached) if space.complete else [],
        "untaken": list(space.untaken) if space.complete else [],
    }
