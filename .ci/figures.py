"""Write the benchmark's figures into the page of comparisons, from a run of `make bench`.

usage: figures.py [--from out/bench.json]

With --from, that run becomes the one that the page shows: docs/concepts/bench.json. A test compares
the page with it.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import wrap
from typing import Any

ROOT = Path(__file__).parents[1]
RUN = ROOT / "docs/concepts/bench.json"
PAGE = ROOT / "docs/concepts/comparison.md"
_PART = re.compile(r"(<!-- figures -->\n).*?(\n<!-- end of figures -->)", re.DOTALL)

# What the page says, the row of the bench, and the peer's name there: all rows of that name.
_CALLS = [
    ("read a message that has not changed", "get a Twist, nothing new", "iceoryx2"),
    ("ask whether there is news, and read", "get; they only ask for news", "iceoryx2, asked only"),
    ("read a new `Twist`", "get a Twist, a new one", "iceoryx2"),
    ("add a `Twist`", "add a Twist", "iceoryx2"),
    ("build a `Twist` and add it", "build and add a Twist", "iceoryx2"),
    ("a turn in which a transition fires", "a ringlet that fires", ""),
    ("", "a ringlet; they tick the leaf", "py_trees, its leaf alone"),
    ("", "a ringlet; they skip contracts", "sismic without its contracts"),
    ("a turn in which a guard fires", "a ringlet that fires, guarded", "py_trees"),
    ("a turn in which nothing happens", "a ringlet that stays, of 1000", "an empty Python method"),
    ("all states of a microwave", "  the same states in SPIN", "SPIN"),
]
_WAYS = [
    ("an `Odometry` from one topic through a slot to another", "Odometry, topic to topic, p50",
     "Zenoh, for half the path"),
    ("a cloud of 1 MB, likewise", "a cloud of 1 MB, topic to topic, p50",
     "Zenoh, for half the path"),
    ("", "  and by a bare relay", "a process that only forwards"),
    ("from an add on one host to another's board", "an add here, there on the board",
     "Zenoh alone"),
    ("an answer of a machine to another process, there and back: median",
     "an answer of a machine, p50", "two C programs that wake each other"),
    ("the same, 99th percentile", "an answer of a machine, p99",
     "two C programs that wake each other"),
]  # fmt: skip


def text(run: dict[str, Any]) -> str:
    """Return the part of the page that has figures."""
    about, rows = run["machine"], run["rows"]
    missed = [row["what"].strip() for row in rows if row["met"] is False]
    promised = sum(row["promised"] is not None for row in rows)
    said = "all were met" if not missed else f"missed were: {'; '.join(missed)}"
    names = {row["what"].strip(): row for row in rows}
    late = names["turns that ended late"]["value"]
    p99 = names["jitter of 10 machines, p99"]["sides"]
    return "\n".join(
        [
            f"{about['python']}, {about['cores']} cores of an {about['cpu'].split('(')[0]}, "
            f"{about['system'].split()[0]}.",
            "",
            *_table(rows, _CALLS),
            "",
            "Messages between processes and hosts (median, but where it says otherwise):",
            "",
            *_table(rows, _WAYS),
            "",
            f"Of ten machines at 1 kHz, each in a slot of 100 µs of a timetable, {late:.2g} % of",
            "the turns ended after their slot; the 99th percentile of the jitter was "
            f"{_time(p99[0]['median'])},",
            f"and that of a loop that only sleeps {_time(p99[1]['median'])}.",
            "",
            *wrap(f"The bench checks {promised} promises. In this run, {said}.", 120),
        ]
    )


def _table(rows: list[dict[str, Any]], shown: list[tuple[str, str, str]]) -> Iterator[str]:
    yield "| what | llfsm | other | ratio |"
    yield "|---|---|---|---|"
    for what, name, peer in shown:
        found = [row for row in rows if row["what"] == name and row["value"] is not None]
        for number, row in enumerate(found):
            ours, its = row["sides"]
            a, b = ours["median"], its["median"]
            who = peer or its["who"]
            ratio = f"{b / a:.2g}" if b < 100 * a else f"{b / a:.0f}"
            yield f"| {'' if number else what} | {_time(a)} | {_time(b)}, {who} | {ratio} |"


def _time(ns: float) -> str:
    for unit, size in (("ms", 1e6), ("µs", 1e3)):
        if ns >= size:
            return f"{ns / size:.3g} {unit}"
    return f"{ns:.0f} ns"


def page(run: dict[str, Any]) -> str:
    """Return the page with the figures of a run."""
    new, number = _PART.subn(rf"\g<1>{text(run)}\g<2>", PAGE.read_text())
    assert number == 1, "the page has no place for figures"
    return new


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--from", dest="run", type=Path, metavar="FILE")
    run = parser.parse_args().run
    if run is not None:
        RUN.write_text(json.dumps(json.loads(run.read_text()), indent=1) + "\n")
    PAGE.write_text(page(json.loads(RUN.read_text())))


if __name__ == "__main__":
    main()
