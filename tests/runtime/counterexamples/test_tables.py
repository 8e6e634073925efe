"""Tables of counterexamples: what repeats is folded, and they fit a screen unless told not to."""

from __future__ import annotations

import re
from itertools import groupby

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import Machine, State
from llfsm.runtime.counterexamples import TurnRow, table_of
from llfsm.runtime.verification import PropertyError, always_possible, explore, verify

turns = st.sampled_from(["", "in A", "A -> B"])


def rows_of(rounds: list[tuple[str, str]]) -> list[TurnRow]:
    """Two machines, and what they do in each round: nothing new if that is no text."""
    return [
        TurnRow(number, number * 10**7, machine, "", did or "in A", "", quiet=not did)
        for number, each in enumerate(rounds, 1)
        for machine, did in zip(("One", "Two"), each, strict=True)
    ]


def unfolded(table: str) -> list[tuple[int, str, str]]:
    """Read a table: the round, machine and deed of each row that it stands for, none quiet."""
    rounds: dict[int, list[tuple[str, str]]] = {}
    last = 0
    for line in table.splitlines()[1:]:
        if folded := re.fullmatch(r"rounds? (\d+)(?: to (\d+))?: unchanged", line):
            first = int(folded[1])
            assert first == last + 1
            last = int(folded[2] or first)
            rounds |= {number: [] for number in range(first, last + 1)}
            continue
        found = re.fullmatch(r"(?:(\d+) +[\d.]+ ms)? +(One|Two) +(\S.*)", line)
        assert found is not None
        if found[1]:
            assert int(found[1]) == last + 1
            last = int(found[1])
        rounds.setdefault(last, []).append((found[2], found[3]))
    return [(number, *each) for number, rows in rounds.items() for each in rows or [("", "")]]


@given(st.lists(st.tuples(turns, turns), min_size=1, max_size=12))
def test_a_round_is_folded_only_if_it_is_like_the_one_before_or_quiet(
    rounds: list[tuple[str, str]],
) -> None:
    rows = rows_of(rounds)
    marked = len(rows) - 1
    found = {
        number: [each[1:] for each in rows_]
        for number, rows_ in groupby(unfolded(table_of(rows, marked)), key=lambda each: each[0])
    }
    assert list(found) == list(range(1, len(rounds) + 1))
    before: list[tuple[str, str]] = []
    for number, each in enumerate(rounds, 1):
        news = [(m, d) for m, d in zip(("One", "Two"), each, strict=True) if d]
        if number == len(rounds):
            shown = [row for row in news if row[0] == "One"] + [("Two", each[1] or "in A")]
            assert found[number] == shown
        elif not news or news == before:
            assert found[number] == [("", "")]
        else:
            assert found[number] == news
        before = news


@given(st.integers(1, 200))
def test_a_table_fits_a_screen_and_shows_how_it_ends(number: int) -> None:
    rows = rows_of([("A -> B", "") if n % 2 else ("", "in A") for n in range(number)])
    lines = table_of(rows, len(rows) - 1, full=False).splitlines()
    whole = table_of(rows, len(rows) - 1).splitlines()
    assert len(lines) <= 26
    if len(lines) == len(whole):
        assert lines == whole
        return
    (gap,) = (n for n, line in enumerate(lines) if "more rows" in line)
    assert lines[gap] == f"({len(whole) - 25} more rows: --full, full=True)"
    assert lines[:gap] == whole[:gap]
    assert lines[gap + 1 :] == whole[gap + 1 - len(lines) :]


class Counts(Machine):
    """Go from A to B after some turns, and stay."""

    n: int = 0
    A = State()
    B = State()

    @A.internal
    def _(self) -> None:
        self.n += 1

    A.to(B, when=lambda self: self.n >= 100)
    B.to(A, when=lambda self: False)


def test_a_notebook_shows_the_verdicts_of_a_space() -> None:
    space = explore(
        Counts, period_ms=10, properties=[always_possible(lambda v: v.Counts.state == "A", "<A>")]
    )
    assert "<td>&lt;A&gt;</td><td>violated</td><td>103</td>" in space._repr_html_()


def test_the_error_of_verify_describes_the_region() -> None:
    with pytest.raises(PropertyError, match="no way leads to it after turn 1: 102 states can foll"):
        verify(Counts, always_possible(lambda v: v.Counts.n == 0, "zero"), period_ms=10)
