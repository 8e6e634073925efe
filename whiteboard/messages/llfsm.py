"""Messages between llfsm's own processes: the status of machines, and requests to them."""

import re
from functools import lru_cache
from typing import Literal, TypeAlias
from zlib import crc32

from ..message import Message
from ..slots import Slot

__all__ = [
    "BELL",
    "COMMANDERS",
    "DEFINITIONS",
    "JOURNALS",
    "MACHINES",
    "MIRROR",
    "RECORDER",
    "REQUESTS",
    "VARIABLES",
    "VIEWER",
    "WILLS",
    "WILL_BELL",
    "Action",
    "Bell",
    "Commander",
    "Commanders",
    "DefinedBox",
    "DefinedSection",
    "DefinedState",
    "DefinedTransition",
    "JournalPart",
    "LastWill",
    "MachineDefinition",
    "MachineRequest",
    "MachineStatus",
    "MachineVariables",
    "MirrorStatus",
    "PeerStatus",
    "QuotaStatus",
    "Recorder",
    "Refusal",
    "SafeValue",
    "VariableValue",
    "Viewer",
    "commanders_slot",
    "definition_slot",
    "journal_slot",
    "request_slot",
    "status_slot",
    "variables_slot",
    "will_slot",
]

MACHINES = "llfsm/machine/"
DEFINITIONS = "llfsm/definition/"
VARIABLES = "llfsm/variables/"
REQUESTS = "llfsm/request/"
WILLS = "llfsm/will/"
COMMANDERS = "llfsm/commander/"
JOURNALS = "llfsm/journal/"
"""Slots that carry bytes from arrangements to a recorder; tools do not show or record them."""

_MAX_NAME = 230  # bytes of another name that fit into a slot's name

Action: TypeAlias = Literal["suspend", "resume", "restart", "stop"]


class MachineStatus(Message):
    """A machine's status: published when it changes, and at least four times a second.

    The machine entered `state` `in_state_s` seconds before the message's stamp, by transition
    number `transition` (from 0) of state `source`, which is empty if there was none. `entered_ns`
    is that time on the machine's clock, or 0 before its first ringlet in the state. `pending` is a
    request that takes effect at its next ringlet; `obeyed` is the count of the latest request
    seen. The process has id `pid` in PID namespace `namespace` of `host`, and started `born` clock
    ticks after boot.
    After its code has raised, the machine is `failed` until it is resumed or restarted: `error`
    describes it in one line, with section, file and line, `error_state` is the state whose code
    that was, and `error_s` is how many seconds before the message's stamp. While its code is
    `hung`, a watchdog publishes the status, and `error` is where that is. `realtime` is the
    priority at which it has its turns, or 0, and `cpu` the only core for them, or -1.
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
    failed: bool = False
    error: str = ""
    error_state: str = ""
    error_s: float = 0.0
    hung: bool = False
    namespace: int = 0
    realtime: int = 0
    cpu: int = -1


class MachineRequest(Message):
    """A request to a machine; a later one replaces an earlier one."""

    action: Action


class Bell(Message):
    """Notifies all arrangements on a board that there is a new request to a machine."""

    machine: str = ""


BELL = Slot("llfsm/bell", Bell)


class Commander(Message):
    """A machine that posts to a slot, and claims to be the only one if `exclusive`.

    It is run by process `pid` in PID namespace `namespace` of `host`, which started `born` clock
    ticks after boot; `number` distinguishes the claims of that process. Without a name, it is no
    machine, but that process, which was seen to post.
    """

    machine: str
    pid: int
    born: int
    host: str
    namespace: int
    number: int
    exclusive: bool = False


class Commanders(Message):
    """Who posts to `slot`, where machines do; a process that has died may have left its own."""

    slot: str
    commanders: tuple[Commander, ...] = ()


class DefinedSection(Message):
    """The source text of a state's section, such as OnEntry."""

    name: str
    text: str


class DefinedTransition(Message):
    """A transition; those of a state are in the order of their evaluation.

    `path` is the curve that an editor has drawn, if any: x and y of the start, the end and two
    control points.
    """

    target: str
    label: str
    path: tuple[float, ...] = ()


class DefinedBox(Message):
    """A state's box as drawn by an editor: centre and size; `expanded` shows the sections."""

    x: float
    y: float
    w: float
    h: float
    expanded: bool = False


class DefinedState(Message):
    """A state as declared; `sections` is empty if the source cannot be read."""

    name: str
    sections: tuple[DefinedSection, ...] = ()
    transitions: tuple[DefinedTransition, ...] = ()
    box: DefinedBox | None = None


class MachineDefinition(Message):
    """A machine's states and transitions, for tools that draw it; the first state is initial."""

    path: str
    states: tuple[DefinedState, ...]
    suspend: str = ""


class VariableValue(Message, type_name="Variable"):
    """A machine's variable; a value that is neither a number nor a text is described by a text."""

    name: str
    value: bool | int | float | str | None


class MachineVariables(Message):
    """A machine's variables between two ringlets; published ten times a second for a viewer."""

    variables: tuple[VariableValue, ...]


class SafeValue(Message):
    """An encoded message, and the slot to which it is posted."""

    slot: str
    data: bytes


class LastWill(Message):
    """What guards post if the process of a machine dies without an end.

    The machine runs in process `pid` of `host`, which started `born` clock ticks after boot and
    whose id is one of the PID namespace `namespace`. If that publishes no status for `silent_ms`,
    it counts as dead; with 0, it never does so long as it exists. A will that was "executed" was
    so by process `executor`.
    """

    pid: int
    born: int
    host: str
    namespace: int
    values: tuple[SafeValue, ...]
    silent_ms: int = 0
    state: Literal["left", "withdrawn", "executed"] = "left"
    executor: int = 0


WILL_BELL = Slot("llfsm/wills", Bell)
"""Notifies guards that a machine has left a last will."""


class Viewer(Message):
    """Requests that variables be published for the next two seconds, for viewer process `pid`."""

    pid: int


VIEWER = Slot("llfsm/viewer", Viewer)


class Recorder(Message):
    """The recorder: process `pid`, started `born` clock ticks after boot; 0 if there is none.

    `taken` holds, for each journal slot by its number, the count up to which it was read.
    """

    pid: int = 0
    born: int = 0
    taken: tuple[int, ...] = ()


RECORDER = Slot("llfsm/recorder", Recorder)


class JournalPart(Message):
    """A part of an arrangement's journal, on its way to the recorder.

    Process `pid`, started `born` clock ticks after boot, began this journal at `session`,
    nanoseconds of the host's monotonic clock; `whole` if that was before its machines ran. Parts
    are numbered from 0; a missing number means lost data. `over` marks the last part.
    """

    pid: int
    born: int
    session: int
    whole: bool
    number: int
    over: bool = False
    data: bytes = b""


class PeerStatus(Message):
    """Another host, as seen by the daemon of a board."""

    name: str
    host: str
    silent_s: float
    lag_ms: float  # from sending a batch to receiving it; as accurate as the clocks
    received: int  # batches
    lost: int  # batches that did not arrive
    certificate: str = ""  # the name in it, if that is known


class QuotaStatus(Message):
    """What a host has taken of its quota, since the daemon started."""

    name: str  # in its certificate; empty for all hosts that share a quota
    slots: int  # that it has made here
    max_slots: int
    bytes: int  # of shared memory for them
    max_bytes: int
    over_rate: int  # messages of the network that were dropped


class Refusal(Message):
    """A kind of message or connection that was refused, and how often."""

    what: str
    count: int


class MirrorStatus(Message):
    """The status of the daemon that mirrors a board, published once a second.

    Rates are in slots per second since the previous status. A conflict is a message from another
    host that arrived after a newer one of the same slot.
    """

    host: str = ""
    pid: int = 0
    slots: int = 0
    left: int = 0
    entered: int = 0
    leave_rate: float = 0.0
    enter_rate: float = 0.0
    conflicts: int = 0
    held_back: int = 0  # messages of slots that arrive too often; the newest enters later
    peers: tuple[PeerStatus, ...] = ()
    quotas: tuple[QuotaStatus, ...] = ()
    refused: tuple[Refusal, ...] = ()
    partition_s: float = 3.0  # a host that was silent for so long counts as dead


MIRROR = Slot("llfsm/mirror", MirrorStatus, capacity=1 << 16)


@lru_cache(maxsize=4096)  # each new Slot object would be bound anew
def status_slot(machine: str) -> Slot[MachineStatus]:
    """Return the slot for a machine's status."""
    return Slot(MACHINES + _legal(machine), MachineStatus)


@lru_cache(maxsize=4096)
def request_slot(machine: str) -> Slot[MachineRequest]:
    """Return the slot for requests to a machine."""
    return Slot(REQUESTS + _legal(machine), MachineRequest)


@lru_cache(maxsize=4096)
def commanders_slot(slot: str) -> Slot[Commanders]:
    """Return the slot for the machines that post to a slot."""
    return Slot(COMMANDERS + _legal(slot), Commanders, 4 << 10)


@lru_cache(maxsize=4096)
def definition_slot(machine: str) -> Slot[MachineDefinition]:
    """Return the slot for a machine's definition."""
    return Slot(DEFINITIONS + _legal(machine), MachineDefinition, 32 << 10)


@lru_cache(maxsize=4096)
def variables_slot(machine: str) -> Slot[MachineVariables]:
    """Return the slot for a machine's variables."""
    return Slot(VARIABLES + _legal(machine), MachineVariables, 16 << 10)


@lru_cache(maxsize=4096)
def will_slot(machine: str) -> Slot[LastWill]:
    """Return the slot for a machine's last will."""
    return Slot(WILLS + _legal(machine), LastWill, 8 << 10)


@lru_cache(maxsize=4096)
def journal_slot(number: int) -> Slot[JournalPart]:
    """Return the slot for the journal of that number."""
    return Slot(f"{JOURNALS}{number}", JournalPart, 128 << 10)


def _legal(name: str) -> str:
    """Return the name of a machine or slot in a form that is valid in another slot's name."""
    visible = re.sub(r"[\s\x00-\x1f\x7f]", "_", name).encode("utf-8", "replace")
    if len(visible) > _MAX_NAME:  # a checksum keeps the names distinct
        visible = visible[: _MAX_NAME - 9] + b"~%08x" % crc32(visible)
    return visible.decode("utf-8", "ignore")
