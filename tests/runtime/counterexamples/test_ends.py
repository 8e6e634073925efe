"""Requests as the last round ends are part of a counterexample, of its script and its test."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime.counterexamples import regression_of
from llfsm.runtime.testing import InvariantError
from llfsm.runtime.verification import explore
from waking import Waking, wakes


def test_a_suspend_and_a_stop_as_the_round_ends_are_played() -> None:
    """Before the next turn they would be too late: that one wakes the machine."""
    space = explore(Waking, properties=[wakes], period_ms=500, stop=True, suspend="Waking")
    witness = space.verdicts[0].witness
    assert witness is not None
    assert witness.at_end == {"Waking": ("suspend", "stop")}
    *_, last = witness.lines()
    assert last == "at the end of the round, Waking: suspend is asked for, stop is asked for"
    text = regression_of(space, witness, "waking:wakes", folder=Path())
    names: dict[str, object] = {}
    exec(text, names)
    test = names["test_wakes"]
    assert callable(test)
    with pytest.raises(InvariantError, match="wakes does not hold in round"):
        test()


def test_without_a_stop_it_wakes() -> None:
    """Somebody may suspend it again and again, but the machines do not end."""
    space = explore(Waking, properties=[wakes], period_ms=500, suspend="Waking")
    witness = space.verdicts[0].witness
    assert witness is None or (witness.loop is not None and not witness.at_end)
