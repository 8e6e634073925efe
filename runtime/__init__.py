"""Run logic-labelled finite-state machines: declare them, load them, give them turns.

Read in this order: `state` and `table` (what a machine is), `machine` (what its code may ask),
`seat`, `binding` and `ringlet` (one turn of one machine), `roster` and `arrangement` (all).
"""

from .arrangement import Arrangement
from .clock import Clock, ManualClock, MonotonicClock
from .errors import (
    ArrangementEndedError,
    BundleError,
    ClockError,
    DefinitionError,
    DrawingError,
    ExecutionError,
    FsmError,
    GuardResultError,
    LoadError,
    NotLoadedError,
    ObserverError,
    OptionError,
    ScheduleError,
    UnknownMachineError,
    UnreachableStateWarning,
    VariableError,
)
from .events import Event, Observer, Reason, Request, Status
from .machine import Machine, define
from .ports import Actuator, Sensor
from .schedule import Requirement, TimeSlot, Timetable
from .state import State, Transition
from .statistics import MachineStatistics, Spread
from .submachine import Submachine
from .table import REQUIRED, Table, Variable
from .trace import Trace

__all__ = [
    "REQUIRED",
    "Actuator",
    "Arrangement",
    "ArrangementEndedError",
    "BundleError",
    "Clock",
    "ClockError",
    "DefinitionError",
    "DrawingError",
    "Event",
    "ExecutionError",
    "FsmError",
    "GuardResultError",
    "LoadError",
    "Machine",
    "MachineStatistics",
    "ManualClock",
    "MonotonicClock",
    "NotLoadedError",
    "Observer",
    "ObserverError",
    "OptionError",
    "Reason",
    "Request",
    "Requirement",
    "ScheduleError",
    "Sensor",
    "Spread",
    "State",
    "Status",
    "Submachine",
    "Table",
    "TimeSlot",
    "Timetable",
    "Trace",
    "Transition",
    "UnknownMachineError",
    "UnreachableStateWarning",
    "Variable",
    "VariableError",
    "define",
]
