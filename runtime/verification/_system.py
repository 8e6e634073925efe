"""The machines to explore and their environment, with all ringlets that were run so far.

Each distinct ringlet is run once and kept; a state space of millions of states needs a few hundred.
A kept one answers for all times in a range, and for all control states of machines that it did not
touch.

What must be part of a state is not known beforehand but learnt by running: the limits with which
code compares the time in a state, the machines whose control states a ringlet touches, and the
machines that leave. Whenever something of the kind is new, `RelearnError` ends the exploration, and
it begins again with larger states. That happens a few times, and the ringlets stay.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Container, Hashable, Iterable, Iterator, Mapping
from itertools import islice, pairwise, product
from math import floor, prod
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.events import Request
from llfsm.runtime.verification._ringlets import Ringlets
from llfsm.runtime.verification._time_model import Limits, TimeModel, timetable_of
from llfsm.runtime.verification.domains import Member, messages_of, statuses_of
from llfsm.runtime.verification.environment import (
    ControlState,
    Given,
    RingletOutcome,
    UnansweredError,
    UnknownControlError,
    question_slot,
)
from llfsm.runtime.verification.errors import DomainError, UnsupportedError
from llfsm.runtime.verification.loaded import Found
from llfsm.runtime.verification.properties import defaults_of

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import OnError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.verification.properties import Property
    from llfsm.whiteboard import Slot


_MOST_CHOICES = 100_000
"""Choices of the environment at one turn; far fewer already make too many states."""
_SAMPLE, _PART = 1_000, 25
"""Ringlets that are run again: so many or, if that is more, one of so many."""
_NONE = Limits()
_REQUESTS = (None, Request.SUSPEND, Request.RESUME, Request.RESTART)


_Key: TypeAlias = tuple[int, int, int, tuple[tuple[str, int], ...], Request | None, bool]
"""The inputs of a kept ringlet, but for time and others, which it may not have asked for."""
_Numbers: TypeAlias = tuple[tuple[int, int], ...]
_Kept: TypeAlias = tuple[int, int, _Numbers, _Numbers, RingletOutcome]


class RelearnError(Exception):
    """Something was learnt that must be part of a state: the exploration must begin again."""


class Choice(NamedTuple):
    """A choice of the environment at a turn: contents of slots by number, a request, a stop."""

    contents: tuple[tuple[str, int], ...]
    request: Request | None
    stop: bool


class System:
    """The machines, the choices of their environment, and all ringlets run so far.

    The last `watchers` machines are monitors, which watch the others. For the other arguments see
    `explore`.
    """

    def __init__(
        self,
        members: Iterable[Member],
        *,
        watchers: int,
        time_model: TimeModel,
        sensors: Mapping[Slot[Any] | str, Iterable[Any]],
        stop: bool,
        suspend: Iterable[str],
        by_rounds: bool,
        unload_accepting: bool,
        on_error: OnError,
        abstract: Mapping[str, Callable[[Any], Any]],
        found: Found,
        learning: bool,
        elsewhere: Mapping[str, type[Machine] | Iterable[str | None]],
    ):
        self.found = found
        """The classes that states run though they do not name them, and what code loads."""
        self.time_model = time_model
        self.stop = stop
        self.by_rounds = by_rounds
        self.suspend = frozenset(suspend)
        self.ringlets = Ringlets(
            members,
            watchers=watchers,
            unload_accepting=unload_accepting,
            on_error=on_error,
            abstract=abstract,
            controlled=self.suspend,
            found=found,
            learning=learning,
            elsewhere=elsewhere,
        )
        self.ringlets.kernel.timetable = timetable_of(time_model)  # which loading asks
        self.learning = self.ringlets.learning
        self.names = list(self.ringlets.places)
        self.order = time_model.order([*self._groups()])
        """The turns of a round."""
        self.watchers = range(len(self.names) - watchers, len(self.names))
        """The places of the monitors, which are the last machines."""
        for name in sorted(self.suspend) if not self.learning else ():
            if name not in self.names:
                raise DomainError(
                    f"suspend names {name!r}, which is not a machine"
                    f"{did_you_mean(name, self.names)}; the machines are: {', '.join(self.names)}"
                )
        self.limits: list[dict[str, Limits]] = [{} for _ in self.names]
        """For each machine and state, the times that are asked about in it."""
        self.mentions: list[set[int]] = [set() for _ in self.names]
        """For each machine, those whose control state it asks for or changes."""
        self.looks: list[set[int]] = [set() for _ in self.names]
        """For each machine, the inner ones whose variables it looks at or changes."""
        self.leavers = set(self.ringlets.absent)
        """The machines that are there at times: those that were found to leave the arrangement."""
        self.standing: set[int] = set()
        """The places of machines that may be suspended in a state in which they go on in place."""
        self._questions: list[Counter[str]] = [Counter() for _ in self.names]
        """For each machine, how often it asks in a turn for machines of other processes."""
        self._statuses = {name: statuses_of(name, given) for name, given in elsewhere.items()}
        for name in self._statuses.keys() & {*self.names}:
            raise DomainError(f"elsewhere has {name!r}, which is one of the machines to explore")
        self.answers: dict[str, tuple[int, ...]] = {}
        """The numbers of the answers to each question, by what holds them."""
        self._kept: dict[_Key, tuple[_Kept, ...]] = {}
        self._known: set[tuple[int, int]] = set()
        """The control states that ringlets have led to, each after its place."""
        self._kinds: dict[Hashable, tuple[Given, RingletOutcome]] = {}
        """A kept ringlet of each kind: from where to where, by which request and transition."""
        self._connect(sensors)

    def _groups(self) -> Iterator[tuple[str, list[int]]]:
        """Yield the name of each outermost machine, with its place and those of inner ones."""
        outermost = [n for n in range(len(self.names)) if n not in {*self.ringlets.inner}]
        for begin, end in pairwise([*outermost, len(self.names)]):
            yield self.names[begin], list(range(begin, end))

    def _connect(self, sensors: Mapping[Slot[Any] | str, Iterable[Any]]) -> None:
        self.reads: list[dict[str, str]] = []
        """For each machine, the slot that each of its sensors reads."""
        self.slots: dict[str, Slot[Any]] = {}
        """All slots by their names."""
        self.posted: set[str] = set()
        """The slots that machines post to."""
        self.freshness: list[dict[str, int | None]] = []
        """For each machine, the slots whose messages may be too old for it, with the age in ns.

        The age is None if all that matters is whether a message is from before the start.
        """
        declared: dict[str, list[tuple[str, Iterable[Any]]]] = {}
        for seat in self.ringlets.seats:
            table = type(seat.machine).table
            reads = {}
            fresh: dict[str, int | None] = {}
            for name, sensor in table.sensors.items():
                slot = seat.slot_of(sensor)
                reads[name] = slot.name
                if sensor.max_age_ms is not None or sensor.since_start:
                    age_ms = sensor.max_age_ms
                    fresh[slot.name] = None if age_ms is None else floor(age_ms * 1e6)
                self._add_slot(slot, seat.name)
                if sensor.domain is not None:
                    where = f"{seat.name}.{name}"
                    declared.setdefault(slot.name, []).append((where, sensor.domain))
            self.reads.append(reads)
            self.freshness.append(fresh)
            for actuator in table.actuators.values():
                slot = seat.slot_of(actuator)
                self._add_slot(slot, seat.name)
                self.posted.add(slot.name)
        self.sensed = {slot for reads in self.reads for slot in reads.values()}
        given = {slot if isinstance(slot, str) else slot.name: d for slot, d in sensors.items()}
        self.domains: dict[str, tuple[int, ...]] = {}
        """The numbers of the messages that may be in each slot of the environment."""
        for name, domain in given.items():
            if self.learning and name not in self.sensed:
                continue
            self._check_given(name)
            self._add_domain(name, domain, f"sensors[{name!r}]")
        for name, domains in declared.items():
            if name not in self.posted and name not in self.domains:
                for where, domain in domains:
                    self._add_domain(name, domain, where)
        self._check_complete()
        self._connect_ages()
        self._check_choices()
        self.defaults: Mapping[str, Any] = defaults_of(self.ringlets.seats)
        """The message that a view shows for each slot while it is empty."""

    def _add_slot(self, slot: Slot[Any], machine: str) -> None:
        self.ringlets.message(slot.name, None)  # so that its messages are numbered from 1
        known = self.slots.setdefault(slot.name, slot)
        if known.type is not slot.type:
            raise DomainError(
                f"slot {slot.name!r} is of {known.type.__qualname__} for one machine, but of "
                f"{slot.type.__qualname__} for {machine}"
            )

    def _check_given(self, name: str) -> None:
        if name not in self.sensed:
            raise DomainError(
                f"sensors has a domain for {name!r}, which no machine reads"
                f"{did_you_mean(name, self.sensed)}"
            )
        if name in self.posted:
            raise DomainError(
                f"sensors has a domain for {name!r}, to which machines post: either the machines "
                f"or the environment may write a slot; a machine may stand for the environment"
            )

    def _add_domain(self, name: str, domain: Iterable[Any], where: str) -> None:
        messages = messages_of(self.slots[name], domain, where)
        numbers = tuple(self.ringlets.message(name, message) for message in messages)
        if self.domains.setdefault(name, numbers) != numbers:
            raise DomainError(f"{where}: another sensor of {name!r} declares another domain")

    def _check_complete(self) -> None:
        if self.learning:  # what code loads may post the rest
            self.posted |= self.sensed - self.domains.keys()
        missing = [
            f"{machine}.{sensor} ({slot})"
            for machine, reads in zip(self.names, self.reads, strict=True)
            for sensor, slot in reads.items()
            if slot not in self.posted and slot not in self.domains
        ]
        if missing:
            raise DomainError(
                f"no machine posts what these sensors read, and they have no domain: "
                f"{', '.join(missing)}; give Sensor(SLOT, domain=every(Type)), "
                f"sensors={{SLOT: every(Type)}}, or on the command line --sensor SLOT=DOMAIN"
            )

    def _check_choices(self) -> None:
        for place, name in enumerate(self.names):
            slots = self.free_slots(place)
            for slot in slots:
                readers = [each for each, other in self.reads[place].items() if other == slot]
                if len(readers) > 1:
                    raise UnsupportedError(
                        f"{name} reads {slot!r} by {' and '.join(readers)}, which may find two "
                        f"different messages: this cannot be explored; keep one of these sensors"
                    )
            if self.by_rounds:
                name, slots = "the environment", [*self.domains]
            number = prod(len(self.domains[slot]) for slot in slots)
            if number > _MOST_CHOICES:
                raise DomainError(
                    f"for {name} there are {number:,} combinations of what {', '.join(slots)} may "
                    f"hold: list those that matter, as in sensors={{SLOT: [message, ...]}}"
                )

    def _connect_ages(self) -> None:
        """Note which messages may be too old, and when those are that machines post."""
        self.ages: dict[str, Limits] = {}
        """The ages that sensors ask about, of the slots that machines post to."""
        self.withheld: set[str] = set()
        """The slots of the environment whose messages may be too old when choices are by rounds."""
        for place, fresh in enumerate(self.freshness):
            name = self.names[place]
            for slot, age_ns in fresh.items():
                what = f"{name} reads {slot!r} by a sensor with max_age_ms or since_start"
                if place in self.watchers:
                    raise UnsupportedError(f"{what}: a monitor must see every message")
                if sum(other == slot for other in self.reads[place].values()) > 1:
                    raise UnsupportedError(f"{what} and by another one: keep one of them")
                if slot in self.domains:
                    self.withheld.add(slot)
                elif age_ns is not None:
                    if self.time_model.unit_ns is None:
                        raise UnsupportedError(
                            f"{what}, and machines post to it: whether a message is too old is "
                            f"only known with a period: give period_ms (--period-ms)"
                        )
                    self.ages.setdefault(slot, Limits()).note(age_ns)
        for slot in self.withheld if self.by_rounds else ():
            readers = [place for place, reads in enumerate(self.reads) if slot in reads.values()]
            ages = {self.freshness[place].get(slot, -1) for place in readers}
            if len(ages) > 1:
                raise UnsupportedError(
                    f"sensors of {slot!r} have different max_age_ms, and choices are by rounds: a "
                    f'message may be too old for one of them alone; leave out choices="rounds"'
                )

    def is_stale(self, place: int, slot: str, units: int) -> bool:
        """Check that a message posted so many units of time ago is too old for a machine."""
        limit_ns, unit_ns = self.freshness[place].get(slot), self.time_model.unit_ns
        return limit_ns is not None and unit_ns is not None and units * unit_ns > limit_ns

    # The choices of the environment

    def free_slots(self, place: int) -> list[str]:
        """List the slots of the environment that a machine reads, each once."""
        if place in self.watchers:
            return []
        return [s for s in dict.fromkeys(self.reads[place].values()) if s in self.domains]

    def keeps(self, place: int, slot: str) -> bool:
        """Check that a slot's content is from before the turn of the machine, which reads it."""
        return self.by_rounds or slot in self.posted or place in self.watchers

    def contents(
        self, slots: Iterable[str], withheld: Container[str]
    ) -> Iterator[tuple[tuple[str, int], ...]]:
        """List all combinations of contents of these slots of the environment.

        A message of those that are `withheld` may be too old, which is as if there was none.
        """
        for numbers in product(*(self._domain(slot, slot in withheld) for slot in slots)):
            yield tuple(zip(slots, numbers, strict=True))

    def _domain(self, slot: str, may_be_old: bool) -> tuple[int, ...]:
        domain = self.answers[slot] if slot in self.answers else self.domains[slot]
        return (*domain, 0) if may_be_old and 0 not in domain else domain

    def choices(self, place: int, *, stopping: bool) -> list[Choice]:
        """List the environment's choices at a turn of the machine at `place`."""
        slots = [*([] if self.by_rounds else self.free_slots(place)), *self._answers_to(place)]
        requests = _REQUESTS if self.names[place] in self.suspend else (None,)
        stops = (False, True) if self.stop and not stopping else (False,)
        return [
            Choice(contents, request, stop)
            for contents in self.contents(slots, self.freshness[place])
            for request in requests
            for stop in stops
        ]

    def _answers_to(self, place: int) -> Iterator[str]:
        """Yield what holds the answers to the questions of a machine in a turn."""
        for machine, most in self._questions[place].items():
            for number in range(1, most + 1):
                slot = question_slot(self.names[place], machine, number)
                statuses = self._statuses[machine]
                numbers = dict.fromkeys(self.ringlets.message(slot, each) for each in statuses)
                self.answers[slot] = tuple(numbers)
                yield slot

    def answered(self, place: int, contents: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
        """List the answers in contents to a machine's questions, in order, by who was asked for."""
        return {
            machine: tuple(
                contents[question_slot(self.names[place], machine, n + 1)] for n in range(most)
            )
            for machine, most in self._questions[place].items()
        }

    # The ringlets of the machines

    def outcome(self, given: Given) -> RingletOutcome:
        """Look the effects of a ringlet up, or run and keep it.

        Raise `RelearnError` if running it has shown more than was known.
        """
        place, control, variables, elapsed_ns, stood_ns, contents, others, inner, *_ = given
        key = place, control, variables, contents, given.request, given.stopping
        kept = self._kept.get(key, ())
        if kept:
            controls, values = dict(others), dict(inner)
            for *_, outcome in kept:
                if (
                    outcome.low_ns
                    < (stood_ns if outcome.resumed else elapsed_ns)
                    <= outcome.high_ns
                    and all(controls[other] == its for other, its in outcome.asked)
                    and all(values[other] == its for other, its in outcome.looked)
                ):
                    return outcome
        try:
            outcome = self.ringlets.run_ringlet(given)
        except UnknownControlError as error:
            self.mentions[place] |= error.touched
            self.looks[place] |= error.looked
            self._keep(error.kept)
            raise RelearnError from None
        except UnansweredError as error:
            self._questions[place][error.machine] += 1
            raise RelearnError from None
        if outcome.limits:
            self._learn_limits(place, outcome)
        self._kept[key] = (*kept, (elapsed_ns, stood_ns, others, inner, outcome))
        kind = (
            *(place, control, given.request, outcome.control, outcome.others),
            *(outcome.fired, outcome.error, len(outcome.posts)),
        )
        if kind not in self._kinds:
            self._kinds[kind] = given, outcome
        self._learn_controls((place, outcome.control), *outcome.others)
        return outcome

    def shows(self, place: int) -> bool:
        """Check that a property may ask for a machine's variables; else it may the next time.

        Those of an inner machine that has ended are forgotten until then.
        """
        if place not in self.ringlets.inner or place in self.ringlets.kept:
            return True
        self._keep({place})
        return False

    def _keep(self, places: set[int]) -> None:
        if not places <= self.ringlets.kept:  # until now these were forgotten
            self.ringlets.kept |= places
            self._kept.clear()
            self._kinds.clear()

    def _learn_limits(self, place: int, outcome: RingletOutcome) -> None:
        """Note the times that a ringlet asks about, up to the first for which there is no room.

        It ran for a time that may be too short to answer that one, so it is not kept.
        """
        for state, limit in outcome.limits:
            limits = self.limits[place].setdefault(state, Limits())
            before = self.time_model.most(limits)
            limits.note(limit)
            if self.time_model.most(limits) != before:
                raise RelearnError

    def _learn_controls(self, *controls: tuple[int, int]) -> None:
        new = [each for each in controls if each not in self._known]
        if not new:
            return
        self._known.update(new)
        codes, known = self.ringlets.controls, len(self.leavers) + len(self.standing)
        for place, code in new:
            control: ControlState = codes[place].values[code]
            if not control.loaded:
                self.leavers.add(place)
            if control.stood:
                self.standing.add(place)
        if len(self.leavers) + len(self.standing) > known:
            raise RelearnError

    def left_out(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """List what never happens, but of monitors: states, and transitions.

        That is states that no machine comes into, as "Machine.STATE", and transitions that never
        fire, as "Machine.STATE -> TARGET: label".
        """
        stood = {(place, control) for place, (control, _) in enumerate(self.ringlets.initial)}
        fired = set()
        for (place, *_), outcome in self._kinds.values():
            stood |= {(place, outcome.control), *outcome.others}
            fired.add((place, outcome.fired))
        unreached, untaken = [], []
        for place, seat in enumerate(self.ringlets.seats[: self.watchers.start]):
            codes = self.ringlets.controls[place].values
            reached = {codes[control].current for other, control in stood if other == place}
            unreached += [f"{seat.name}.{state}" for state in seat.states if state not in reached]
            for state in type(seat.machine).table.states:
                for number, way in enumerate(state.transitions):
                    if (place, (state.name, number)) not in fired:
                        text = f"{seat.name}.{state.name} -> {way.target.name}: {way.label}"
                        untaken.append(text)
        return tuple(unreached), tuple(untaken)

    def sizes(self) -> tuple[int, ...]:
        """Count what is numbered as it is found: variables of each machine, and messages."""
        ringlets = self.ringlets
        return tuple(map(len, (*ringlets.variables, *ringlets.messages.values())))

    def values(self, first: Iterable[int] = ()) -> dict[str, int]:
        """Count the values that each variable has had, as "Machine.variable", the most first.

        With what `sizes` returned earlier, count those that it had then.
        """
        found: dict[str, int] = {}
        numbers = first or self.sizes()
        for name, codes, number in zip(self.names, self.ringlets.variables, numbers):  # noqa: B905
            names_of = (names for names, _ in islice(codes.keys(), number))
            variables = dict.fromkeys(each for names in names_of for each in names)
            for variable in variables:
                keys = (
                    keys[names.index(variable)]
                    for names, keys in islice(codes.keys(), number)
                    if variable in names
                )
                # One at a time, and those of a single variable differ: little memory may be left.
                count = sum(1 for _ in keys) if len(variables) == 1 else len({*keys})
                found[f"{name}.{variable}"] = count
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def posts(self, first: Iterable[int] = ()) -> dict[str, int]:
        """Count the messages that machines have posted to each slot, likewise."""
        numbers = islice(first or self.sizes(), len(self.names), None)
        each = dict(zip(self.ringlets.messages, numbers))  # noqa: B905
        return {slot: number - 1 for slot, number in each.items() if slot in self.posted}

    def longest_wait(self) -> tuple[str, int]:
        """Find the longest time that is asked about, in ns, after its "Machine.STATE"."""
        waits = [
            (limits[-1], f"{name}.{state}")
            for name, of_states in zip(self.names, self.limits, strict=True)
            for state, limits in of_states.items()
            if limits
        ]
        limit_ns, place = max(waits, default=(0, ""))
        return place, limit_ns

    def sample(self) -> tuple[list[tuple[Given, RingletOutcome]], bool]:
        """Choose ringlets that were run, with their effects, to see whether they do the same again.

        These are all, if there are few; the second result is then True. Of many they are a random
        part, and one of each kind: the machine's control state before and after, the transition
        that fired, the request, the number of posts.
        """
        number = max(_SAMPLE, len(self._kept) // _PART)
        if len(self._kept) <= number:
            keys, few = list(self._kept), []
        else:
            few = [*self._kinds.values()][:number]
            keys = random.Random(0).sample(list(self._kept), number - len(few))
        sample = few + [
            (Given(*key[:3], elapsed_ns, stood_ns, key[3], others, inner, *key[4:]), outcome)
            for key in keys
            for elapsed_ns, stood_ns, others, inner, outcome in self._kept[key]
        ]
        return sample, len(keys) == len(self._kept)

    def is_settled(self, place: int, control: int, *, stopping: bool) -> tuple[bool, bool]:
        """Check as `Ringlets.is_settled` does; a monitor does not keep the execution alive."""
        if place in self.watchers:
            return True, True
        return self.ringlets.is_settled(place, control, stopping=stopping, may_stop=self.stop)

    def waits(self, place: int, control: int) -> bool:
        """Check that a machine is suspended, and that anybody may wake it or leave it so."""
        return place not in self.watchers and self.ringlets.waits(place, control)

    def limits_of(self, place: int, control: ControlState) -> Limits:
        """List the times asked about in a control state; none if the state's clock does not run."""
        return self.limits[place].get(control.current, _NONE) if control.entered else _NONE

    def stood_limits(self, place: int, control: ControlState) -> Limits:
        """List the times asked about in the state in which a machine stands; none if in none."""
        return self.limits[place].get(control.remembered, _NONE) if control.stood else _NONE

    def require_all_stay(self, prop: Property) -> None:
        """Refuse a time limit under a timetable in which a turn may be left out.

        A state does not have the time of its last turn, which then may be one of several.
        """
        if any(turn.units for turn in self.order[1:]):
            for place in sorted(self.leavers - {*self.ringlets.inner}):
                raise UnsupportedError(
                    f"{prop}: {self.names[place]} leaves the arrangement, and then its turns of "
                    f"the timetable are left out: within_ms is not decided so; let it stay "
                    f"(unload_accepting = false)"
                )

    def clock_stops(self, place: int, state: str) -> bool:
        """Check that the clock of a state stands still while its machine is suspended."""
        seat = self.ringlets.seats[place]
        return seat.declared(seat.states[state]).clock == "stops"

    def most_stood(self, place: int) -> int:
        """Return the largest number for the time in a state in which a machine stands.

        Raise `UnsupportedError` if any time may pass between two rounds.
        """
        if place not in self.standing:
            return 0
        declared = self.ringlets.seats[place].table.states
        names = [s.name for s in declared if s.resume == "in_place"]
        asked = [name for name in names if self.limits[place].get(name)]
        if asked and self.time_model.unit_ns is None:
            raise UnsupportedError(
                f"{self.names[place]} may be suspended in {asked[0]}, where it asks for the time, "
                f"and goes on there in place: this is only explored with a period: give period_ms "
                f"(--period-ms)"
            )
        return max([self.time_model.most(self.limits[place][name]) for name in asked], default=0)

    def most_time(self, place: int) -> int:
        """Return the largest number for the time of a machine in any state of its."""
        return max(map(self.time_model.most, self.limits[place].values()), default=0)
