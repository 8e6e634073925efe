"""Measure llfsm and its peers in one run, and say whether what is promised is met.

The exit status is 1 unless every promise is met. A quick run is too short to judge: its exit
status is 0, also if a peer is not installed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import bridge
import exploring
import fleet
import mirror
import ours
import pages
import reaction
import reversing
import safety
import through
from measure import (
    Meter,
    Pace,
    Side,
    answering,
    compiled,
    in_turns,
    process,
    statement,
    undisturbed,
)
from peers import PEERS, open_peer, version_of
from table import (
    ADDED_NS,
    ALONE_MIB,
    BESIDE,
    FASTER,
    HEAD,
    LEAST,
    MEDIANS,
    P99S,
    PERCENT,
    PERIODS,
    SLOWER,
    Row,
)

FULL = Pace(
    samples=1000,
    sample_s=0.0003,
    processes=31,
    idle_s=10,
    schedule_s=60,
    bridge=(5, 4.0),
    through=(5, 4.0),
    fleet_s=4,
    page_s=10,
    edits=10,
    explorations=(5, None),
    reversed_turns=(reversing.HOUR, 8),
)
QUICK = Pace(
    samples=3,
    sample_s=0.0001,
    processes=2,
    idle_s=0.3,
    schedule_s=0.2,
    bridge=(1, 0.3),
    through=None,  # its processes take seconds to start, and are those of the bridge
    fleet_s=None,  # likewise
    page_s=1,
    edits=1,
    explorations=(1, 5_000),
    reversed_turns=(100, 2),
)

_STARTING, _ROUNDS = 50, 500  # of a period of 1 ms: those in which machines are published, and then

# what, of ours, the peer, of the peer's, how many times faster ours is promised to be
COMPARED: list[tuple[str, str, str, str, float | None]] = [
    ("get a Twist, nothing new", "get", "iceoryx2", "get", 25),
    ("get_message, nothing new", "get_message", "iceoryx2", "get", None),
    ("get; they only ask for news", "get", "iceoryx2", "is_up_to_date", None),
    ("get a Twist, a new one", "get news", "iceoryx2", "get news", 1.5),
    ("add a Twist", "add", "iceoryx2", "add", 4),
    ("build and add a Twist", "build and add", "iceoryx2", "build and add", None),
    ("a ringlet that fires", "firing", "py_trees", "step", 6),
    ("a ringlet; they tick the leaf", "firing", "py_trees", "step of the leaf", None),
    ("a ringlet that fires", "firing", "transitions", "step", 20),
    ("a ringlet that fires", "firing", "python-statemachine", "step", 150),
    ("a ringlet that fires", "firing", "sismic", "step", 150),
    ("a ringlet; they skip contracts", "firing", "sismic", "step without contracts", None),
    ("a ringlet that fires, guarded", "guarded", "py_trees", "step", None),
]

# what, of ours, how many times faster its twin is promised to be than the definition in Python
TWINS: list[tuple[str, str, float]] = [
    ("  and its definition", "many", 2.8),
    ("a round of one that fires", "firing", 1.5),
    ("a ringlet of a wall machine", "wall", 2.2),
]


def rows(pace: Pace) -> Iterator[Row]:
    """Measure all there is to measure, row by row."""
    yield from _calls(pace)
    yield from _safety(pace)
    yield from _processes(pace)
    yield from _reaction(pace)
    yield from _schedule(pace)
    yield from _lateness(pace)
    yield from bridge.rows(*pace.bridge)
    if pace.through is not None:
        yield from through.rows(*pace.through)
    yield from _mirror(pace)
    if pace.fleet_s is not None:
        yield from fleet.rows(pace.fleet_s)
    yield from exploring.rows(*pace.explorations)
    yield from reversing.rows(*pace.reversed_turns)
    yield from pages.rows(pace.page_s, pace.edits)


def _calls(pace: Pace) -> Iterator[Row]:
    with ExitStack() as stack:
        mine = stack.enter_context(ours.subjects())
        theirs = {peer: open_peer(peer, stack) for peer in PEERS}
        pairs = [
            (what, mine[name], peer, theirs[peer].get(its_name), FASTER, promised)
            for what, name, peer, its_name, promised in COMPARED
        ]
        what = f"a ringlet that stays, of {ours.MANY}"
        empty = mine["empty method"]
        pairs.append((what, mine["many"], "an empty method", empty, SLOWER, 2.5))
        for what, name, promised in TWINS:
            pairs.append(
                (what, mine[name], "in Python", mine[f"{name}, defined"], FASTER, promised)
            )
        plain = mine["class"]
        pairs.append(
            ("a ringlet of a bundle", mine["bundle"], "the same class", plain, SLOWER, 1.5)
        )
        pairs.append(("a ringlet, observed", mine["observed"], "unobserved", plain, SLOWER, None))
        for what, name, promised in (
            ("a ringlet, with a debugger", "no breakpoints", 1.02),
            ("  with 20 breakpoints on other states", "breakpoints", 1.2),
        ):
            pairs.append((what, mine[name], "without one", plain, SLOWER, promised))
        pairs.append(("a ringlet, timed", mine["timed"], "untimed", plain, SLOWER, None))
        polled = mine["minute, polled"]
        pairs.append(
            ("a minute of ten that wait", mine["minute"], "each round run", polled, FASTER, 4)
        )
        for what, timed, untimed in (
            ("  of ten machines", "ten timed", "ten"),
            ("  and with a period", "period", "period, untimed"),
            ("  and with a timetable", "timetable", "timetable, untimed"),
        ):
            pairs.append((what, mine[timed], "untimed", mine[untimed], ADDED_NS, 150))
        for what, subject, who, other, score, promised in pairs:
            meters = [
                statement("llfsm", subject, pace.sample_s),
                statement(who, other, pace.sample_s),
            ]
            yield Row(what, in_turns(meters, pace.samples), score, promised)
        with ours.nonstop() as run:
            meters = [
                Meter("llfsm", "arrangement.run()", run),
                statement("an empty method", empty, pace.sample_s),
            ]
            sides = in_turns(meters, pace.processes)
        yield Row("100 wall machines, non-stop", sides, SLOWER, 28)


def _safety(pace: Pace) -> Iterator[Row]:
    """Let one machine have safe values, a last will and a guard, and another one none of them."""
    with safety.guarded() as boards:
        pairs = [
            ("an add, safe values and a guard", boards.adds, "a bare handle"),
            ("a ringlet with both, that posts", boards.ringlets, "neither"),
        ]
        for what, subjects, other in pairs:
            meters = [
                statement(who, subject, pace.sample_s)
                for who, subject in zip(("llfsm", other), subjects, strict=True)
            ]
            yield Row(what, in_turns(meters, pace.samples), SLOWER, 1.02)
            assert boards.is_guarded(), "there is no last will for the guard to watch"
        percent = Side("llfsm", "safety.py", [boards.percent(pace.page_s)])
        yield Row("  the guard of one, part of a core", [percent], PERCENT, 0.5)
    yield Row("a ringlet, watched", in_turns(safety.watched(), pace.processes), SLOWER, None)


def _processes(pace: Pace) -> Iterator[Row]:
    python, times = sys.executable, pace.processes
    meters = [
        process("llfsm", python, "-c", "import llfsm.whiteboard"),
        process("python alone", python, "-c", "pass"),
    ]
    yield Row("import llfsm.whiteboard", in_turns(meters, times), LEAST, 6)
    meters[0] = process("llfsm", str(Path(python).with_name("llfsm")), "--help")
    yield Row("llfsm --help", in_turns(meters, times), LEAST, 6)
    meters = [Meter("llfsm", "footprint.py", _footprint)]
    yield Row("memory: 100 slots, 4 machines", in_turns(meters, min(times, 3)), ALONE_MIB, 40)


def _reaction(pace: Pace) -> Iterator[Row]:
    """Let a machine answer another process, both ways counted, and ten machines wait for it."""
    board = f"bench-{os.getpid()}-reaction"
    with reaction.samplers(board) as (mine, theirs):
        meters = [
            Meter("llfsm", "add to the answer, read", mine),
            Meter("C futexes", "futex.c", theirs),
        ]
        sides = in_turns(meters, pace.samples)
    for name, part in (("p50", 0.5), ("p99", 0.99)):
        shown = [
            Side(side.who, side.call, [_quantile(side.samples, part)] if side.samples else [])
            for side in sides
        ]
        promised = {"p50": 10, "p99": 20}[name]
        yield Row(f"an answer of a machine, {name}", shown, SLOWER, promised)
    ours, its = reaction.idle_percents(board, 10, pace.idle_s)
    sides = [Side("llfsm", "llfsm run", ours), Side("sleep.c", "sleep.c", its)]
    yield Row("  ten machines that wait", sides, BESIDE, 1)


def _quantile(samples: list[float], part: float) -> float:
    return sorted(samples)[int(part * len(samples))]


def _schedule(pace: Pace) -> Iterator[Row]:
    """Let ten machines keep to a timetable at 1 kHz, and a bare loop beside them."""
    call = "schedule.py"
    ours = _times_kept("machines", pace.schedule_s)
    loop = _times_kept("loop", pace.schedule_s / 4)
    for part in ("p50", "p99"):
        sides = [Side("llfsm", call, [ours[part]]), Side("sleeping loop", call, [loop[part]])]
        yield Row(f"jitter of 10 machines, {part}", sides, SLOWER, None)
    late = 100 * ours["late"] / ours["turns"]
    yield Row("  turns that ended late", [Side("llfsm", call, [late])], PERCENT, None)
    yield Row(
        f"  drift after {pace.schedule_s:g} s", [Side("llfsm", call, [ours["drift"]])], PERIODS, 1
    )


def _lateness(pace: Pace) -> Iterator[Row]:
    """Let ten machines keep a period of 1 ms, and a loop in C that only sleeps, in turns.

    What is late is a round's begin, with its first turn. The loop wakes once a period; so do the
    machines, but in real time once more, shortly before.
    """
    rounds = str(_STARTING + _ROUNDS)
    script = str(Path(__file__).with_name("schedule.py"))
    for what, priority in (("rounds of 10 at 1 kHz, late, p99", "0"), ("  with --realtime", "50")):
        board = f"bench-{os.getpid()}-lateness"
        sides = [Side("llfsm", "schedule.py", []), Side("sleep.c", "sleep.c", [])]
        with ExitStack() as stack:
            ask = answering(sys.executable, script, "lateness", rounds, board, priority)
            asked = [stack.enter_context(ask)]
            program = stack.enter_context(compiled("sleep.c"))
            if program is not None:
                ask = answering(program, "lateness", "1000", rounds, priority)
                asked.append(stack.enter_context(ask))
            try:
                pairs = list(zip(sides, asked, strict=False))
                for _ in range(max(round(pace.schedule_s), 1)):
                    for side, rounds_of in pairs:
                        printed = [int(number) for number in rounds_of().split()]
                        side.samples.extend(undisturbed(printed, _STARTING))
                    pairs.reverse()
                why = None
            except ValueError:  # what it prints is no number
                sides = [side._replace(samples=[]) for side in sides]
                why = "SCHED_FIFO is not permitted here"
        yield Row(what, sides, P99S, 1.2, why)


def _mirror(pace: Pace) -> Iterator[Row]:
    """Send one message at a time to another host's board, and through Zenoh alone.

    And let a process use a board that is mirrored, and one that is not.
    """
    with mirror.samplers() as (ours_, theirs):
        meters = [
            Meter("llfsm", "add to get, two daemons between", ours_),
            Meter("Zenoh alone", "put to callback", theirs),
        ]
        sides = in_turns(meters, 10 * pace.processes)
    yield Row("an add here, there on the board", sides, MEDIANS, 1.5)
    with mirror.beside() as boards:
        for what, call in (("a get", "slot.get()"), ("an add", "slot.add(message)")):
            meters = [
                statement(who, mirror.used(call, names), pace.sample_s)
                for who, names in zip(("llfsm", "no daemon"), boards, strict=True)
            ]
            sides = in_turns(meters, pace.samples)
            yield Row(f"{what} beside a daemon", sides, SLOWER, 1.1)
        meters = [
            Meter(who, "slot.add(message), each 12 ms", mirror.spaced(names))
            for who, names in zip(("llfsm", "no daemon"), boards, strict=True)
        ]
        yield Row("  an add that wakes it", in_turns(meters, pace.samples // 3), MEDIANS, None)


def _times_kept(what: str, seconds: float) -> dict[str, float]:
    script = str(Path(__file__).with_name("schedule.py"))
    board = f"bench-{os.getpid()}-schedule"
    command = [sys.executable, script, what, str(seconds), board]
    figures: dict[str, float] = json.loads(
        subprocess.run(
            command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ).stdout
    )
    return figures


def _footprint() -> float:
    script = str(Path(__file__).with_name("footprint.py"))
    board = f"bench-{os.getpid()}-footprint"
    return int(subprocess.check_output([sys.executable, script, board]))


def facts() -> dict[str, str | int | None]:
    """Say what the figures depend on."""
    cpu = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "cpu": cpu[1] if cpu else platform.machine(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.release()}",
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    parser.add_argument("--quick", action="store_true", help="only try that everything runs")
    options = parser.parse_args()

    machine = facts()
    print("{python}, {cpu}, {cores} cores, {system}\n".format(**machine))
    print(HEAD, flush=True)
    measured = []
    for row in rows(QUICK if options.quick else FULL):
        print(row.text(), flush=True)
        measured.append(row)

    versions = {peer: version_of(peer) for peer in PEERS}
    missing = [peer for peer, version in versions.items() if version is None]
    failed = [row for row in measured if row.promised is not None and not row.met]
    print()
    if missing:
        print(f"not installed: {', '.join(missing)}; see pip install 'llfsm[bench]'")
    for row in measured:
        if row.unmeasured:
            print(f"not measured: {row.what.strip()}; {row.unmeasured}")
    if options.quick:
        print("a quick run: too short to judge")
    else:
        print(f"missed: {len(failed)}" if failed else "every promise is met")
    if options.json:
        report = {
            "machine": machine,
            "quick": options.quick,
            "peers": versions,
            "missing": missing,
            "rows": [row.json() for row in measured],
        }
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    return 1 if failed and not options.quick else 0


if __name__ == "__main__":
    sys.exit(main())
