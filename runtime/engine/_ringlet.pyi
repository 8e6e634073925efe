from collections.abc import Callable, Iterable
from types import GenericAlias
from typing import final

from typing_extensions import disjoint_base

from .events import Request
from .machine import Machine
from .ringlet import BoundSensor, BoundState, Running
from .ringlet import StateFields as StateFields
from .seat import Failure, Seat
from .statistics import Meter
from .statistics import MeterFields as MeterFields

@disjoint_base
class SeatFields:
    machine: Machine
    request: Request | None
    sensors: tuple[BoundSensor, ...]
    current: BoundState
    previous: BoundState | None
    source: BoundState | None
    suspension: BoundState
    notifies: bool
    now: Callable[[], int]
    entered_ns: int
    meter: Meter | None
    timed: BoundState | None
    failure: Failure | None
    hang: str
    inner: bool
    children: list[Seat | None] | None

@final
class Histogram:
    total: int
    longest_ns: int
    @property
    def counts(self) -> list[int]: ...
    def add(self, ns: int, /) -> None: ...

@disjoint_base
class Timing:
    now: Callable[[], int]
    begin_ns: int
    due_ns: int
    deadline_ns: int
    def begin(self) -> bool: ...
    def begin_due(self, due_ns: int, deadline_ns: int, lateness: Histogram, /) -> None: ...
    def take(self, seat: Seat, fired: bool, /) -> None: ...

@disjoint_base
class Rotation:
    _turn: Callable[[Seat], bool]
    _leaving: list[Seat]
    stopwatch: Timing | None
    _gate: Callable[[], bool] | None
    nests: bool
    rounds: int
    def give_turns(self, seats: Iterable[Seat | None], /) -> bool: ...
    def give_round(self, seats: Iterable[Seat | None], /) -> bool: ...
    def __class_getitem__(cls, item: object, /) -> GenericAlias: ...
    def give_rounds(self, seats: list[Seat | None], sleep: Callable[[], bool], /) -> bool: ...

def ringlet(seat: Seat, /) -> bool: ...
def running(seat: Seat, /) -> Running | None: ...
def sleep_until_ns(deadline_ns: int, /) -> None: ...
