"""Breadth first: all states of a system, level by level, each with the same number of turns.

A state is a whole number, and whose turn is next is kept beside it: each level is a list of states
for each machine, and what was seen is a set for each. A level is expanded machine by machine, not
state by state: the few steps of a round (drop what is settled, let time pass, choose for the round,
find who is loaded, have the turn) each go over a list of states, with one look into a table for
each. So the first way found to a state is a shortest one.

Of ways nothing is kept: a state's predecessor is searched for in the level before it, by halves.
That costs less than to keep one with every state, as few ways are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

from llfsm.runtime.verification._ringlets import ENDINGS
from llfsm.runtime.verification._system import Choice, RelearnError, System
from llfsm.runtime.verification._tables import FieldName, Tables

Level: TypeAlias = dict[int, list[int]]
"""States by the place of the machine whose turn is next; 0 is also the beginning of a round."""
STATES_AT_ONCE = 50_000
"""States of a level that are expanded without asking whether to go on."""


class Successor(NamedTuple):
    """One turn: its machine, the choice of its environment, and the state after it."""

    place: int
    round_contents: tuple[tuple[str, int], ...]
    """The choice for the round that it begins, if choices are made by rounds."""
    choice: Choice
    ready: int
    """The state before the ringlet: where a round begins, its period has passed."""
    restarted: bool
    """True if the machine entered its state in this turn, or will in its next."""
    turn: int
    state: int


class Search:
    """The states found so far, by `tables`."""

    def __init__(self, tables: Tables):
        self.tables = tables
        self.transitions = 0
        self.interrupted = False
        """True if it has ended within a level, such as by Ctrl-C."""
        self.levels: list[Level] = []
        self._last = len(tables.system.names) - 1
        self._seen: list[set[int]] = [set() for _ in tables.system.names]

    @property
    def states(self) -> int:
        """The number of states."""
        return sum(map(len, self._seen))

    def begin(self) -> Level:
        """Add and return the first level: the initial state."""
        return self._add({0: {self.tables.initial()}})

    def go_on(self, goes_on: Callable[[Search], bool]) -> Level:
        """Add and return the next level: the new states one turn after the last; {} at the end.

        Of a large level, `goes_on` is asked again and again whether to finish it.
        """
        transitions = 0
        after: dict[int, set[int]] = {}
        for turn, states in self.levels[-1].items():
            for start in range(0, len(states), STATES_AT_ONCE):
                if start and not goes_on(self):
                    self.interrupted = True
                    return {}
                more, found = self._expand(turn, states[start : start + STATES_AT_ONCE])
                transitions += more
                for next_turn, each in found.items():
                    after.setdefault(next_turn, each).update(each)
        self.transitions += transitions
        return self._add(after)

    def _expand(self, turn: int, states: list[int]) -> tuple[int, dict[int, set[int]]]:
        """Count the transitions of states, and find the states after them by whose turn it is."""
        transitions = 0
        after: dict[int, set[int]] = {}
        for place, group in self._ready(turn, states):
            table, mask = self.tables.turns[place], self.tables.masks[place]
            found = {s & keep | put for s in group for keep, put in table[s & mask]}
            transitions += self.tables.number_of_choices(place, group)
            for next_turn, each in self._to_turns(place, found):
                after[next_turn] = after[next_turn] | each if next_turn in after else each
        return transitions, after

    def _add(self, found: dict[int, set[int]]) -> Level:
        level: Level = {}
        for turn, states in found.items():
            seen = self._seen[turn]
            states -= seen
            if states:
                seen |= states
                level[turn] = list(states)
        if level:
            self.levels.append(level)
        return level

    def pairs(self, turn: int, states: list[int]) -> list[tuple[int, int]]:
        """List the states before and after each ringlet in one turn from `states`."""
        pairs = []
        for place, group in self._ready(turn, states):
            table, mask = self.tables.turns[place], self.tables.masks[place]
            pairs += [(s, s & keep | put) for s in group for keep, put in table[s & mask]]
        return pairs

    def _ready(self, turn: int, states: list[int]) -> Iterator[tuple[int, list[int]]]:
        """Yield each machine whose ringlet begins in some states, with these states."""
        if failed := self.tables.failed.mask:
            states = [s for s in states if not s & failed]
        if turn == 0:
            states = self._begin_round(states)
        yield from self._by_machine(turn, states)

    def _begin_round(self, states: list[int]) -> list[int]:
        tables = self.tables
        over = states
        for mask, settled in tables.settled:
            over = [s for s in over if settled[s & mask]]
        if over:
            gone = set(over)
            states = [s for s in states if s not in gone]
        for mask, ticks in tables.ticks:
            states = [s + passed for s in states for passed in ticks[s & mask]]
        if tables.rounds:
            states = [s & keep | put for s in states for keep, put in tables.rounds]
        return states

    def _by_machine(self, turn: int, states: list[int]) -> Iterator[tuple[int, list[int]]]:
        """Give states to the first machine from `turn` on that is loaded; others are dropped."""
        for place in range(turn, self._last + 1):
            if place not in self.tables.leavers:
                if states:
                    yield place, states
                return
            mask, loaded = self.tables.loaded[place]
            here = [s for s in states if loaded[s & mask]]
            if here:
                yield place, here
                states = [s for s in states if not loaded[s & mask]]

    def _to_turns(self, place: int, states: set[int]) -> Iterator[tuple[int, set[int]]]:
        """Sort states after a machine's turn by whose turn is next."""
        if self.tables.leavers:
            for turn, group in self._by_machine(place + 1, list(states)):
                each = set(group)
                states = states - each
                yield turn, each
        elif place < self._last:
            yield place + 1, states
            return
        if states:
            if self.tables.forgotten:
                kept = self.tables.packing.all & ~self.tables.forgotten
                states = {s & kept for s in states}
            yield 0, states

    # One state at a time

    def after(self, turn: int, state: int) -> list[tuple[int, int]]:
        """List the states one turn after a state, each after whose turn is next.

        Raise `TimeUpError` after the deadline.
        """
        self.tables.system.ringlets.deadline.check()
        _, found = self._expand(turn, [state])
        return [(next_turn, s) for next_turn, each in found.items() for s in each]

    def step_between(self, before: tuple[int, int], after: tuple[int, int]) -> Successor:
        """Find a turn that leads from one state to another; there must be one."""
        return next(step for step in self.steps(*before) if (step.turn, step.state) == after)

    def steps(self, turn: int, state: int) -> Iterator[Successor]:
        """List all possible turns from a state."""
        tables = self.tables
        contents = list(tables.system.contents(sorted(tables.system.domains)))
        for place, group in self._ready(turn, [state]):
            for number, ready in enumerate(group):
                begins = turn == 0 and tables.rounds
                chosen = contents[number % len(contents)] if begins else ()
                for choice, outcome, (keep, put) in tables.choices(place, ready):
                    for next_turn, (after,) in self._to_turns(place, {ready & keep | put}):
                        restarted = outcome.restarted
                        yield Successor(place, chosen, choice, ready, restarted, next_turn, after)

    def path(self, turn: int, state: int) -> list[Successor]:
        """Find a shortest way from the initial state to one that was found."""
        number = next(n for n, level in enumerate(self.levels) if state in level.get(turn, ()))
        path: list[Successor] = []
        for level in reversed(self.levels[:number]):
            turn, state, step = self._step_before(level, turn, state)
            path.append(step)
        return path[::-1]

    def rest_of_round(self, steps: list[Successor]) -> Iterator[Successor]:
        """Find turns that complete the round of the last step, or else are a first round."""
        turn, state = (steps[-1].turn, steps[-1].state) if steps else (0, self.tables.initial())
        over = bool(steps) and turn == 0
        while not over:
            step = next(self.steps(turn, state), None)
            if step is None:
                return
            yield step
            turn, state, over = step.turn, step.state, step.turn == 0

    def _step_before(self, level: Level, turn: int, state: int) -> tuple[int, int, Successor]:
        """Find a state of a level that leads to another one, and the turn, by halving the level."""
        for before, states in level.items():
            if state not in self._expand(before, states)[1].get(turn, ()):
                continue
            while len(states) > 1:
                half = states[: len(states) // 2]
                found = state in self._expand(before, half)[1].get(turn, ())
                states = half if found else states[len(half) :]
            return before, states[0], self.step_between((before, states[0]), (turn, state))
        raise AssertionError("a state was found that no turn leads to")


def search_states(
    system: System,
    named: set[FieldName],
    look: Callable[[Search, Level], bool],
    goes_on: Callable[[Search], bool],
    restart: Callable[[Tables], None],
) -> Search:
    """Find the states of a system; begin again whenever something new was learnt.

    `look` is called with each level, and ends the search by returning False, as `goes_on` does
    within a level; `restart` with the tables of each attempt, before. `look` and `restart` may
    raise `RelearnError` after adding to `named`. Ctrl-C and the deadline end the search, too.
    """
    sizes: dict[FieldName, int] = {}
    while True:
        try:
            tables = Tables(system, named, sizes)
            search = Search(tables)
            try:
                restart(tables)
                level = search.begin()
                while level and look(search, level):
                    level = search.go_on(goes_on)
            except ENDINGS:
                search.interrupted = True
            return search
        except RelearnError:
            continue
