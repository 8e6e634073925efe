"""States as whole numbers, and tables from their bits to the effects of turns.

Exploring is fast because nothing of the engine runs for a state. Each field of a state, such as the
number of a machine's variables, has its bits in one number. A turn depends on some fields only:
their bits are the key of a table, and its value is the list of the turn's effects, one for each
choice of the environment. An effect is (mask, bits): `state & mask | bits` is the state after it.
A table is filled as it is looked up, by the ringlets that `System` keeps or runs. The same is done
for the time that passes, and for machines that have left or are settled.

Fields are packed tight, and those with few values come first, because the hash of a whole number is
the number: sets of them are fast only if the low bits differ. A field that becomes too small gets
twice the room in the next attempt (`RelearnError`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import inf
from typing import NamedTuple, TypeAlias, TypeVar

from llfsm.runtime.verification._system import Choice, RelearnError, System
from llfsm.runtime.verification._time_model import Limits
from llfsm.runtime.verification.environment import ControlState, Given, RingletOutcome
from llfsm.runtime.verification.properties import LastAsk

FieldName: TypeAlias = tuple[str, str]
"""A kind ("control", "variables", "elapsed", "slot", "seen", "stop", "failed") and a name."""


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
        self.fields: dict[FieldName, Bits] = {}
        shift = 0
        for name, size in sorted(sizes.items(), key=lambda item: item[1]):
            width = max(size - 1, 0).bit_length()
            self.fields[name] = Bits(shift, (1 << width) - 1)
            shift += width
        self.all = (1 << shift) - 1
        """The bits of all fields."""

    def mask(self, names: Iterable[FieldName]) -> int:
        """Return the bits of those of the fields that exist."""
        fields = self.fields
        return sum(fields[name].mask for name in set(names) if name in fields)


V = TypeVar("V")
Effect: TypeAlias = tuple[int, int]


class LazyTable(dict[int, V]):
    """Values by some bits of a state, each computed by `fill` when it is first looked up."""

    def __init__(self, fill: Callable[[int], V]):
        super().__init__()
        self._fill = fill

    def __missing__(self, key: int) -> V:
        value = self[key] = self._fill(key)
        return value


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
        self._named = set(named)
        self._none = Bits(0, 0)
        places = range(len(system.names))
        self.controls = [fields["control", name] for name in system.names]
        self._variables = [fields["variables", name] for name in system.names]
        self._elapsed = [fields.get(("elapsed", name), self._none) for name in system.names]
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
        self.masks = [self._key_mask(place) for place in places]
        self._ranges: list[dict[int, list[tuple[float, float, tuple[Effect, ...]]]]] = [
            {} for _ in places
        ]
        self.turns = [LazyTable(self._turn_filler(place)) for place in places]
        """For each machine, the effects of its turn, each once."""
        self.ticks = [
            (
                self.controls[place].mask | self._elapsed[place].mask,
                LazyTable(self._tick_filler(place)),
            )
            for place in places
            if self._elapsed[place].most
        ]
        self._dispensable, self.settled = (
            [
                (
                    self.controls[place].mask | self._stop.mask,
                    LazyTable(self._settled_filler(place, which)),
                )
                for place in places
            ]
            for which in range(2)
        )
        """For each machine, two tables: it need not keep the execution alive; it cannot."""
        self.rounds = self._round_choices()
        """The effects of the environment's choices for a round, if choices are made by rounds."""
        self.forgotten = self.packing.mask(
            ("slot", slot)
            for slot in system.domains
            if system.by_rounds and ("slot", slot) not in self._named
        )
        """The bits of the choices for a round, which are cleared when it is over."""
        self.leavers = frozenset(system.leavers)
        """The machines that can leave the arrangement."""
        self.loaded = [(self.controls[n].mask, LazyTable(self._loaded_filler(n))) for n in places]
        """For each machine, a table that is True as long as it has not left."""
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
        for place in range(len(system.names)):
            for slot in system.reads[place].values():
                if system.keeps(place, slot):
                    sizes["slot", slot] = 1
        if system.stop:
            sizes["stop", ""] = 2
        for field in named:
            sizes.setdefault(field, 1)
        if len(system.ringlets.errors) > 1:
            sizes["failed", ""] = len(system.ringlets.errors)
        return {field: max(size, grown.get(field, 2)) for field, size in sizes.items()}

    def _key_mask(self, place: int) -> int:
        mask = self.controls[place].mask | self._variables[place].mask | self._stop.mask
        mask |= self._elapsed[place].mask
        for field in self._read[place].values():
            mask |= field.mask
        for other in self.system.mentions[place]:
            mask |= self.controls[other].mask
        return mask

    def _round_choices(self) -> list[Effect]:
        system = self.system
        if not system.by_rounds:
            return []
        slots = sorted(system.domains)
        keep = self.packing.all & ~self.packing.mask(("slot", slot) for slot in slots)
        return [
            (keep, sum(self._put(("slot", slot), code) for slot, code in contents))
            for contents in system.contents(slots)
        ]

    def choices(self, place: int, state: int) -> list[tuple[Choice, RingletOutcome, Effect]]:
        """List the environment's choices at a machine's turn, with its outcome and effect."""
        key = state & self.masks[place]
        turns = self._outcomes(place, key, self._time(place)(key))
        return [
            (choice, outcome, self._effect(place, outcome, choice, found))
            for choice, found, outcome in turns
        ]

    def number_of_choices(self, place: int, states: list[int]) -> int:
        """Count the choices that the environment has in all of some states."""
        running, stopping = (len(self._choices[place][each]) for each in (False, True))
        if not self._stop.most:
            return len(states) * running
        stopped = sum(1 for s in states if s & self._stop.mask)
        return (len(states) - stopped) * running + stopped * stopping

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

    def _turn_filler(self, place: int) -> Callable[[int], tuple[Effect, ...]]:
        time, rest = self._time(place), ~self._elapsed[place].mask
        kept = self._ranges[place]

        def fill(key: int) -> tuple[Effect, ...]:
            elapsed_ns = time(key)
            ranges = kept.setdefault(key & rest, [])
            for low_ns, high_ns, effects in ranges:
                if low_ns < elapsed_ns <= high_ns:
                    return effects
            low_ns, high_ns, each = self._effects(place, key, elapsed_ns)
            ranges.append((low_ns, high_ns, tuple(dict.fromkeys(each))))
            return ranges[-1][2]

        return fill

    def _time(self, place: int) -> Callable[[int], int]:
        """Make a function that returns the time in a machine's state, in ns, by a key."""
        (shift, most), time_model = self._elapsed[place], self.system.time_model
        period_ns = time_model.period_ns
        if period_ns is not None:
            return lambda key: (key >> shift & most) * period_ns
        return lambda key: time_model.elapsed_ns(key >> shift & most, self._limits(place, key))

    def control(self, place: int, state: int) -> ControlState:
        """Return a machine's control state in a state."""
        codes = self.system.ringlets.controls[place]
        control: ControlState = codes.values[self.controls[place].of(state)]
        return control

    def _limits(self, place: int, key: int) -> Limits:
        return self.system.limits_of(place, self.control(place, key))

    def running(self, state: int) -> Iterator[tuple[int, Limits, int]]:
        """List the machines whose clocks run: place, limits, and the number for the time."""
        for place, field in enumerate(self._elapsed):
            if limits := self._limits(place, state):
                yield place, limits, field.of(state)

    def _effects(self, place: int, key: int, elapsed_ns: int) -> tuple[float, float, list[Effect]]:
        """Return the range of times in the state with the same effects, and one for each choice."""
        low_ns, high_ns = -inf, inf
        effects = []
        for choice, found, outcome in self._outcomes(place, key, elapsed_ns):
            low_ns, high_ns = max(low_ns, outcome.low_ns), min(high_ns, outcome.high_ns)
            effects.append(self._effect(place, outcome, choice, found))
        return low_ns, high_ns, effects

    def _outcomes(
        self, place: int, key: int, elapsed_ns: int
    ) -> Iterator[tuple[Choice, dict[str, int], RingletOutcome]]:
        """Yield each choice, the contents of the slots that are read then, and the outcome."""
        system = self.system
        control, variables = self.controls[place].of(key), self._variables[place].of(key)
        contents = {slot: field.of(key) for slot, field in self._read[place].items()}
        others = tuple((other, self.controls[other].of(key)) for other in system.mentions[place])
        stopping = self.stopping(key)
        for choice in self._choices[place][stopping]:
            found = contents | dict(choice.contents)
            outcome = system.outcome(
                Given(
                    place,
                    control,
                    variables,
                    elapsed_ns,
                    tuple(found.items()),
                    others,
                    choice.request,
                    stopping or choice.stop,
                )
            )
            yield choice, found, outcome

    def _effect(
        self, place: int, outcome: RingletOutcome, choice: Choice, found: dict[str, int]
    ) -> Effect:
        name, fields = self.system.names[place], self.fields
        values: dict[FieldName, int] = {
            ("control", name): outcome.control,
            ("variables", name): outcome.variables,
        }
        if outcome.restarted and self._elapsed[place].most:
            values["elapsed", name] = 0
        for other, its in outcome.others:
            values["control", self.system.names[other]] = its
        for slot, content in (*choice.contents, *outcome.posts):
            if ("slot", slot) in fields:
                values["slot", slot] = content
        if self._named:
            for sensor, slot in self.system.reads[place].items():
                if (field := ("seen", f"{name}.{sensor}")) in fields:
                    values[field] = found[slot]
        if choice.stop:
            values["stop", ""] = 1
        if outcome.error:
            values["failed", ""] = outcome.error
        bits = sum(self._put(field, value) for field, value in values.items())
        return self.packing.all & ~self.packing.mask(values), bits

    def _tick_filler(self, place: int) -> Callable[[int], tuple[int, ...]]:
        field, time_model = self._elapsed[place], self.system.time_model

        def added(key: int) -> tuple[int, ...]:
            steps = time_model.steps(field.of(key), self._limits(place, key))
            return tuple(step << field.shift for step in steps)

        return added

    def initial(self) -> int:
        """Return the initial state."""
        system = self.system
        return sum(
            self._put(("control", name), control) | self._put(("variables", name), variables)
            for name, (control, variables) in zip(
                system.names, system.ringlets.initial, strict=True
            )
        )

    def _loaded_filler(self, place: int) -> Callable[[int], bool]:
        codes, field = self.system.ringlets.controls[place], self.controls[place]
        return lambda key: bool(codes.values[field.of(key)].loaded)

    def may_end(self, turn: int, state: int) -> bool:
        """Check that the execution may end in a state."""
        if state & self.failed.mask:
            return True
        return turn == 0 and all(table[state & mask] for mask, table in self._dispensable)

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
