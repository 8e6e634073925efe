"""Breadth first: all states of a system, level by level, each with the same number of turns.

A state is a whole number, and whose turn is next is kept beside it: each level is a list of states
for each machine, and what was seen is a set for each. A level is expanded machine by machine, not
state by state: the few steps of a round (drop what is settled, let time pass, choose for the round,
find who is loaded, have the turn) each go over a list of states, with one look into a table for
each (`_packed_states`). So the first way found to a state is a shortest one. The states of a level
are in the order in which they are found, whatever their bits.

Of ways nothing is kept: a state's predecessor is searched for in the level before it, by halves.
That costs less than to keep one with every state, as few ways are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

from llfsm.runtime.verification._ringlets import ENDINGS
from llfsm.runtime.verification._system import Choice, RelearnError, System
from llfsm.runtime.verification._tables import FieldName, Tables
from llfsm.runtime.verification._twin import Seen, States

Level: TypeAlias = dict[int, States]
"""States by which turn of a round is next (`System.order`); 0 is the beginning of a round."""
STATES_AT_ONCE = 4_096
"""States of a level that are expanded without asking whether to go on.

They are so few that what comes of them stays in the processor's cache.
"""


class Successor(NamedTuple):
    """One turn: its machine, the choice of its environment, and the state after it."""

    place: int
    rounds: int
    """How many rounds after the one before its round begins; 0 if it does not begin it."""
    round_contents: tuple[tuple[str, int], ...]
    """The choice for the round that it begins, if choices are made by rounds."""
    choice: Choice
    ready: int
    """The state before the ringlet: where a round begins, its period has passed."""
    restarted: bool
    """True if the machine entered its state in this turn, or will in its next."""
    turn: int
    state: int
    at: int
    """Which turn of its round it was."""


class Search:
    """The states found so far, by `tables`."""

    def __init__(self, tables: Tables):
        self.tables = tables
        self.transitions = 0
        self.interrupted = False
        """True if it has ended within a level, such as by Ctrl-C."""
        self.out_of_memory = False
        """True if that was because memory was used up."""
        self.levels: list[Level] = []
        self.states = 0
        """The number of states."""
        self._sizes: list[tuple[int, tuple[int, ...]]] = []
        """The states and, by `System.sizes`, the values, whenever there were twice as many."""
        self._places = [turn.place for turn in tables.system.order]
        self._seen = [Seen(tables.packing.words) for _ in self._places]

    def begin(self) -> Level:
        """Add and return the first level: the initial state."""
        level: Level = {}
        self._note_new(level, 0, self.tables.packing.states([self.tables.initial()]))
        return self._add(level)

    def go_on(self, goes_on: Callable[[Search], bool]) -> Level:
        """Add and return the next level: the new states one turn after the last; {} at the end.

        Of a large level, `goes_on` is asked again and again whether to finish it.
        """
        transitions = 0
        level: Level = {}
        for turn, states in self.levels[-1].items():
            for start in range(0, len(states), STATES_AT_ONCE):
                if start and not goes_on(self):
                    self.interrupted = True
                    return {}
                more, found = self._expand(turn, states[start : start + STATES_AT_ONCE])
                transitions += more
                for next_turn, each in found:
                    self._note_new(level, next_turn, each)
        self.transitions += transitions
        return self._add({turn: each for turn, each in level.items() if len(each)})

    def _expand(self, turn: int, states: States) -> tuple[int, list[tuple[int, States]]]:
        """Count the transitions of states, and list the states after them by whose turn it is."""
        transitions = 0
        after: list[tuple[int, States]] = []
        for at, group, _ in self._ready(turn, states):
            found, more = self.tables.turns[self._places[at]].apply(group)
            transitions += more
            after += self._to_turns(at, found)
        return transitions, after

    def _note_new(self, level: Level, turn: int, states: States) -> None:
        """Add those of some states to a level that are new."""
        if turn not in level:
            level[turn] = self.tables.packing.states()
        self._seen[turn].add(states, level[turn])

    def _add(self, level: Level) -> Level:
        if level:
            self.levels.append(level)
            self.states += sum(map(len, level.values()))
            if not self._sizes or self.states >= 2 * self._sizes[-1][0]:
                self._sizes.append((self.states, self.tables.system.sizes()))
        return level

    def half(self) -> tuple[int, tuple[int, ...]]:
        """Return a number of states, half of all or less, and `System.sizes` of that moment."""
        return next(then for then in self._sizes[::-1] if 2 * then[0] <= self.states + 1)

    def pairs(self, turn: int, states: States) -> list[tuple[int, int]]:
        """List the states before and after each ringlet in one turn from `states`."""
        pairs = []
        for at, group, _ in self._ready(turn, states):
            effects = self.tables.turns[self._places[at]].effects
            pairs += [(s, s & keep | put) for s in group for keep, put in effects(s)]
        return pairs

    def _ready(self, turn: int, states: States) -> Iterator[tuple[int, States, int]]:
        """Yield each turn whose ringlet begins in some states, with these states.

        With each, how many rounds after the one before the round begins; 0 in a round.
        """
        if self.tables.failed.most:
            states, _ = self.tables.intact.split(states)
        groups = self._begin_round(states) if turn == 0 else ((self._pass_to(turn, states), 0),)
        for group, rounds in groups:
            for at, each in self._by_turn(turn, group):
                yield at, each, rounds

    def _pass_to(self, turn: int, states: States) -> States:
        """Let the time pass until a turn of the round is due."""
        for tick in self.tables.passing[turn]:
            states, _ = tick.apply(states)
        return states

    def _begin_round(self, states: States) -> Iterator[tuple[States, int]]:
        """Drop states in which no machine can keep the execution alive; start rounds in others."""
        tables = self.tables
        for settled in tables.settled:
            states, begun = settled.split(states)
            for rounds, ticks in tables.ticks if len(begun) else ():
                passed = begun
                for tick in ticks:
                    passed, _ = tick.apply(passed)
                chosen = passed if tables.rounds is None else tables.rounds.apply(passed)[0]
                yield chosen, rounds
            if not len(states):
                return

    def _by_turn(self, turn: int, states: States) -> Iterator[tuple[int, States]]:
        """Give states to the first turn from `turn` on whose machine is loaded; drop others."""
        for at in range(turn, len(self._places)):
            if at > turn:
                states = self._pass_to(at, states)
            here, states = self._loaded(at, states)
            if len(here):
                yield at, here
            if not len(states):
                return

    def _loaded(self, turn: int, states: States) -> tuple[States, States]:
        """Split states into those in which the machine of a turn is loaded, and others."""
        place = self._places[turn]
        if place not in self.tables.leavers:
            return states, states[:0]
        return self.tables.loaded[place].split(states)

    def _to_turns(self, at: int, states: States) -> Iterator[tuple[int, States]]:
        """Sort states after a turn by which is next; those of machines that have left pass."""
        for after in range(at + 1, len(self._places)):
            here, states = self._loaded(after, states)
            if len(here):
                yield after, here
            if not len(states):
                return
            states = self._pass_to(after, states)
        if len(states):
            forgotten = self.tables.forgotten
            yield 0, states if forgotten is None else forgotten.apply(states)[0]

    # One state at a time

    def after(self, turn: int, state: int) -> list[tuple[int, int]]:
        """List the states one turn after a state, each after whose turn is next.

        Raise `TimeUpError` after the deadline.
        """
        self.tables.system.ringlets.deadline.check()
        _, found = self._expand(turn, self.tables.packing.states([state]))
        return list(dict.fromkeys((next_turn, s) for next_turn, each in found for s in each))

    def step_between(self, before: tuple[int, int], after: tuple[int, int]) -> Successor:
        """Find a turn that leads from one state to another; there must be one."""
        return next(step for step in self.steps(*before) if (step.turn, step.state) == after)

    def steps(self, turn: int, state: int) -> Iterator[Successor]:
        """List all possible turns from a state."""
        tables = self.tables
        system = tables.system
        contents = list(system.contents(sorted(system.domains), system.withheld))
        for at, group, rounds in self._ready(turn, self.tables.packing.states([state])):
            place = self._places[at]
            for number, ready in enumerate(group):
                begins = turn == 0 and tables.rounds is not None
                chosen = contents[number % len(contents)] if begins else ()
                for choice, outcome, (keep, put) in tables.choices(place, ready):
                    restarted, found = (
                        outcome.restarted,
                        self.tables.packing.states([ready & keep | put]),
                    )
                    for next_turn, (after,) in self._to_turns(at, found):
                        yield Successor(
                            *(place, rounds, chosen, choice, ready, restarted, next_turn, after),
                            at,
                        )

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
            if not self._leads(before, states, turn, state):
                continue
            while len(states) > 1:
                half = states[: len(states) // 2]
                leads = self._leads(before, half, turn, state)
                states = half if leads else states[len(half) :]
            return before, states[0], self.step_between((before, states[0]), (turn, state))
        raise AssertionError("a state was found that no turn leads to")

    def _leads(self, before: int, states: States, turn: int, state: int) -> bool:
        """Check that one turn leads from one of some states to another one."""
        return any(
            next_turn == turn and state in each
            for start in range(0, len(states), STATES_AT_ONCE)
            for next_turn, each in self._expand(before, states[start : start + STATES_AT_ONCE])[1]
        )


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
    raise `RelearnError` after adding to `named`. Ctrl-C, the deadline and a lack of memory end the
    search, too.
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
            except ENDINGS as error:
                search.interrupted = True
                search.out_of_memory = isinstance(error, MemoryError)
            return search
        except RelearnError:
            continue
