"""clfsm's dispatch tables: what they say, and the line of what is wrong in them."""

from __future__ import annotations

from math import lcm
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.engine.schedule import TimeSlot
from llfsm.runtime.plans import DispatchTable, PlannedMachine, read_dispatch_table, read_plan


def table(folder: Path, text: str) -> DispatchTable:
    file = folder / "table.txt"
    file.write_text(text, newline="")
    return read_dispatch_table(file)


GOOD = (
    "A.machine\t1000\t300\nb/B.machine\t2000\t500\tS\nC\t2000\t100\tP\n"
    "\n"
    "0\t0\n1\t400\n0\t1000\n2\t1900\n"
)


def test_two_tables(tmp_path: Path) -> None:
    reported = table(tmp_path, GOOD)
    assert reported.machines == (
        PlannedMachine(definition="A.machine", period_us=1000, deadline_us=300),
        PlannedMachine(definition="b/B.machine", period_us=2000, deadline_us=500, suspended=True),
        PlannedMachine(definition="C", period_us=2000, deadline_us=100, preload=True),
    )
    timetable = reported.timetable(["a", "b", "c"])
    assert timetable.slots == (
        TimeSlot("a", 0, 300),
        TimeSlot("b", 400, 500),
        TimeSlot("a", 1000, 300),
        TimeSlot("c", 1900, 100),
    )
    assert timetable.cycle_us == 2000


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace("\n", "\r\n"),
        GOOD + "\n\n  \n",
        GOOD.rstrip("\n"),
        GOOD.replace("\n\n", "\n\n\n"),
        GOOD.replace("\n\n", "\n \t\n"),
        GOOD.replace("\t300\n", "\t300\t\n"),
    ],
    ids=["CRLF", "blank lines after", "no last newline", "two blank lines", "blanks", "tab after"],
)
def test_blanks_at_the_ends_of_lines_and_file_mean_nothing(tmp_path: Path, text: str) -> None:
    assert table(tmp_path, text) == table(tmp_path, GOOD)


def test_slots_that_start_together_are_in_the_order_of_the_table(tmp_path: Path) -> None:
    reported = table(tmp_path, "A\t10\t5\nB\t10\t5\n\n1\t3\n0\t3\n1\t3\n")
    assert [slot.machine for slot in reported.timetable("AB").slots] == ["B", "A", "B"]


def test_a_tilde_is_the_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/robot")
    reported = table(tmp_path, "~/A.machine\t10\t5\nb~/B\t10\t5\n\n0\t0\n1\t0\n")
    assert [planned.definition for planned in reported.machines] == [
        "/home/robot/A.machine",
        "b~/B",
    ]


@pytest.mark.parametrize(
    ("text", "line", "printed"),
    [
        ("", 1, "a table of slots must follow"),
        ("\n\n", 1, "a table of slots must follow"),
        ("A\t10\t5\n", 1, "a table of slots must follow"),
        ("A\t10\t5\nB\t10\t5\n\n\n", 2, "a table of slots must follow"),
        ("A\t10\t5\nB 10 5\n\n0\t0", 2, "'B 10 5' is not: bundle, period and deadline"),
        ("A\t10\n\n0\t0", 1, r"'A\t10' is not: bundle"),
        ("A\t10\t5\tS\tP\n\n0\t0", 1, "is not: bundle"),
        ("A\t10\t5\n0\t0\n", 2, "is not: bundle"),
        ("A\t10\t5\ts\n\n0\t0", 1, "'s' must be S (suspended) or P (preloaded)"),
        ("A\t10\t5\t\tS\n\n0\t0", 1, "is not: bundle"),
        ("A\t0\t5\n\n0\t0", 1, "the period is '0'; it must be a whole number from 1"),
        ("A\t10\t0\n\n0\t0", 1, "the deadline is '0'"),
        ("A\t-10\t5\n\n0\t0", 1, "the period is '-10'"),
        ("A\t1e3\t5\n\n0\t0", 1, "the period is '1e3'"),
        ("A\t10\t1.5\n\n0\t0", 1, "the deadline is '1.5'"),
        ("A\t10\t\u0663\n\n0\t0", 1, "the deadline is '\u0663'"),
        ("A\t 10\t5\n\n0\t0", 1, "the period is ' 10'"),
        ("A\t\t5\n\n0\t0", 1, "the period is ''"),
        ("\t10\t5\n\n0\t0", 1, "bundle"),
        ("~nobody-has-this-name/A\t10\t5\n\n0\t0", 1, "~nobody-has-this-name"),
        ("A\t" + "1" * 5000 + "\t5\n\n0\t0", 1, "the period"),
        ("A\t10\t5\n\n0 0", 3, "'0 0' is not: number of a machine, start in us"),
        ("A\t10\t5\n\n0\t0\t1", 3, "is not: number of a machine"),
        ("A\t10\t5\n\nA\t0", 3, "the machine is 'A'"),
        ("A\t10\t5\n\n0\t0\n1\t5", 4, "there is no machine 1; they are 0 to 0"),
        ("A\t10\t5\n\n-1\t0", 3, "the machine is '-1'"),
        ("A\t10\t5\n\n0\t-1", 3, "the start is '-1'"),
        ("A\t10\t5\n\n\n0\t7\n\n0\t5", 6, "starts at 5 us, before the slot above it, at 7"),
        ("A\t10\t5\nB\t10\t5\nC\t10\t5\tP\n\n0\t0", 2, "B has no slot in the second table"),
        ("A\t10\t5\nB\t10\t5\tS\n\n0\t0", 2, "B has no slot in the second table"),
        ("\nA\t10\t5\n\n0\t0", 2, "is not"),
    ],
)
def test_a_malformed_line_is_reported(tmp_path: Path, text: str, line: int, printed: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        table(tmp_path, text)
    error = caught.value
    assert (error.file, error.line) == (tmp_path / "table.txt", line), str(error)
    assert printed in str(error)


def test_a_preloaded_machine_needs_no_slot(tmp_path: Path) -> None:
    reported = table(tmp_path, "A\t10\t5\nB\t7\t5\tP\n\n0\t0")
    assert reported.timetable("AB").machines == ("A",)
    assert reported.timetable("AB").cycle_us == 10


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="none: cannot be read: No such file"):
        read_dispatch_table(tmp_path / "none")
    with pytest.raises(ConfigurationError, match=f"{tmp_path}: cannot be read: Is a directory"):
        read_dispatch_table(tmp_path)
    file = tmp_path / "latin"
    file.write_bytes(b"\xe9\t10\t5\n\n0\t0\n")
    with pytest.raises(ConfigurationError, match="latin: is not UTF-8 text"):
        read_dispatch_table(file)


PERIODS = st.sampled_from([1, 2, 3, 4, 5, 6, 8, 9, 10, 12, 15, 20])


@st.composite
def schedules(draw: st.DrawFn) -> list[tuple[int, int, int]]:
    """Draw (period, deadline, start) for some machines."""
    machines = []
    for _ in range(draw(st.integers(1, 4))):
        period = draw(PERIODS)
        machines.append((period, draw(st.integers(1, 30)), draw(st.integers(0, period - 1))))
    return machines


@given(schedules())
def test_the_same_schedule_as_an_arrangement_file(
    tmp_path_factory: pytest.TempPathFactory, machines: list[tuple[int, int, int]]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    toml = folder / "robot.toml"
    toml.write_text(
        "".join(
            f"[[machine]]\ndefinition = 'm{number}'\nperiod_us = {period}\n"
            f"deadline_us = {deadline}\nstart_us = {start}\n"
            for number, (period, deadline, start) in enumerate(machines)
        )
    )
    cycle = lcm(*(period for period, _, _ in machines))
    slots = sorted(
        (begin + start, number)
        for number, (period, _, start) in enumerate(machines)
        for begin in range(0, cycle, period)
    )
    reported = table(
        folder,
        "".join(f"m{n}\t{period}\t{late}\n" for n, (period, late, _) in enumerate(machines))
        + "\n"
        + "".join(f"{number}\t{start}\n" for start, number in slots),
    )
    names = [f"m{number}" for number in range(len(machines))]
    mine, other = reported.timetable(names), read_plan(toml).timetable(names)
    assert other is not None
    assert (mine.slots, mine.cycle_us) == (other.slots, other.cycle_us)


@given(st.lists(PERIODS, min_size=1, max_size=4), st.data())
def test_the_cycle_is_the_shortest_that_is_even_and_holds_all_slots(
    tmp_path_factory: pytest.TempPathFactory, periods: list[int], data: st.DataObject
) -> None:
    starts = sorted(
        data.draw(st.lists(st.integers(0, 200), min_size=len(periods), max_size=len(periods) + 5))
    )
    slots = [(number % len(periods), start) for number, start in enumerate(starts)]
    reported = table(
        tmp_path_factory.getbasetemp(),
        "".join(f"m{number}\t{period}\t1\n" for number, period in enumerate(periods))
        + "\n"
        + "".join(f"{number}\t{start}\n" for number, start in slots),
    )
    cycle = reported.timetable([f"m{number}" for number in range(len(periods))]).cycle_us
    even = [us for us in range(1, cycle + 1) if all(us % period == 0 for period in periods)]
    assert cycle in even
    assert starts[-1] - starts[0] < cycle
    assert not any(starts[-1] - starts[0] < us for us in even if us < cycle)
