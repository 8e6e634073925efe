"""Decide properties: those of states and turns level by level, those of liveness at the end.

A property of states or turns is decided by the first state that it finds, which has a shortest way.
If any time may pass, that way may need clocks that run at different speeds; then the property is
doubtful until the end, when a possible way is searched for. Of a `leads_to`, only the states from
which a response is due are collected.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import chain, pairwise
from math import inf

from llfsm.runtime.verification._breadth_first import Level, Search, Successor
from llfsm.runtime.verification._predicates import Checker
from llfsm.runtime.verification._responses import (
    Lasso,
    Node,
    TooManyZonesError,
    late_response,
    no_response,
    possible_way,
    times_of,
)
from llfsm.runtime.verification._ringlets import ENDINGS
from llfsm.runtime.verification._system import System
from llfsm.runtime.verification._tables import FieldName, Tables
from llfsm.runtime.verification.properties import (
    NO_FAILURE,
    ChosenTurn,
    Property,
    Verdict,
    Witness,
    some_failed,
)
from llfsm.runtime.verification.space import Progress


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
    ):
        self.named: set[FieldName] = set()
        """The fields that properties ask for."""
        self.complete = True
        """True unless the exploration was ended early."""
        self.cut = False
        """True if Ctrl-C or the deadline has ended it, or the work after it."""
        self._system = system
        self._properties = properties
        self._max_states = max_states
        self._max_seconds = max_seconds
        self._progress = progress
        self._begin = time.monotonic()
        self._deadline_s = inf if max_seconds is None else self._begin + max_seconds
        system.ringlets.deadline.at_s = self._deadline_s
        self._checkers = {prop: _checkers_of(prop) for prop in properties}
        self._set_aside = Checker(NO_FAILURE, some_failed, sought=True)
        self._sources: dict[Property, list[list[Node]]] = {}
        self._witnesses: dict[Property, Witness] = {}
        self._doubtful: set[Property] = set()  # the way that was found is not possible in time

    @property
    def seconds(self) -> float:
        """The seconds since the beginning."""
        return time.monotonic() - self._begin

    def restart(self, tables: Tables) -> None:
        """Forget all that was decided: the exploration begins again with other tables."""
        self._witnesses, self._doubtful = {}, set()
        self._sources = {prop: [] for prop in self._properties if prop.kind == "leads_to"}
        for checker in chain([self._set_aside], *self._checkers.values()):
            checker.restart(tables)

    def look(self, search: Search, level: Level) -> bool:
        """Check the states of a level; return True to go on."""
        for prop in self._properties:
            if prop.kind == "leads_to":
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
        return self._max_seconds is None or self.seconds < self._max_seconds

    def end(self) -> None:
        """Note that not all was explored, or not all ringlets were run again."""
        self.complete, self.cut = False, True

    def verdicts(self, search: Search) -> Iterator[Verdict]:
        """Yield the verdict of each property: undecided if this is interrupted."""
        for prop in self._properties:
            try:
                yield self._verdict(prop, search)
            except ENDINGS:
                self.cut = True
                yield Verdict(prop, None, None)

    def _verdict(self, prop: Property, search: Search) -> Verdict:
        """Decide a property; what no way shows is not known if all ends where code raises."""
        verdict = self._verdict_of_states(prop, search)
        if verdict.witness is None and prop is not NO_FAILURE and self._has_failed(search):
            return Verdict(prop, None, None)
        return verdict

    def _has_failed(self, search: Search) -> bool:
        mask = search.tables.failed.mask
        return bool(mask) and any(
            s & mask for level in search.levels for states in level.values() for s in states
        )

    def _verdict_of_states(self, prop: Property, search: Search) -> Verdict:
        if prop.kind == "leads_to":
            return self._decide_response(prop, search)
        known = self.complete
        if prop in self._doubtful and known:
            known = not self.cut and self._settle(prop, search)
        witness = self._witnesses.get(prop)
        holds = (witness is not None) == (prop.kind == "reachable")
        return Verdict(prop, None if witness is None and not known else holds, witness)

    def _note_way(self, prop: Property, search: Search, steps: list[Successor]) -> None:
        """Keep the way to a violation, or note that it is not possible in time."""
        if self._system.time_model.period_ns is None and times_of(search, steps) is None:
            self._doubtful.add(prop)
        else:
            self._witnesses[prop] = self._witness(search, steps)

    def _settle(self, prop: Property, search: Search) -> bool:
        """Look for a possible way to a violation; return False if that was given up."""
        try:
            way = possible_way(search, lambda step: self._decides(prop, search, step))
        except TooManyZonesError:
            return False
        if way is not None:
            self._witnesses[prop] = self._witness(search, way)
        return True

    def _decides(self, prop: Property, search: Search, step: Successor) -> bool:
        if prop is NO_FAILURE:
            failed = step.state & search.tables.failed.mask
            return bool(failed or self._set_aside.select([step.state], self.named))
        checker = self._checkers[prop][0]
        if prop.kind == "step":
            return bool(checker.select_pairs([(step.ready, step.state)], self.named))
        return bool(checker.select([step.state], self.named))

    def _find(self, prop: Property, search: Search, level: Level) -> list[Successor] | None:
        """Find the steps to a state or turn of the level that decides a property."""
        if prop.kind == "step":
            return self._find_step(prop, search, level)
        failed = search.tables.failed.mask
        for turn, states in level.items():
            if prop is NO_FAILURE:
                found = [s for s in states if s & failed]
                found = found or self._set_aside.select(states, self.named)
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
        """Keep the states of a level in which a response is due."""
        trigger, response, *assumed = self._checkers[prop]
        sources: list[Node] = []
        for turn, states in level.items():
            for checker in assumed:
                checker.select(states, self.named)  # to learn what it asks for
            answered = set(response.select(states, self.named))
            due = trigger.select(states, self.named)
            sources += [(turn, s) for s in due if s not in answered]
        self._sources[prop].append(sources)

    def _decide_response(self, prop: Property, search: Search) -> Verdict:
        if not self.complete or self.cut:
            return Verdict(prop, None, None)
        sources = self._sources[prop]
        if not any(sources):
            return Verdict(prop, True, None, vacuous=True)
        _, response, *assumed = (self._holds(checker) for checker in self._checkers[prop])
        if prop.within_ms is None:
            lasso = no_response(search, sources, response, assumed)
        else:
            period_ns = self._system.time_model.period_ns
            assert period_ns is not None  # else it was refused
            rounds = round(prop.within_ms * 1e6) // period_ns
            lasso = late_response(search, sources, response, rounds)
        if lasso is None:
            return Verdict(prop, True, None)
        return Verdict(prop, False, self._lasso_witness(search, lasso))

    def _holds(self, checker: Checker) -> Callable[[Node], bool]:
        return lambda node: bool(checker.select([node[1]], self.named))

    def _lasso_witness(self, search: Search, lasso: Lasso) -> Witness:
        steps = search.path(*lasso.stem[0])
        for before, after in pairwise([*lasso.stem, *lasso.cycle]):
            steps.append(search.step_between(before, after))
        witness = self._witness(search, steps)
        if lasso.ends:
            return witness._replace(at_end=search.tables.asked_to_end(lasso.stem[-1][1]))
        return witness._replace(loop=len(steps) - len(lasso.cycle) if lasso.cycle else None)

    def _witness(self, search: Search, steps: list[Successor]) -> Witness:
        self._system.ringlets.deadline.at_s = inf  # one that is found is reported
        number = 0
        turns: list[ChosenTurn] = []
        begins = True
        period_ns = self._system.time_model.period_ns
        whole = [*steps, *search.rest_of_round(steps)]
        times = times_of(search, whole) if period_ns is None else None
        for step in whole:
            number += begins
            begins = step.turn == 0
            time_ns = (period_ns or 0) * number if times is None else times[number - 1]
            turns.append(_turn_of(search.tables, step, number, time_ns))
        self._system.ringlets.deadline.at_s = self._deadline_s
        return Witness(tuple(turns[: len(steps)]), tuple(turns[len(steps) :]))


def _checkers_of(prop: Property) -> list[Checker]:
    sought = prop.kind != "always" and prop.kind != "step"
    return [Checker(prop, each, sought=sought) for each in (*prop.functions, *prop.assuming)]


def _turn_of(tables: Tables, step: Successor, number: int, time_ns: int) -> ChosenTurn:
    system = tables.system
    messages = system.ringlets.messages
    found = {
        slot: messages[slot].values[code] if code else None
        for slot, code in (*step.round_contents, *step.choice.contents)
    }
    return ChosenTurn(
        number,
        time_ns / 1e6,
        system.names[step.place],
        found,
        step.choice.request,
        step.choice.stop,
        tables.control(step.place, step.ready).withdrawn_by(step.choice.request),
    )
