"""What llfsm's own processes tell each other on a whiteboard: how machines are, and requests."""

import re
from functools import lru_cache
from typing import Literal, TypeAlias
from zlib import crc32

from ..message import Message
from ..slots import Slot

__all__ = [
    "BELL",
    "DEFINITIONS",
    "JOURNALS",
    "MACHINES",
    "MIRROR",
    "RECORDER",
    "REQUESTS",
    "VARIABLES",
    "VIEWER",
    "Action",
    "Bell",
    "DefinedBox",
    "DefinedSection",
    "DefinedState",
    "DefinedTransition",
    "JournalPart",
    "MachineDefinition",
    "MachineRequest",
    "MachineStatus",
    "MachineVariables",
    "MirrorStatus",
    "PeerStatus",
    "Recorder",
    "Refusal",
    "Variable",
    "Viewer",
    "definition_slot",
    "journal_slot",
    "request_slot",
    "status_slot",
    "variables_slot",
]

MACHINES = "llfsm/machine/"
DEFINITIONS = "llfsm/definition/"
VARIABLES = "llfsm/variables/"
REQUESTS = "llfsm/request/"
JOURNALS = "llfsm/journal/"
"""Slots that carry bytes from arrangements to a recorder, and are nothing to be shown or kept."""

_LONGEST = 230  # bytes of a machine's name that a slot's has room for

Action: TypeAlias = Literal["suspend", "resume", "restart", "stop"]


class MachineStatus(Message):
    """How a machine is: posted when that changes, and four times a second all the same.

    `state` since `in_state_s` seconds before the message's stamp; `pending` is a request that
    takes effect at its next turn; `obeyed` is the count of the latest request seen. It has come
    there by number `transition` (from 0) of state `source`, if by any; `entered_ns` is when on its
    own clock, or 0 before its turn there. The process is number `pid` of `host`, started `born`
    clock ticks after that came up.
    """

    state: str = ""
    suspended: bool = False
    loaded: bool = True
    pending: str = ""
    ringlets: int = 0
    overruns: int = 0
    in_state_s: float = 0.0
    source: str = ""
    transition: int = 0
    entered_ns: int = 0
    obeyed: int = 0
    pid: int = 0
    born: int = 0
    host: str = ""


class MachineRequest(Message):
    """Ask something of a machine; a later request takes an earlier one's place."""

    action: Action


class Bell(Message):
    """Tell all arrangements on a board that one of their machines is asked for something."""

    machine: str = ""


BELL = Slot("llfsm/bell", Bell)


class DefinedSection(Message):
    """The source text of a state's section, as OnEntry."""

    name: str
    text: str


class DefinedTransition(Message):
    """A transition: its place among those of its state is when it is evaluated.

    `path` is where an editor has drawn it, if one has: x and y of start, end and two controls.
    """

    target: str
    label: str
    path: tuple[float, ...] = ()


class DefinedBox(Message):
    """Where an editor has drawn a state: its centre and its size; `expanded` shows sections."""

    x: float
    y: float
    w: float
    h: float
    expanded: bool = False


class DefinedState(Message):
    """A state as declared; `sections` are empty where no source can be read."""

    name: str
    sections: tuple[DefinedSection, ...] = ()
    transitions: tuple[DefinedTransition, ...] = ()
    box: DefinedBox | None = None


class MachineDefinition(Message):
    """What a machine consists of, for those who draw it; the first state is the initial one."""

    path: str
    states: tuple[DefinedState, ...]
    suspend: str = ""


class Variable(Message):
    """A machine's variable; what is neither number nor text is a text that describes it."""

    name: str
    value: bool | int | float | str | None


class MachineVariables(Message):
    """A machine's variables between two ringlets; posted ten times a second, if somebody looks."""

    variables: tuple[Variable, ...]


class Viewer(Message):
    """Tell that process `pid` looks at the machines' variables, for the next two seconds."""

    pid: int


VIEWER = Slot("llfsm/viewer", Viewer)


class Recorder(Message):
    """Tell that process `pid`, started `born`, records what machines do; 0 that nobody does.

    `taken` are the counts up to which it has taken the slots of journals, by their numbers.
    """

    pid: int = 0
    born: int = 0
    taken: tuple[int, ...] = ()


RECORDER = Slot("llfsm/recorder", Recorder)


class JournalPart(Message):
    """A part of an arrangement's journal on its way to the recorder.

    Process `pid`, started `born`, has begun this journal at `session`, nanoseconds of the host's
    monotonic clock; `whole` if that was before its machines did anything. Part `number` 0 opens it;
    if a number is left out, what it held is lost. With `over` there are no more.
    """

    pid: int
    born: int
    session: int
    whole: bool
    number: int
    over: bool = False
    data: bytes = b""


class PeerStatus(Message):
    """Another host, as the daemon of a board sees it."""

    name: str
    host: str
    silent_s: float
    lag_ms: float  # from its sending a batch to our having it; as wrong as the clocks
    received: int  # batches
    lost: int  # batches that did not arrive


class Refusal(Message):
    """Something that did not enter the board, and how often."""

    what: str
    count: int


class MirrorStatus(Message):
    """How the daemon that mirrors a board is, once a second.

    Rates are slots a second since the last status. A conflict is a message that came from another
    host after a newer one of a third or of this host.
    """

    host: str = ""
    pid: int = 0
    slots: int = 0
    left: int = 0
    entered: int = 0
    leave_rate: float = 0.0
    enter_rate: float = 0.0
    conflicts: int = 0
    held_back: int = 0  # messages of slots that come too often, of which the newest enters later
    peers: tuple[PeerStatus, ...] = ()
    refused: tuple[Refusal, ...] = ()


MIRROR = Slot("llfsm/mirror", MirrorStatus, capacity=1 << 16)


@lru_cache(maxsize=4096)  # a slot of its own each time would be bound each time
def status_slot(machine: str) -> Slot[MachineStatus]:
    """Return the slot on which the machine of that name is told of."""
    return Slot(MACHINES + _legal(machine), MachineStatus)


@lru_cache(maxsize=4096)
def request_slot(machine: str) -> Slot[MachineRequest]:
    """Return the slot on which the machine of that name is asked for something."""
    return Slot(REQUESTS + _legal(machine), MachineRequest)


@lru_cache(maxsize=4096)
def definition_slot(machine: str) -> Slot[MachineDefinition]:
    """Return the slot on which it stands what a machine consists of."""
    return Slot(DEFINITIONS + _legal(machine), MachineDefinition, 32 << 10)


@lru_cache(maxsize=4096)
def variables_slot(machine: str) -> Slot[MachineVariables]:
    """Return the slot on which a machine's variables are told."""
    return Slot(VARIABLES + _legal(machine), MachineVariables, 16 << 10)


@lru_cache(maxsize=4096)
def journal_slot(number: int) -> Slot[JournalPart]:
    """Return the slot that carries the journal of that number."""
    return Slot(f"{JOURNALS}{number}", JournalPart, 128 << 10)


def _legal(machine: str) -> str:
    """Return what can be part of a slot's name, whatever a machine is called."""
    visible = re.sub(r"[\s\x00-\x1f\x7f]", "_", machine).encode("utf-8", "replace")
    if len(visible) > _LONGEST:  # what is cut off still tells it from others
        visible = visible[: _LONGEST - 9] + b"~%08x" % crc32(visible)
    return visible.decode("utf-8", "ignore")
