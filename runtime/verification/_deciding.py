"""Decide properties: those of states and turns level by level, those of liveness at the end.

A property of states or turns is decided by the first state that it finds, which has a shortest way.
If any time may pass, that way may need clocks that run at different speeds; then the property is
doubtful until the end, when possible ways are searched for (`zones`), for all of them at once. Of a
`leads_to`, only the states from which a response is due are collected.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from math import inf

from llfsm.runtime.verification._breadth_first import Level, Search, Successor
from llfsm.runtime.verification._memory import is_memory_short
from llfsm.runtime.verification._predicates import Checker
from llfsm.runtime.verification._responses import (
    Holds,
    Lasso,
    Node,
    Responses,
    late_response,
    no_response,
    no_way_out,
)
from llfsm.runtime.verification._ringlets import ENDINGS
from llfsm.runtime.verification._system import System
from llfsm.runtime.verification._tables import FieldName, Tables
from llfsm.runtime.verification._zones import (
    Pause,
    TooManyZonesError,
    Way,
    one_clock,
    possible_ways,
    times_of,
)
from llfsm.runtime.verification.properties import (
    LIVENESS,
    NO_FAILURE,
    ChosenTurn,
    Property,
    Region,
    Verdict,
    Witness,
)
from llfsm.runtime.verification.space import Progress

_NOTHING = Responses(lambda _: True, (lambda _: False,))
"""What is always due and never comes: every cycle and every end is without it."""

LOOK_S = 0.2
"""The time after which to look again whether memory is left."""


class Decisions:
    """The verdicts of one exploration."""

    def __init__(
        self,
        system: System,
        properties: list[Property],
        *,
        max_states: int | None,
        max_seconds: float | None,
        progress: Callable[[Progress], object] | None,
        begin_s: float,
    ):
        self.named: set[FieldName] = set()
        """The fields that properties ask for."""
        self.complete = True
        """True unless the exploration was ended early."""
        self.cut = False
        """True if Ctrl-C, the deadline or a lack of memory has ended it, or the work after it."""
        self._system = system
        self._properties = properties
        self._max_states = max_states
        self._max_seconds = max_seconds
        self._progress = progress
        self.short_of_memory = False
        """True if it was ended before memory was used up."""
        self._look_s = LOOK_S
        self._begin = begin_s
        self._deadline_s = inf if max_seconds is None else self._begin + max_seconds
        system.ringlets.deadline.at_s = self._deadline_s
        self._checkers = {prop: _checkers_of(prop) for prop in properties}
        self._sources: dict[Property, list[list[Node]]] = {}
        self._witnesses: dict[Property, Witness] = {}
        self._doubtful: set[Property] = set()  # the way that was found is not possible in time
        self._ways: dict[Property, Way] = {}  # those that are possible instead
        self._settled: bool | None = None  # True once all of them were found, False if given up
        self._any_time = system.time_model.unit_ns is None

    @property
    def seconds(self) -> float:
        """The seconds since the beginning."""
        return time.monotonic() - self._begin

    def restart(self, tables: Tables) -> None:
        """Forget all that was decided: the exploration begins again with other tables."""
        self._witnesses, self._doubtful = {}, set()
        self._sources = {prop: [] for prop in self._properties if prop.kind in LIVENESS}
        for checkers in self._checkers.values():
            for checker in checkers:
                checker.restart(tables)

    def look(self, search: Search, level: Level) -> bool:
        """Check the states of a level; return True to go on."""
        for prop in self._properties:
            if prop.kind in LIVENESS:
                self._note_sources(prop, level)
            elif prop not in self._witnesses and prop not in self._doubtful:
                steps = self._find(prop, search, level)
                if steps is not None:
                    self._note_way(prop, search, steps)
        decided = bool(self._properties) and len(self._witnesses) == len(self._properties)
        too_many = self._max_states is not None and search.states >= self._max_states
        self.complete = self.goes_on(search) and not (decided or too_many)
        return self.complete

    def goes_on(self, search: Search) -> bool:
        """Report the progress; return True if there is time left and nobody has ended it."""
        if self._progress is not None:
            depth = len(search.levels) - 1
            now = Progress(search.states, search.transitions, depth, self.seconds)
            if self._progress(now) is False:
                return False
        if self.seconds >= self._look_s:
            self._look_s = self.seconds + LOOK_S
            if is_memory_short():
                self.cut = self.short_of_memory = True
                return False
        return self._max_seconds is None or self.seconds < self._max_seconds

    def end(self) -> None:
        """Note that not all was explored, or not all ringlets were run again."""
        self.complete, self.cut = False, True

    def verdicts(self, search: Search) -> Iterator[Verdict]:
        """Yield the verdict of each property: undecided if this is interrupted."""
        for prop in self._properties:
            try:
                yield self._verdict(prop, search)
            except ENDINGS as error:
                self.cut = True
                self.short_of_memory |= isinstance(error, MemoryError)
                yield Verdict(prop, None, None)

    def _verdict(self, prop: Property, search: Search) -> Verdict:
        """Decide a property; what no way shows is not known if all ends where code raises."""
        verdict = self._decided(prop, search)
        if verdict.witness is None and prop is not NO_FAILURE and self._has_failed(search):
            return Verdict(prop, None, None)
        return verdict

    def _has_failed(self, search: Search) -> bool:
        ended = search.tables.ended
        return any(len(ended(states)) for level in search.levels for states in level.values())

    def _decided(self, prop: Property, search: Search) -> Verdict:
        if prop.kind in LIVENESS:
            if not self.complete or self.cut:
                return Verdict(prop, None, None)
            match prop.kind:
                case "leads_to":
                    return self._decide_response(prop, search)
                case "eventually_always":
                    return self._decide_forever(prop, search)
            return self._decide_possible(prop, search)
        known = self.complete
        if prop in self._doubtful and known:
            known = not self.cut and self._settle(prop, search)
        witness = self._witnesses.get(prop)
        holds = (witness is not None) == (prop.kind == "reachable")
        return Verdict(prop, None if witness is None and not known else holds, witness)

    def _note_way(self, prop: Property, search: Search, steps: list[Successor]) -> None:
        """Keep the way to a violation, or note that it is not possible in time."""
        if self._any_time and times_of(search, steps) is None:
            self._doubtful.add(prop)
        else:
            self._witnesses[prop] = self._witness(search, steps)

    def _settle(self, prop: Property, search: Search) -> bool:
        """Look for a possible way to a violation; return False if that was given up.

        It is looked for together with those of all other properties that are not settled.
        """
        if self._settled is None:
            sought = {each: partial(self._decides, each, search) for each in self._doubtful}
            due = {
                each: self._responses(each)
                for each in self._properties
                if each.kind == "leads_to" and any(self._sources[each])
            }
            try:
                possible_ways(search, sought, due, self._ways)
                self._settled = True
            except TooManyZonesError:
                self._settled = False
            for each, way in self._ways.items():
                self._witnesses[each] = self._way_witness(search, way)
        return self._settled or prop in self._ways

    def _decides(self, prop: Property, search: Search, step: Successor) -> bool:
        if prop is NO_FAILURE:
            return bool(search.tables.failing(search.tables.packing.states([step.state])))
        checker = self._checkers[prop][0]
        if prop.kind == "step":
            return bool(checker.select_pairs([(step.ready, step.state)], self.named))
        return bool(checker.select([step.state], self.named))

    def _find(self, prop: Property, search: Search, level: Level) -> list[Successor] | None:
        """Find the steps to a state or turn of the level that decides a property."""
        if prop.kind == "step":
            return self._find_step(prop, search, level)
        for turn, states in level.items():
            if prop is NO_FAILURE:
                found = search.tables.failing(states)
            else:
                found = self._checkers[prop][0].select(states, self.named)
            if found:
                return search.path(turn, found[0])
        return None

    def _find_step(self, prop: Property, search: Search, level: Level) -> list[Successor] | None:
        checker = self._checkers[prop][0]
        for turn, states in level.items():
            found = checker.select_pairs(search.pairs(turn, states), self.named)
            for state in states if found else ():
                for each in search.steps(turn, state):
                    if checker.select_pairs([(each.ready, each.state)], self.named):
                        return [*search.path(turn, state), each]
        return None

    def _note_sources(self, prop: Property, level: Level) -> None:
        """Keep the states of a level in which a response is due; learn what functions ask for."""
        for checker in self._checkers[prop]:
            for states in level.values():
                checker.select(states, self.named)
        if prop.kind == "leads_to":
            trigger, responses = self._checkers[prop][0], self._responses(prop)
            self._sources[prop].append([
                (turn, state, stage)
                for turn, states in level.items()
                for state in trigger.select(states, self.named)
                if (stage := responses.advance(0, state)) < responses.done
            ])  # fmt: skip

    def _responses(self, prop: Property) -> Responses:
        trigger, *each = map(self._holds, self._checkers[prop][: len(prop.functions)])
        return Responses(trigger, tuple(each))

    def _assumed(self, prop: Property) -> list[Holds]:
        return [*map(self._holds, self._checkers[prop][len(prop.functions) :])]

    def _decide_response(self, prop: Property, search: Search) -> Verdict:
        sources, responses = self._sources[prop], self._responses(prop)
        if not any(sources):
            return Verdict(prop, True, None, vacuous=True)
        if prop.within_ms is None:
            lasso = no_response(search, sources, responses, self._assumed(prop))
        elif self._any_time:
            known = self._settle(prop, search)
            witness = self._witnesses.get(prop)
            return Verdict(prop, (witness is None) if known else None, witness)
        else:
            unit_ns = self._system.time_model.unit_ns
            assert unit_ns is not None  # else any time may pass
            self._system.require_all_stay(prop)
            units = round(prop.within_ms * 1e6) // unit_ns
            lasso = late_response(search, sources, responses, units)
        return self._lasso_verdict(prop, search, lasso)

    def _decide_forever(self, prop: Property, search: Search) -> Verdict:
        """Look for a cycle, or an end, in which what is to hold for ever does not."""
        (holds,) = map(self._holds, self._checkers[prop][:1])
        recurring = [lambda state: not holds(state), *self._assumed(prop)]
        lasso = no_response(search, [[(0, search.tables.initial(), 0)]], _NOTHING, recurring)
        return self._lasso_verdict(prop, search, lasso)

    def _lasso_verdict(self, prop: Property, search: Search, lasso: Lasso | None) -> Verdict:
        if lasso is None:
            return Verdict(prop, True, None)
        return Verdict(prop, False, self._lasso_witness(search, lasso))

    def _decide_possible(self, prop: Property, search: Search) -> Verdict:
        """Look for a region with no way out; at any time, several clocks may leave it undecided."""
        checker = self._checkers[prop][0]
        region = no_way_out(search, lambda states: checker.part(states, self.named)[1])
        if region is None:
            exact = not self._any_time or one_clock(search)
            return Verdict(prop, True if exact else None, None)
        path = search.path(region.turn, region.state)
        if self._any_time and times_of(search, path) is None:
            return Verdict(prop, None, None)
        first = region.turn, region.state, 0
        lasso = no_response(search, [[first]], _NOTHING, ())
        assert lasso is not None  # as what follows a state is a cycle in the end, or ends
        if self._any_time and times_of(search, self._steps(search, lasso)) is None:
            lasso = Lasso([first], [])
        witness = self._lasso_witness(search, lasso)
        within = Region(len(path), region.states)
        return Verdict(prop, False, witness._replace(region=within))

    def _holds(self, checker: Checker) -> Holds:
        return lambda state: bool(checker.select([state], self.named))

    def _steps(self, search: Search, lasso: Lasso) -> list[Successor]:
        steps = search.path(*lasso.stem[0][:2])
        for before, after in pairwise([*lasso.stem, *lasso.cycle]):
            steps.append(search.step_between(before[:2], after[:2]))
        return steps

    def _lasso_witness(self, search: Search, lasso: Lasso) -> Witness:
        steps = self._steps(search, lasso)
        witness = self._witness(search, steps)
        if lasso.ends:
            return witness._replace(at_end=search.tables.asked_to_end(lasso.stem[-1][1]))
        return witness._replace(loop=len(steps) - len(lasso.cycle) if lasso.cycle else None)

    def _way_witness(self, search: Search, way: Way) -> Witness:
        witness = self._witness(search, way.steps, way.pause)
        if not way.ends:
            return witness
        end = way.steps[-1].state if way.steps else search.tables.initial()
        return witness._replace(at_end=search.tables.asked_to_end(end))

    def _witness(
        self, search: Search, steps: list[Successor], pause: Pause | None = None
    ) -> Witness:
        self._system.ringlets.deadline.at_s = inf  # one that is found is reported
        number = passed = 0
        turns: list[ChosenTurn] = []
        begins = True
        system = self._system
        whole = [*steps, *search.rest_of_round(steps)]
        times = times_of(search, whole, pause) if self._any_time else None
        for step in whole:
            number += begins
            begins = step.turn == 0
            passed += step.rounds
            due_ns = system.time_model.begin_ns(passed) + system.order[step.at].start_ns
            time_ns = due_ns if times is None else times[number - 1]
            turns.append(_turn_of(search.tables, step, number, time_ns))
        self._system.ringlets.deadline.at_s = self._deadline_s
        return Witness(tuple(turns[: len(steps)]), tuple(turns[len(steps) :]))


def _checkers_of(prop: Property) -> list[Checker]:
    """Make a checker of each function, and then of each that is assumed."""
    sought = prop.kind != "always" and prop.kind != "step"
    return [Checker(prop, each, sought=sought) for each in (*prop.functions, *prop.assuming)]


def _turn_of(tables: Tables, step: Successor, number: int, time_ns: int) -> ChosenTurn:
    system = tables.system
    messages = system.ringlets.messages
    found = {
        slot: messages[slot].values[code] if code else None
        for slot, code in (*step.round_contents, *step.choice.contents)
    }
    answers = system.answered(step.place, found)
    found = {slot: message for slot, message in found.items() if slot not in system.answers}
    return ChosenTurn(
        number,
        time_ns / 1e6,
        system.names[step.place],
        found,
        step.choice.request,
        step.choice.stop,
        tables.control(step.place, step.ready).withdrawn_by(step.choice.request),
        answers,
    )
