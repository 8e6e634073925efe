"""What ``llfsm run -t`` tells at the end: how often machines ran, and how long it took."""

from __future__ import annotations

from collections.abc import Iterable

from llfsm.runtime.engine.statistics import MachineStatistics, Spread

__all__ = ["timing_table"]

_HEADS = ("machine", "ringlets", "fired", "cost us", "jitter us", "overruns", "worst us")


def timing_table(machines: Iterable[MachineStatistics]) -> str:
    """Return a table of the machines' statistics: spreads as p50 / p99 / max, states below."""
    rows = [_HEADS]
    notes: list[list[str]] = [[]]
    for machine in machines:
        planned = machine.jitter_us is not None
        rows.append(
            (
                machine.machine,
                str(machine.ringlets),
                str(machine.fired),
                _spread(machine.cost_us),
                _spread(machine.jitter_us),
                str(machine.overruns) if planned else "-",
                f"{machine.worst_overrun_us:.0f}" if planned else "-",
            )
        )
        total = sum(machine.state_s.values()) or 1.0
        width = max((len(state) for state in machine.state_s), default=0)
        notes.append(
            [
                f"    {state.ljust(width)} {seconds:10.3f} s {seconds / total:6.1%}"
                for state, seconds in machine.state_s.items()
            ]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row, states in zip(rows, notes, strict=True):
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines += ["  ".join(cells), *states]
    return "\n".join(lines)


def _spread(spread: Spread | None) -> str:
    return "-" if spread is None else f"{spread.p50:.1f} / {spread.p99:.1f} / {spread.max:.1f}"
