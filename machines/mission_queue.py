"""A queue of missions: any process asks for one by name, and one after the other is run.

Who asks posts a `MissionRequest` with an id of its own, and finds a `MissionAnswer` with that id:
the mission was accepted, or why it was not. `CancelMission` takes it back, while it waits and while
it runs. `MissionStanding` is what goes on. A slot has the newest message only, so who asks waits
for the answer, and asks again if the request of another one came in between.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any

from llfsm.runtime import Actuator, DefinitionError, Machine, Sensor, State
from llfsm.runtime.engine.machine import define
from llfsm.runtime.engine.state import Runs
from llfsm.whiteboard import Message, Slot

__all__ = [
    "MISSION_ANSWER",
    "MISSION_CANCEL",
    "MISSION_REQUEST",
    "MISSION_STANDING",
    "CancelMission",
    "MissionAnswer",
    "MissionEnd",
    "MissionQueue",
    "MissionRequest",
    "MissionStanding",
]


class MissionRequest(Message, type_name="llfsm/MissionRequest"):
    """Ask for a mission by its name; `id` is new for each request, such as a UUID."""

    id: str = ""
    mission: str = ""


class MissionAnswer(Message, type_name="llfsm/MissionAnswer"):
    """The answer to the request with that id: its place in the queue, or why it was refused."""

    id: str = ""
    accepted: bool = False
    place: int = 0
    reason: str = ""


class CancelMission(Message, type_name="llfsm/CancelMission"):
    """Cancel the mission that was asked for with that id."""

    id: str = ""


class MissionEnd(IntEnum):
    """The end of a mission."""

    NONE = 0
    DONE = 1
    FAILED = 2
    CANCELED = 3


class MissionStanding(Message, type_name="llfsm/MissionStanding"):
    """The mission that runs, by name and id, the ids that wait, and the end of the last one."""

    mission: str = ""
    id: str = ""
    waiting: tuple[str, ...] = ()
    ended: str = ""
    end: MissionEnd = MissionEnd.NONE
    reason: str = ""


MISSION_REQUEST = Slot("missions/request", MissionRequest)
MISSION_ANSWER = Slot("missions/answer", MissionAnswer)
MISSION_CANCEL = Slot("missions/cancel", CancelMission)
MISSION_STANDING = Slot("missions/standing", MissionStanding)


def MissionQueue(  # noqa: N802  # makes classes
    *, capacity: int = 10, name: str = "MissionQueue", **missions: Runs
) -> type[Machine]:
    """Make a machine that runs missions, each in a state of its own, as others ask for them.

    `missions` are what states run, by the names under which they are asked for. At most `capacity`
    wait; a request is refused if that many do, or if there is no such mission. Requests from before
    it began do not count. A mission that fails is reported, and the next one begins. It goes on
    after a suspension; a restart and a stop cancel the one that runs.
    """
    if not missions:
        raise DefinitionError(f"{name}: give it missions, as round=Patrol")
    if capacity < 1:
        raise DefinitionError(f"{name}: capacity is {capacity!r}; it must be 1 or more")
    idle, done, failed, canceled, end = (
        State(each) for each in ("IDLE", "DONE", "FAILED", "CANCELED", "END")
    )
    runs: dict[str, State] = {
        each: State(f"RUN_{each.upper()}", runs=run) for each, run in missions.items()
    }
    idle.on_entry(_restart)
    idle.to(end, when=_is_stopping, label="stopping")
    for mission, state in runs.items():
        idle.to(state, when=_is_next(mission), label=f"{mission} is next")
        state.to(end, when=_is_stopping, label="stopping")
        state.to(canceled, when=lambda self: self.cancel.id == self.id, label="canceled")
        state.to(done, when_done=True)
        state.to(failed, when_failed=True)
        state.on_entry(_begin)
        state.internal(_look)
    idle.internal(_look)
    for state, how in ((done, MissionEnd.DONE), (canceled, MissionEnd.CANCELED)):
        state.on_entry(_ending(how))
        state.to(idle)

    @failed.on_entry
    def fail(self: Any) -> None:
        error = getattr(self, f"run_{self.mission}").error
        _end(self, MissionEnd.FAILED, "it was unloaded" if error is None else str(error))

    failed.to(idle)

    @end.on_entry
    def stop(self: Any) -> None:
        if self.id:
            _end(self, MissionEnd.CANCELED, "the queue stops")

    attributes: dict[str, Any] = {
        "request": Sensor(MISSION_REQUEST, default=MissionRequest(), since_start=True),
        "cancel": Sensor(MISSION_CANCEL, default=CancelMission(), since_start=True),
        "answer": Actuator(MISSION_ANSWER),
        "stand": Actuator(MISSION_STANDING, at_end=MissionStanding()),
        "MISSIONS": tuple(missions),
        "CAPACITY": capacity,
    }
    attributes |= {f"run_{mission}": state for mission, state in runs.items()}
    variables: dict[str, tuple[Any, Any]] = {
        "waiting": (tuple[tuple[str, str], ...], ()),  # the id and the name of each
        "answered": (str, ""),  # the id of the last request
        "id": (str, ""),  # of the mission that runs
        "mission": (str, ""),
    }
    states = [idle, *runs.values(), done, failed, canceled, end]
    path = f"{__name__}:{name}({', '.join(missions)})"
    return define(name, states, variables=variables, attributes=attributes, path=path)


def _is_stopping(self: Any) -> bool:
    return bool(self.stopping)


def _is_next(mission: str) -> Callable[[Any], bool]:
    def is_next(self: Any) -> bool:
        return bool(self.waiting) and self.waiting[0][1] == mission

    return is_next


def _restart(self: Any) -> None:
    if self.id:
        _end(self, MissionEnd.CANCELED, "the queue was restarted")


def _begin(self: Any) -> None:
    if not self.id:  # else it goes on after a suspension
        (self.id, self.mission), *later = self.waiting
        self.waiting = tuple(later)
    self.stand(MissionStanding(self.mission, self.id, _ids(self)))


def _ending(how: MissionEnd) -> Callable[[Any], None]:
    return lambda self: _end(self, how)


def _end(self: Any, how: MissionEnd, reason: str = "") -> None:
    ended, self.id, self.mission = self.id, "", ""
    self.stand(MissionStanding("", "", _ids(self), ended, how, reason))


def _look(self: Any) -> None:
    """Answer a request that is new, and take back what waits and is canceled."""
    request, waiting = self.request, self.waiting
    if request.id and request.id != self.answered:
        self.answered = request.id
        reason = ""
        if request.mission not in self.MISSIONS:
            reason = f"no mission {request.mission!r}; there are: {', '.join(self.MISSIONS)}"
        elif len(waiting) >= self.CAPACITY:
            reason = f"{self.CAPACITY} missions wait already"
        elif request.id in (self.id, *_ids(self)):
            reason = "a mission with this id runs or waits: each request needs an id of its own"
        else:
            waiting += ((request.id, request.mission),)
        self.answer(MissionAnswer(request.id, not reason, 0 if reason else len(waiting), reason))
    kept = tuple(each for each in waiting if each[0] != self.cancel.id)
    taken_back, self.waiting = len(kept) < len(waiting), kept
    if taken_back:
        self.stand(
            MissionStanding(self.mission, self.id, _ids(self), self.cancel.id, MissionEnd.CANCELED)
        )


def _ids(self: Any) -> tuple[str, ...]:
    return tuple(each for each, _ in self.waiting)
