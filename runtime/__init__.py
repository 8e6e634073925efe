"""Run logic-labelled finite-state machines: declare them, load them, give them turns.

Read in this order, in `engine`: `state` and `table` (what a machine is), `machine` (what its code
may ask), `environment` (what it learns from and acts on), `ringlet` and `seat` (one turn of one
machine), `kernel` and `arrangement` (all).
"""

from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.clock import Clock, ManualClock, MonotonicClock, SimulatedClock
from llfsm.runtime.engine.errors import (
    ActuatorClosedError,
    ActuatorTakenError,
    ArrangementEndedError,
    BreakpointError,
    BundleError,
    ClockError,
    DefinitionError,
    DrawingError,
    ExecutionError,
    FsmError,
    GuardResultError,
    KeepError,
    LoadError,
    NotLoadedError,
    NotPausedError,
    ObserverError,
    OptionError,
    RealtimeError,
    ScheduleError,
    SensorNameError,
    TypeCheckerError,
    UnknownMachineError,
    UnreachableStateWarning,
    VariableError,
)
from llfsm.runtime.engine.events import Event, Observer, Reason, Request, Status, Trace
from llfsm.runtime.engine.machine import Machine, define
from llfsm.runtime.engine.ports import KEEP, Actuator, Sensor
from llfsm.runtime.engine.schedule import Requirement, TimeSlot, Timetable
from llfsm.runtime.engine.state import State, Transition, Waiting
from llfsm.runtime.engine.statistics import MachineStatistics, Spread
from llfsm.runtime.engine.submachine import Submachine, Submachines
from llfsm.runtime.engine.table import REQUIRED, Table, Variable, variable
from llfsm.runtime.presence.live import LiveEnvironment


def _analysis(table: Table, state: State) -> Waiting:
    from llfsm.runtime.expressions.waiting import waiting_in  # here, as it costs much to import

    return waiting_in(table, state)


# An arrangement on a whiteboard is seen and controlled by other processes, and what its machines
# wait for is found in their texts. The engine knows neither.
Arrangement.live = LiveEnvironment
Arrangement.analysis = staticmethod(_analysis)

__all__ = [
    "KEEP",
    "REQUIRED",
    "Actuator",
    "ActuatorClosedError",
    "ActuatorTakenError",
    "Arrangement",
    "ArrangementEndedError",
    "BreakpointError",
    "BundleError",
    "Clock",
    "ClockError",
    "DefinitionError",
    "DrawingError",
    "Event",
    "ExecutionError",
    "FsmError",
    "GuardResultError",
    "KeepError",
    "LiveEnvironment",
    "LoadError",
    "Machine",
    "MachineStatistics",
    "ManualClock",
    "MonotonicClock",
    "NotLoadedError",
    "NotPausedError",
    "Observer",
    "ObserverError",
    "OptionError",
    "RealtimeError",
    "Reason",
    "Request",
    "Requirement",
    "ScheduleError",
    "Sensor",
    "SensorNameError",
    "SimulatedClock",
    "Spread",
    "State",
    "Status",
    "Submachine",
    "Submachines",
    "Table",
    "TimeSlot",
    "Timetable",
    "Trace",
    "Transition",
    "TypeCheckerError",
    "UnknownMachineError",
    "UnreachableStateWarning",
    "Variable",
    "VariableError",
    "define",
    "variable",
]
