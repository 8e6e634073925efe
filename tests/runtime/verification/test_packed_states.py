"""Packed states: the twins in C do what the definitions in Python do."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.verification import _packed_states as packed_states
from llfsm.runtime.verification import _twin as twin

pytestmark = pytest.mark.skipif(not twin.SPREAD, reason="the twins in C are not built, or hidden")

WORDS = st.sampled_from([1, 2, 3])


def numbers(words: int) -> st.SearchStrategy[int]:
    """Make states: small ones, which meet often, and any, of which some fill all bits."""
    most = (1 << (64 * words - 1)) - 1
    return st.one_of(st.integers(0, 9), st.integers(0, most), st.just(most))


def lists(words: int) -> st.SearchStrategy[list[list[int]]]:
    return st.lists(st.lists(numbers(words), max_size=80), max_size=6)


@given(st.data(), WORDS)
def test_what_is_new_is_found_in_the_same_order(data: st.DataObject, words: int) -> None:
    ours, theirs = twin.Seen(words), packed_states.Seen(words)
    for states in data.draw(lists(words)):
        found, expected = twin.States(words), packed_states.States(words)
        ours.add(twin.States(words, states), found)
        theirs.add(states, expected)
        assert [*found] == expected
        assert len(ours) == len(theirs)


@given(st.data(), WORDS)
def test_effects_are_the_same_and_asked_for_once(data: st.DataObject, words: int) -> None:
    """Some keys raise, now and then: what is known then stays."""
    most = (1 << (64 * words - 1)) - 1
    mask = data.draw(numbers(words))
    effects = st.lists(st.tuples(numbers(words), numbers(words)), max_size=3).map(tuple)
    chosen: dict[int, Any] = {}
    asked: list[list[int]] = [[], []]

    def filling(side: int) -> Any:
        def fill(key: int) -> tuple[int, tuple[packed_states.Effect, ...]]:
            asked[side].append(key)
            if key not in chosen:
                chosen[key] = data.draw(st.tuples(st.integers(0, 9), effects, st.booleans()))
            weight, its, fails = chosen[key]
            if fails:
                chosen[key] = weight, its, False
                raise KeyError(key)
            return weight, its

        return fill

    ours = twin.EffectTable(words, mask & most, filling(0))
    theirs = packed_states.EffectTable(words, mask & most, filling(1))
    for states in data.draw(lists(words)):
        for state in states:  # one by one, until none fails
            for table in (ours, theirs):
                while True:
                    try:
                        table.effects(state)
                    except KeyError:
                        continue
                    break
            assert ours.effects(state) == theirs.effects(state)
        after, weight = ours.apply(twin.States(words, states))
        expected = theirs.apply(states)
        assert ([*after], weight) == expected
        parts = ours.split(twin.States(words, states))
        assert ([*parts[0]], [*parts[1]]) == theirs.split(states)
    assert {*asked[0]} == {*asked[1]} == {key & mask for key in asked[0]}


@given(st.data(), WORDS)
def test_states_are_a_list(data: st.DataObject, words: int) -> None:
    states = data.draw(st.lists(numbers(words), max_size=20))
    ours = twin.States(words, states)
    assert (len(ours), [*ours]) == (len(states), states)
    part = data.draw(st.slices(len(states)))
    assert [*ours[part]] == states[part]
    assert all(state in ours for state in states)
    if states:
        assert ours[-1] == states[-1]
    with pytest.raises(IndexError):
        ours[len(states)]


def test_what_is_no_state_is_refused() -> None:
    for wrong in (-1, 1 << 64):
        with pytest.raises(OverflowError):
            twin.States(1, [wrong])
    with pytest.raises(ValueError, match="a state has a word"):
        twin.States(0)
    table = twin.EffectTable(1, 1, lambda key: (1, ((0, key),)))
    for states in ([1], twin.States(2, [1])):
        with pytest.raises(TypeError, match="states of 1 words"):
            table.apply(states)  # type: ignore[arg-type]
    wrong_answer: Any = lambda key: (1, [key])  # noqa: E731
    with pytest.raises(TypeError):
        twin.EffectTable(1, 1, wrong_answer).apply(twin.States(1, [1]))


def test_a_table_in_a_circle_is_collected() -> None:
    class Holder:
        table: Any

        def fill(self, key: int) -> tuple[int, tuple[packed_states.Effect, ...]]:
            return key, ()

    holder = Holder()
    holder.table = twin.EffectTable(1, 1, holder.fill)
    gone = weakref.ref(holder)
    del holder
    gc.collect()
    assert gone() is None
