"""Run logic-labelled finite-state machines: declare them, load them, give them turns.

Read in this order: `state` and `table` (what a machine is), `machine` (what its code may ask),
`seat`, `binding` and `ringlet` (one turn of one machine), `roster` and `arrangement` (all).
"""

from .arrangement import Arrangement, Reason
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
    UnknownMachineError,
    UnreachableStateWarning,
    VariableError,
)
from .events import Event, Observer, Request
from .machine import Machine, Status, define
from .ports import Actuator, Sensor
from .state import State, Transition
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
    "ManualClock",
    "MonotonicClock",
    "NotLoadedError",
    "Observer",
    "ObserverError",
    "OptionError",
    "Reason",
    "Request",
    "Sensor",
    "State",
    "Status",
    "Table",
    "Trace",
    "Transition",
    "UnknownMachineError",
    "UnreachableStateWarning",
    "Variable",
    "VariableError",
    "define",
]
