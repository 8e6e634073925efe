"""Messages between llfsm's own processes, and the slots in which they are.

All are under ``llfsm/``, most in a folder for each kind: ``llfsm/machine/Wall`` has the status of
the machine `Wall`. In order: machines and requests to them; debugging; commanders and last wills;
recording; the daemon that mirrors a board; other hosts of a fleet.

A process is named by its id, its start, its host and its PID namespace (see :mod:`.liveness`). Ages
are seconds before a message's stamp, so that they mean the same on a host with another clock.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal, Self, TypeAlias

from llfsm.whiteboard.message import M, Message
from llfsm.whiteboard.slot_names import legal_name
from llfsm.whiteboard.slots import DEFAULT_CAPACITY, Slot

_LARGE = 1 << 16  # bytes: the capacity of slots about many hosts


def _slots(
    folder: str, kind: type[M], capacity: int = DEFAULT_CAPACITY
) -> Callable[[str], Slot[M]]:
    """Make the function that gives the slot in `folder` for the machine, or slot, of a name."""

    @lru_cache(maxsize=128)  # making a slot takes its time
    def slot(name: str) -> Slot[M]:
        return Slot(folder + legal_name(name), kind, capacity)

    return slot


# ---- Machines -------------------------------------------------------------------------------

MACHINES = "llfsm/machine/"
REQUESTS = "llfsm/request/"
DEFINITIONS = "llfsm/definition/"
VARIABLES = "llfsm/variables/"

Debugging: TypeAlias = Literal[
    "pause", "renew", "step", "continue", "break", "clear", "override", "release"
]
Action: TypeAlias = Literal["suspend", "resume", "restart", "reload", "stop"] | Debugging


class OverriddenSensor(Message):
    """A sensor that finds a message which a debugger has given it, in place of the slot's.

    It ends `left_s` seconds after the message's stamp, unless it is renewed; without a time, only
    when the sensor is released.
    """

    sensor: str
    left_s: float | None = None


class MachineStatus(Message):
    """A machine's status: published when it changes, and at least four times a second.

    The machine entered `state` `in_state_s` seconds before the message's stamp, by transition
    number `transition` (from 0) of state `source`, which is empty if there was none. `entered_ns`
    is that time on the machine's clock, or 0 before its first ringlet in the state. `pending` is a
    request that takes effect at its next ringlet; `obeyed` is the count of the latest request seen.
    The process has id `pid` in PID namespace `namespace` of `host`, and started `born` clock ticks
    after boot. After its code has raised, the machine is `failed` until it is resumed or restarted:
    `error` describes that in one line, with section, file and line, `error_state` is the state of
    that code, and `error_s` the seconds from then to the message's stamp. While its code is `hung`,
    a watchdog publishes the status, and `error` is the place in the code. `realtime` is the
    priority at which it has its turns, or 0, and `cpu` the only core for them, or -1. While a
    debugger has paused the machines of its process, `paused` is the reason; they go on
    `paused_left_s` seconds after the message's stamp, unless that is renewed, without a time only
    when they are continued. Meanwhile the states' `clock` runs on, stands still, or is a
    simulation's. `caller` is the machine that has called this one as a submachine, while that is
    loaded; `refusal` is the reason why it was not
    reloaded; `waits` is what it waits for in its state, in words, or empty while it is polled.
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
    paused: str = ""
    overridden: tuple[OverriddenSensor, ...] = ()
    caller: str = ""
    refusal: str = ""
    paused_left_s: float | None = None
    clock: Literal["runs", "stands", "simulated"] = "runs"
    waits: str = ""


class MachineRequest(Message):
    """A request to a machine; a later one replaces an earlier one.

    A "reload" restarts it from the current version of its bundle. Those from "pause" to "clear"
    are for all machines of its process. A pause by "pause", "step" or a breakpoint, and an
    "override", last for `lease_s` seconds; "renew" lets them last so long from then on. `argument`
    is the kind of step, the breakpoint to add by "break" or to remove by "clear", the sensor to
    "release", or the one to "override", then a space and the message for it in JSON.
    """

    action: Action
    argument: str = ""
    lease_s: float = 0.0


class Bell(Message):
    """Notifies all arrangements on a board that there is a new request to a machine."""

    machine: str = ""


BELL = Slot("llfsm/bell", Bell)


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


class InnerDefinition(Message):
    """A machine that a state of another one may run, of that `number` of those that it runs.

    `name` is without that of the outermost one, as in ``Drive/Wheel``, which a `state` of ``Drive``
    runs.
    """

    name: str
    state: str
    number: int
    path: str
    states: tuple[DefinedState, ...]
    suspend: str = ""


class MachineDefinition(Message):
    """A machine's states and transitions, for tools that draw it; the first state is initial.

    `inner` are those that its states run, as far as they are known, each after its outer one.
    """

    path: str
    states: tuple[DefinedState, ...]
    suspend: str = ""
    inner: tuple[InnerDefinition, ...] = ()


class VariableValue(Message, type_name="Variable"):
    """A variable or sensor; a value that is neither a number nor a text is described by a text."""

    name: str
    value: bool | int | float | str | None


class MachineVariables(Message):
    """A machine's variables between two ringlets; published ten times a second for a viewer.

    Sensors have the values of the machine's last snapshot.
    """

    variables: tuple[VariableValue, ...]
    sensors: tuple[VariableValue, ...] = ()


status_slot = _slots(MACHINES, MachineStatus)
"""The slot for a machine's status."""
request_slot = _slots(REQUESTS, MachineRequest)
"""The slot for requests to a machine."""
definition_slot = _slots(DEFINITIONS, MachineDefinition, 32 << 10)
"""The slot for a machine's definition."""
variables_slot = _slots(VARIABLES, MachineVariables, 16 << 10)
"""The slot for a machine's variables."""

# ---- Debugging ------------------------------------------------------------------------------

WHYS = "llfsm/why/"


class Viewer(Message):
    """Requests :class:`MachineVariables` for two seconds, with `why` :class:`MachineWhy`, too.

    Process `pid` shows them.
    """

    pid: int
    why: bool = False


VIEWER = Slot("llfsm/viewer", Viewer)


class SeenTransition(Message):
    """A transition as it was evaluated, or would be; no value if that takes a call with effects.

    `seen` is its expression with the values of its parts, or "not evaluated" if an earlier one has
    fired or raised.
    """

    target: str
    label: str
    value: bool | None
    seen: str


class MachineWhy(Message):
    """The transitions that keep a machine in `state`, for `llfsm why`; published for a viewer.

    They are as they were evaluated `evaluated_s` seconds before the message's stamp, by the
    machine's clock; without a time, as they would be then, on the last snapshot. While paused
    where a transition has fired, from `source`, `before` are those of that state; if the machine
    has `failed` there, it is the state whose code has raised. The `breakpoints` are those of all
    machines of its process; `problem` is the reason why the last request was refused, or empty.
    """

    state: str
    transitions: tuple[SeenTransition, ...]
    source: str = ""
    before: tuple[SeenTransition, ...] = ()
    breakpoints: tuple[str, ...] = ()
    problem: str = ""
    evaluated_s: float | None = None
    failed: bool = False


def viewer_slot(host: str = "") -> Slot[Viewer]:
    """Return the slot for viewers of a host's machines; by default of this one."""
    return Slot(f"{VIEWER.name}/{host}/", Viewer) if host else VIEWER


why_slot = _slots(WHYS, MachineWhy, 16 << 10)
"""The slot for why a machine is in its state."""

# ---- Commanders and last wills --------------------------------------------------------------

COMMANDERS = "llfsm/commander/"
WILLS = "llfsm/will/"


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
    """The machines that post to `slot`; a process that has died may have left its own here."""

    slot: str
    commanders: tuple[Commander, ...] = ()


class SafeValue(Message):
    """An encoded message, and the slot to which it is posted."""

    slot: str
    data: bytes


class LastWill(Message):
    """The messages that guards post if the process of a machine dies without shutting down.

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


class StandIn(Message):
    """The message number `count` of a slot: it stands in for one of a machine of another host."""

    slot: str
    count: int
    machine: str


class StandIns(Message):
    """The messages that guards have posted for machines of hosts from which nothing arrives."""

    noted: tuple[StandIn, ...] = ()


STAND_INS = Slot("llfsm/stand_ins", StandIns, capacity=64 << 10)
"""The stand-ins of this board, for its daemon: they do not leave."""


class WillExecution(Message):
    """The report of a guard that has executed a last will on the board of its host alone.

    The machine's process is the one of the will, as in `LastWill`. The guard is process `executor`
    of host `executor_host`.
    """

    pid: int
    born: int
    host: str
    namespace: int
    executor: int
    executor_host: str


commanders_slot = _slots(COMMANDERS, Commanders, 4 << 10)
"""The slot for the machines that post to a slot."""
will_slot = _slots(WILLS, LastWill, 8 << 10)
"""The slot for a machine's last will."""
execution_slot = _slots("llfsm/executed/", WillExecution, 1 << 10)
"""The slot in which guards of other hosts report that they have executed a machine's last will."""

# ---- Recording ------------------------------------------------------------------------------

JOURNALS = "llfsm/journal/"
"""Slots that carry bytes from arrangements to a recorder; tools do not show or record them."""


class Recorder(Message):
    """The recorder: published when it has taken a part, and at least four times a second.

    It is process `pid` in PID namespace `namespace` of `host`, started `born` clock ticks after
    boot; 0 if there is none. `taken` holds, for each journal slot by its number, the count up to
    which it was read.
    """

    pid: int = 0
    born: int = 0
    host: str = ""
    namespace: int = 0
    taken: tuple[int, ...] = ()


RECORDER = Slot("llfsm/recorder", Recorder)


class JournalPart(Message):
    """A part of an arrangement's journal, on its way to the recorder.

    Process `pid` in PID namespace `namespace` of `host`, started `born` clock ticks after boot,
    began this journal at `session`, nanoseconds of the host's monotonic clock; `whole` if that was
    before its machines ran. Parts are numbered from 0; a missing number means lost data. `over`
    marks the last part. One without data shows that the process lives.
    """

    pid: int
    born: int
    host: str
    namespace: int
    session: int
    whole: bool
    number: int
    over: bool = False
    data: bytes = b""


@lru_cache(maxsize=128)
def journal_slot(number: int) -> Slot[JournalPart]:
    """Return the slot for the journal of that number."""
    return Slot(f"{JOURNALS}{number}", JournalPart, 128 << 10)


# ---- The daemon that mirrors a board --------------------------------------------------------


class PeerStatus(Message):
    """Another host, as the daemon of a board knows it."""

    name: str
    host: str
    silent_s: float
    lag_ms: float  # from sending a batch to receiving it; as accurate as the clocks
    received: int  # batches
    lost: int  # batches that did not arrive
    certificate: str = ""  # the name in it, if that is known


class QuotaStatus(Message):
    """The part of its quota that a host has taken since the daemon started."""

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

    Rates are per second since the previous status, of messages of slots or of bytes. A conflict is
    a message from another host that arrived after a newer one of the same slot. This is the one
    list of metrics: :meth:`.Exchange.status` fills it, and the text of `llfsm whiteboard status`,
    its JSON, and the summary on the page of all hosts are made from it.
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
    name: str = ""  # of the host; empty if it has none
    fleet: tuple[str, ...] = ()  # globs of the others' names
    sent_rate: float = 0.0  # bytes; a batch counts once, however many hosts read it
    received_rate: float = 0.0

    def text(self) -> str:
        """Write the status for people: a line for each metric, peer, quota and refusal."""
        lines = [
            f"mirrored by process {self.pid}, host {self.host}"
            + (f", as {self.name}" if self.name else ""),
            f"slots      {self.slots} may leave",
            f"left       {self.left}, {self.leave_rate:g} a second",
            f"entered    {self.entered}, {self.enter_rate:g} a second",
            f"traffic    {self.sent_rate / 1000:.1f} kB/s out, {self.received_rate / 1000:.1f} in",
            f"conflicts  {self.conflicts}",
            f"held back  {self.held_back}",
        ]
        for peer in self.peers:
            last = f", the last {peer.silent_s:.1f} s ago" if peer.silent_s > 1 else ""
            certified = f", certificate {peer.certificate}" if peer.certificate else ""
            lines.append(
                f"peer       {peer.host} {peer.name}{certified}: lag {peer.lag_ms:.1f} ms, "
                f"{peer.received} batches{last}, {peer.lost} lost"
            )
        for quota in self.quotas:
            lines.append(
                f"quota      {quota.name or 'other hosts'}: {quota.slots} of {quota.max_slots} "
                f"slots, {quota.bytes >> 20} of {quota.max_bytes >> 20} MiB, {quota.over_rate} "
                f"over the rate"
            )
        lines += [f"refused    {refusal.count} x {refusal.what}" for refusal in self.refused]
        return "\n".join(lines)


MIRROR = Slot("llfsm/mirror", MirrorStatus, capacity=_LARGE)


# ---- Other hosts of a fleet -----------------------------------------------------------------

SUMMARIES = "llfsm/summary"
"""The slot of a host's summary on that host, and the folder of others'."""


class Hosts(Message):
    """The names of the hosts that can be reached; kept up to date while a process reads it."""

    names: tuple[str, ...] = ()


HOSTS = Slot("llfsm/hosts", Hosts, capacity=_LARGE)


class Folders(Message):
    """The folders of a named host's own slots, by their names for other hosts."""

    folders: tuple[str, ...] = ()


class MachineTrouble(Message):
    """A machine that does not do its work: its `condition`, as in `llfsm ps`, and the error."""

    machine: str
    condition: str
    error: str = ""


class HostHeard(Message):
    """Another host, as a host hears it; what is not listed, it has never heard."""

    host: str  # its id
    name: str  # in its network
    silent_s: float
    lag_ms: float
    lost: int


class HostSummary(Message):
    """A named host in a few lines, for others that look at the fleet; published once a second.

    Fields of the same name are its daemon's, from :class:`MirrorStatus`.
    """

    system: str = ""  # the host's name in its network
    sent_ns: int = 0  # since 1970, by its clock
    leave_rate: float = 0.0
    enter_rate: float = 0.0
    sent_rate: float = 0.0
    received_rate: float = 0.0
    refused: int = 0  # messages and connections, since its daemon started
    machines: int = 0
    troubled: int = 0  # how many of these are in trouble
    troubles: tuple[MachineTrouble, ...] = ()  # of the first of these
    host: str = ""  # its id
    hears: tuple[HostHeard, ...] = ()

    @classmethod
    def of(cls, status: MirrorStatus, **of_host: Any) -> Self:
        """Sum up a daemon's status, with `of_host` for the fields that are not in it."""
        shared = {*cls.__struct_fields__} & {*MirrorStatus.__struct_fields__}
        metrics = {name: getattr(status, name) for name in shared}
        metrics["refused"] = sum(each.count for each in status.refused)
        fields = HostHeard.__struct_fields__
        metrics["hears"] = tuple(
            HostHeard(**{name: getattr(peer, name) for name in fields}) for peer in status.peers
        )
        return cls(**metrics, **of_host)


def folders_slot(host: str = "") -> Slot[Folders]:
    """Return the slot for the folders of a host; by default of this one, if it has a name."""
    return Slot(f"llfsm/folders/{host}/" if host else "llfsm/folders", Folders, _LARGE)


def summary_slot(host: str = "") -> Slot[HostSummary]:
    """Return the slot for the summary of a host; by default of this one, if it has a name."""
    return Slot(f"{SUMMARIES}/{host}/" if host else SUMMARIES, HostSummary, _LARGE)
