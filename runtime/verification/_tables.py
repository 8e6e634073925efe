"""States as whole numbers, and tables from their bits to the effects of turns.

Exploring is fast because nothing of the engine runs for a state. Each field of a state, such as the
number of a machine's variables, has its bits in one number. A turn depends on some fields only:
their bits are the key of a table, and its value is the list of the turn's effects, one for each
choice of the environment. A table is filled as it is looked up, by the ringlets that `System` keeps
or runs. The same is done for the time that passes, and for machines that have left or are settled.

Values are numbered as they are found, so nobody knows how many bits a field will need. The bits of
a word that nobody needs yet are shared out among the fields that may grow. One that becomes too
small nevertheless gets twice the room in the next attempt (`RelearnError`): so there are few
attempts, and all but the last are short. Without the extension in C, fields are packed tight, and
those with few values come first: the hash of a whole number is the number, and sets of them are
fast only if the low bits differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import inf
from typing import Final, NamedTuple, TypeAlias

from llfsm.runtime.verification._packed_states import Effect, Fill
from llfsm.runtime.verification._system import Choice, RelearnError, System
from llfsm.runtime.verification._time_model import Limits
from llfsm.runtime.verification._twin import SPREAD, EffectTable, States
from llfsm.runtime.verification.environment import ControlState, Given, RingletOutcome
from llfsm.runtime.verification.properties import LastAsk

FieldName: TypeAlias = tuple[str, str]
"""A kind, such as "control", "variables", "elapsed", "slot", "age" or "seen", and a name."""
_FIXED: Final = ("elapsed", "stood", "age", "stop")
"""The kinds of fields whose largest value is known."""


class Bits(NamedTuple):
    """The bits of a field: `(state >> shift) & most` is its value."""

    shift: int
    most: int

    @property
    def mask(self) -> int:
        """The field's bits, all set."""
        return self.most << self.shift

    def of(self, state: int) -> int:
        """Return the field's value in a state."""
        return (state >> self.shift) & self.most


class Packing:
    """The place of each field; `sizes` are the numbers of values for which each must have room."""

    def __init__(self, sizes: Mapping[FieldName, int]):
        widths = {name: max(size - 1, 0).bit_length() for name, size in sizes.items()}
        needed = sum(widths.values())
        self.words = needed // 64 + 1
        """The words of 64 bits that a state needs; its highest bit is never set."""
        growing = [name for name in sizes if name[0] not in _FIXED]
        spare = (64 * self.words - 1 - needed) // len(growing) if SPREAD and growing else 0
        self.fields: dict[FieldName, Bits] = {}
        shift = 0
        for name in sorted(sizes, key=sizes.__getitem__):
            width = widths[name] + (spare if name in growing else 0)
            self.fields[name] = Bits(shift, (1 << width) - 1)
            shift += width
        self.all = (1 << shift) - 1
        """The bits of all fields."""

    def table(self, mask: int, fill: Fill) -> EffectTable:
        """Make a table of effects by some bits."""
        return EffectTable(self.words, mask, fill)

    def filter(self, mask: int, holds: Callable[[int], bool]) -> EffectTable:
        """Make a table that leaves a state as it is if `holds` for some bits; else it drops it."""
        same = ((self.all, 0),)
        return EffectTable(self.words, mask, lambda key: (1, same if holds(key) else ()))

    def states(self, states: Iterable[int] = ()) -> States:
        """Make a list of packed states."""
        return States(self.words, states)

    def mask(self, names: Iterable[FieldName]) -> int:
        """Return the bits of those of the fields that exist."""
        fields = self.fields
        return sum(fields[name].mask for name in set(names) if name in fields)


class Tables:
    """The tables of a `system` by the fields and sizes that are known now.

    `named` are the fields that a property asks for although no machine's turn depends on them.
    Looking up raises `RelearnError` if a field has become too small; `sizes` are then larger.
    """

    def __init__(self, system: System, named: Iterable[FieldName], sizes: dict[FieldName, int]):
        self.system = system
        self.packing = Packing(self._sizes(set(named), sizes))
        self._sizes_seen = sizes
        fields = self.fields = self.packing.fields
        self._named = frozenset(named)
        self._none = Bits(0, 0)
        places = range(len(system.names))
        self.controls = [fields["control", name] for name in system.names]
        self._variables = [fields["variables", name] for name in system.names]
        self._elapsed = [fields.get(("elapsed", name), self._none) for name in system.names]
        self._stood = [fields.get(("stood", name), self._none) for name in system.names]
        self.failed = fields.get(("failed", ""), self._none)
        self._stop = fields.get(("stop", ""), self._none)
        self._read = [
            {
                slot: fields[name]
                for slot in dict.fromkeys(system.reads[place].values())
                if (name := ("slot", slot)) in fields and system.keeps(place, slot)
            }
            for place in places
        ]
        self._ages = {slot: fields["age", slot] for slot in system.ages}
        self._own = [self.controls[n].mask | self._variables[n].mask for n in places]
        self._slots = {name: bits for (kind, name), bits in fields.items() if kind == "slot"}
        self._seen = [
            [
                (field, slot)
                for sensor, slot in system.reads[place].items()
                if (field := ("seen", f"{name}.{sensor}")) in fields
            ]
            for place, name in enumerate(system.names)
        ]
        packing = self.packing
        self._masks = [self._key_mask(place) for place in places]
        self._ranges: list[dict[int, list[tuple[float, float, tuple[Effect, ...]]]]] = [
            {} for _ in places
        ]
        self.turns = [packing.table(self._masks[n], self._turn_filler(n)) for n in places]
        """For each machine, the effects of its turn, each once; they weigh as much as all do."""
        self.ticks, self.passing = self._passing_time()
        self._dispensable, self.settled = (
            [
                packing.filter(
                    self.controls[place].mask | self._stop.mask, self._settled_filler(place, which)
                )
                for place in places
            ]
            for which in range(2)
        )
        """For each machine, two filters: it need not keep the execution alive; it cannot."""
        self.rounds = self._round_choices()
        """The effects of the environment's choices for a round, if choices are made by rounds."""
        forgotten = packing.mask(
            ("slot", slot)
            for slot in system.domains
            if system.by_rounds and ("slot", slot) not in self._named
        )
        clears = (1, ((packing.all & ~forgotten, 0),))
        self.forgotten = packing.table(0, lambda _: clears) if forgotten else None
        """Clears the choices for a round, when it is over; None if that is not needed."""
        self.intact = packing.filter(self.failed.mask, lambda key: not key)
        """A filter of states in which no code has raised."""
        suspends = system.ringlets.kernel.on_error == "suspend"
        self._sound = [
            packing.filter(self.controls[n].mask, self._is_sound(n))
            for n in places
            if suspends and n not in system.ringlets.inner
        ]
        """For each machine but inner ones, which others look after: its code has not raised."""
        self.leavers = frozenset(system.leavers)
        """The machines that can leave the arrangement."""
        self.loaded = [packing.filter(self.controls[n].mask, self._is_loaded(n)) for n in places]
        """For each machine, a filter: it has not left."""
        self._choices: list[dict[bool, list[Choice]]] = [
            {stopping: system.choices(place, stopping=stopping) for stopping in (False, True)}
            for place in places
        ]

    def _sizes(self, named: set[FieldName], grown: dict[FieldName, int]) -> dict[FieldName, int]:
        system = self.system
        sizes: dict[FieldName, int] = {}
        for place, name in enumerate(system.names):
            sizes["control", name] = len(system.ringlets.controls[place])
            sizes["variables", name] = len(system.ringlets.variables[place])
            if most := system.most_time(place):
                sizes["elapsed", name] = most + 1
            if most := system.most_stood(place):
                sizes["stood", name] = most + 1
        for slot, limits in system.ages.items():
            sizes["age", slot] = system.time_model.most(limits) + 1
        for place in range(len(system.names)):
            for slot in system.reads[place].values():
                if system.keeps(place, slot):
                    sizes["slot", slot] = len(system.ringlets.messages[slot])
        if system.stop:
            sizes["stop", ""] = 2
        for field in named:
            sizes.setdefault(field, 1)
        if len(system.ringlets.errors) > 1:
            sizes["failed", ""] = len(system.ringlets.errors)
        return {field: max(size, grown.get(field, 2)) for field, size in sizes.items()}

    def _key_mask(self, place: int) -> int:
        mask = self.controls[place].mask | self._variables[place].mask | self._stop.mask
        mask |= self._elapsed[place].mask | self._stood[place].mask
        for slot, field in self._read[place].items():
            mask |= field.mask
            if slot in self._ages and slot in self.system.freshness[place]:
                mask |= self._ages[slot].mask
        for other in self.system.mentions[place]:
            mask |= self.controls[other].mask
            if self._stood[other].most:  # which this one may suspend
                mask |= self._elapsed[other].mask | self._stood[other].mask
        for other in self.system.looks[place]:
            mask |= self._variables[other].mask
        return mask

    def _passing_time(self) -> tuple[list[tuple[int, list[EffectTable]]], list[list[EffectTable]]]:
        """Fill tables of how many rounds after the one before a round may begin, and its effects.

        The second list has the effects of the time before each turn but the first of a round.
        """
        places = range(len(self.system.names))
        rounds = self.system.time_model.rounds(max(map(self.system.most_time, places)))
        first, *others = (turn.units for turn in self.system.order)
        ticks = [(n, self._ticks(n * first)) for n in rounds]
        return ticks, [[], *(self._ticks(units) if units else [] for units in others)]

    def _round_choices(self) -> EffectTable | None:
        system = self.system
        if not system.by_rounds:
            return None
        slots = sorted(system.domains)
        keep = self.packing.all & ~self.packing.mask(("slot", slot) for slot in slots)
        effects = tuple(
            (keep, sum(self._put(("slot", slot), code) for slot, code in contents))
            for contents in system.contents(slots, system.withheld)
        )
        return self.packing.table(0, lambda _: (1, effects))

    def choices(self, place: int, state: int) -> list[tuple[Choice, RingletOutcome, Effect]]:
        """List the environment's choices at a machine's turn, with its outcome and effect."""
        key = state & self._masks[place]
        time = self._time(place)
        turns = self._outcomes(place, key, 0 if time is None else time(key))
        return [
            (choice, outcome, self._effect(place, key, outcome, choice, contents))
            for choice, contents, outcome in turns
        ]

    def ended(self, states: States) -> States:
        """List the states in which all has ended as code has raised."""
        return self.intact.split(states)[1] if self.failed.most else states[:0]

    def failing(self, states: States) -> States:
        """List those; if there are none, the states in which a machine was suspended for that."""
        found = self.ended(states)
        for sound in self._sound:
            found = found or sound.split(states)[1]
        return found

    def stopping(self, state: int) -> bool:
        """Check that a stop has come."""
        return bool(self._stop.of(state))

    def _put(self, name: FieldName, value: int) -> int:
        """Return the bits of a field's value; raise `RelearnError` if it needs more room."""
        field = self.fields.get(name, self._none)
        if value > field.most:
            self._sizes_seen[name] = 2 * value
            raise RelearnError
        return value << field.shift

    def _turn_filler(self, place: int) -> Fill:
        time, rest = self._time(place), ~self._elapsed[place].mask
        kept = self._ranges[place]

        def fill(key: int) -> tuple[int, tuple[Effect, ...]]:
            weight = len(self._choices[place][self.stopping(key)])
            if time is None:
                return weight, self._effects(place, key, 0)[2]
            elapsed_ns = time(key)
            if self._stood[place].most:  # then effects depend on both of its times
                return weight, self._effects(place, key, elapsed_ns)[2]
            ranges = kept.setdefault(key & rest, [])
            for low_ns, high_ns, effects in ranges:
                if low_ns < elapsed_ns <= high_ns:
                    return weight, effects
            ranges.append(self._effects(place, key, elapsed_ns))
            return weight, ranges[-1][2]

        return fill

    def _time(self, place: int) -> Callable[[int], int] | None:
        """Make a function that returns the time in a machine's state, in ns, by a key."""
        (shift, most), time_model = self._elapsed[place], self.system.time_model
        if not most:
            return None
        unit_ns = time_model.unit_ns
        if unit_ns is not None:
            return lambda key: (key >> shift & most) * unit_ns
        return lambda key: time_model.elapsed_ns(key >> shift & most, self._limits(place, key))

    def control(self, place: int, state: int) -> ControlState:
        """Return a machine's control state in a state."""
        codes = self.system.ringlets.controls[place]
        control: ControlState = codes.values[self.controls[place].of(state)]
        return control

    def _stood_ns(self, place: int, key: int) -> int:
        """Return the time in the state in which a machine stands, in ns."""
        return self._stood[place].of(key) * (self.system.time_model.unit_ns or 0)

    def _stood_limits(self, place: int, key: int) -> Limits:
        return self.system.stood_limits(place, self.control(place, key))

    def _limits(self, place: int, key: int) -> Limits:
        return self.system.limits_of(place, self.control(place, key))

    def _has_limits(self, place: int, control: int) -> bool:
        """Check that the time in a control state matters: else it is 0, as it was at first."""
        codes = self.system.ringlets.controls[place]
        return bool(self.system.limits_of(place, codes.values[control]))

    def running(self, state: int) -> Iterator[tuple[int, Limits, int]]:
        """List the machines whose clocks run: place, limits, and the number for the time."""
        for place, field in enumerate(self._elapsed):
            if limits := self._limits(place, state):
                yield place, limits, field.of(state)

    def _effects(
        self, place: int, key: int, elapsed_ns: int
    ) -> tuple[float, float, tuple[Effect, ...]]:
        """Return the range of times in the state with the same effects, and these, each once."""
        low_ns, high_ns = -inf, inf
        effects: dict[Effect, None] = {}
        for choice, contents, outcome in self._outcomes(place, key, elapsed_ns):
            low_ns, high_ns = max(low_ns, outcome.low_ns), min(high_ns, outcome.high_ns)
            effects[self._effect(place, key, outcome, choice, contents)] = None
        return low_ns, high_ns, tuple(effects)

    def _outcomes(
        self, place: int, key: int, elapsed_ns: int
    ) -> Iterator[tuple[Choice, tuple[tuple[str, int], ...], RingletOutcome]]:
        """Yield each choice, the contents of the slots that are read then, and the outcome."""
        system = self.system
        control, variables = self.controls[place].of(key), self._variables[place].of(key)
        kept = tuple(
            [
                (slot, 0 if self._is_stale(place, slot, key) else field.of(key))
                for slot, field in self._read[place].items()
            ]
        )
        others = tuple([(other, self.controls[other].of(key)) for other in system.mentions[place]])
        inner = tuple([(other, self._variables[other].of(key)) for other in system.looks[place]])
        stopping, stood_ns = self.stopping(key), self._stood_ns(place, key)
        for choice in self._choices[place][stopping]:
            slots, request, stop = choice
            contents = kept + slots
            outcome = system.outcome(
                Given(
                    place,
                    control,
                    variables,
                    elapsed_ns,
                    stood_ns,
                    contents,
                    others,
                    inner,
                    request,
                    stopping or stop,
                )
            )
            yield choice, contents, outcome

    def _is_stale(self, place: int, slot: str, key: int) -> bool:
        age = self._ages.get(slot)
        return age is not None and self.system.is_stale(place, slot, age.of(key))

    def _effect(
        self,
        place: int,
        key: int,
        outcome: RingletOutcome,
        choice: Choice,
        contents: tuple[tuple[str, int], ...],
    ) -> Effect:
        controls, variables = self.controls[place], self._variables[place]
        mask, name = self._own[place], self.system.names[place]
        if outcome.control > controls.most:
            self._put(("control", name), outcome.control)
        if outcome.variables > variables.most:
            self._put(("variables", name), outcome.variables)
        bits = outcome.control << controls.shift | outcome.variables << variables.shift
        if outcome.restarted or not self._has_limits(place, outcome.control):
            mask |= self._elapsed[place].mask
        values: dict[FieldName, int] = {}
        if outcome.went_on and self._stood[place].most:
            values["elapsed", name] = self._stood[place].of(key)
        if self._stood[place].most:
            values["stood", name] = self._stood_after(place, key, outcome.control)
        for other, its in outcome.others:
            values["control", self.system.names[other]] = its
            if self._stood[other].most:
                values["stood", self.system.names[other]] = self._stood_after(other, key, its)
            if not self._has_limits(other, its):
                mask |= self._elapsed[other].mask
        for other, its in outcome.inner:
            values["variables", self.system.names[other]] = its
        for slot, content in (*choice.contents, *outcome.posts):
            if slot in self._slots:
                values["slot", slot] = content
        for slot, _ in outcome.posts:
            if slot in self._ages:
                values["age", slot] = 0
        for field, slot in self._seen[place]:
            values[field] = dict((*contents, *outcome.found))[slot]
        if choice.stop:
            values["stop", ""] = 1
        if outcome.error:
            values["failed", ""] = outcome.error
        if values:
            mask |= self.packing.mask(values)
            bits |= sum(self._put(field, value) for field, value in values.items())
        return self.packing.all & ~mask, bits

    def _stood_after(self, place: int, key: int, control: int) -> int:
        """Return the number for the time in which a machine stands after a turn before `key`."""
        after: ControlState = self.system.ringlets.controls[place].values[control]
        if not after.stood:
            return 0
        if self.control(place, key).stood:
            return self._stood[place].of(key)
        return self._elapsed[place].of(key) if self.system.stood_limits(place, after) else 0

    def _ticks(self, units: int) -> list[EffectTable]:
        """Make the tables of the time that passes, of so many units."""
        clocks = [
            self.packing.table(control.mask | elapsed.mask, self._tick_filler(place, units))
            for place, (control, elapsed) in enumerate(
                zip(self.controls, self._elapsed, strict=True)
            )
            if elapsed.most
        ]
        ages = [
            self.packing.table(age.mask | self._slots[slot].mask, self._age_filler(slot, units))
            for slot, age in self._ages.items()
        ]
        stood = [
            self.packing.table(control.mask | stood.mask, self._stood_filler(place, units))
            for place, (control, stood) in enumerate(zip(self.controls, self._stood, strict=True))
            if stood.most
        ]
        return clocks + ages + stood

    def _tick_filler(self, place: int, units: int) -> Fill:
        field, time_model = self._elapsed[place], self.system.time_model
        keep = self.packing.all & ~field.mask

        def passed(key: int) -> tuple[int, tuple[Effect, ...]]:
            number = field.of(key)
            steps = time_model.steps(number, self._limits(place, key), units)
            return 1, tuple((keep, number + step << field.shift) for step in steps)

        return passed

    def _stood_filler(self, place: int, units: int) -> Fill:
        field, system = self._stood[place], self.system
        keep = self.packing.all & ~field.mask

        def passed(key: int) -> tuple[int, tuple[Effect, ...]]:
            number, limits = field.of(key), self._stood_limits(place, key)
            if limits and not system.clock_stops(place, self.control(place, key).remembered):
                number += system.time_model.steps(number, limits, units)[0]
            return 1, ((keep, number << field.shift),)

        return passed

    def _age_filler(self, slot: str, units: int) -> Fill:
        field, content = self._ages[slot], self._slots[slot]
        most = self.system.time_model.most(self.system.ages[slot])
        keep = self.packing.all & ~field.mask

        def aged(key: int) -> tuple[int, tuple[Effect, ...]]:
            number = min(field.of(key) + units, most) if content.of(key) else 0
            return 1, ((keep, number << field.shift),)

        return aged

    def initial(self) -> int:
        """Return the initial state."""
        system = self.system
        return sum(
            self._put(("control", name), control) | self._put(("variables", name), variables)
            for name, (control, variables) in zip(
                system.names, system.ringlets.initial, strict=True
            )
        )

    def _is_sound(self, place: int) -> Callable[[int], bool]:
        codes, field = self.system.ringlets.controls[place], self.controls[place]
        return lambda key: not codes.values[field.of(key)].failed

    def _is_loaded(self, place: int) -> Callable[[int], bool]:
        codes, field = self.system.ringlets.controls[place], self.controls[place]
        return lambda key: bool(codes.values[field.of(key)].loaded)

    def may_end(self, turn: int, state: int) -> bool:
        """Check that the execution may end in a state."""
        if state & self.failed.mask:
            return True
        return turn == 0 and all(each.effects(state) for each in self._dispensable)

    def asked_to_end(self, state: int) -> dict[str, tuple[LastAsk, ...]]:
        """List the requests, as a round is over, without which it does not end in a state."""
        if state & self.failed.mask:
            return {}
        system, stopping = self.system, self.stopping(state)
        asked: dict[str, tuple[LastAsk, ...]] = {}
        for place, name in enumerate(system.names):
            if system.waits(place, self.controls[place].of(state)):
                asks: list[LastAsk] = ["stop"] if not stopping else []
                if self.control(place, state).request is not None:  # which would wake it
                    asks.insert(0, "suspend")
                asked |= {name: tuple(asks)} if asks else {}
                stopping = True
        return asked

    def _settled_filler(self, place: int, which: int) -> Callable[[int], bool]:
        system = self.system

        def settled(key: int) -> bool:
            control, stopping = self.controls[place].of(key), self.stopping(key)
            return system.is_settled(place, control, stopping=stopping)[which]

        return settled
