"""The table of faults in the documents is that of the program that measures them."""

from __future__ import annotations

import re
from pathlib import Path

from soak.faults import KINDS

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "safety.md"
ROW = re.compile(r"\| (.+) \| (\d+) \| \d+ ms \| (\d+) ms \| (\d+) ms \|")


def test_the_page_has_every_kind_with_its_limit_and_none_was_exceeded() -> None:
    rows = [row.groups() for row in map(ROW.fullmatch, PAGE.read_text().splitlines()) if row]
    assert [(name, int(most)) for name, _, _, most in rows] == [
        (kind.name, kind.most_ms) for kind in KINDS
    ]
    assert len(rows) >= 40
    assert sum(int(times) for _, times, _, _ in rows) >= 400
    assert all(int(worst) <= int(most) for _, _, worst, most in rows)


def test_all_that_others_end_within_a_quarter_of_a_second_but_what_the_page_names() -> None:
    longer = {kind.name for kind in KINDS if kind.most_ms > 250}
    named = (
        "SIGINT",
        "SIGTERM",
        "KeyboardInterrupt",
        "stopped by",
        "--will-after",
        "without a guard",
    )
    assert {name for name in longer if not any(each in name for each in named)} == set()
