from collections.abc import Callable, Iterable

from typing_extensions import disjoint_base

from .binding import BoundSensor, BoundState, BoundTransition, Running
from .events import Request
from .machine import Machine
from .seat import Seat
from .state import SectionCode

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

@disjoint_base
class StateFields:
    on_entry: SectionCode | None
    on_exit: SectionCode | None
    internal: SectionCode | None
    on_suspend: SectionCode | None
    on_resume: SectionCode | None
    transitions: tuple[BoundTransition, ...]

@disjoint_base
class Rotation:
    _turn: Callable[[Seat], bool]
    _leaving: list[Seat]
    def _give_turns(self, seats: Iterable[Seat | None], /) -> bool: ...

def ringlet(seat: Seat, /) -> bool: ...
def running(seat: Seat, /) -> Running | None: ...
