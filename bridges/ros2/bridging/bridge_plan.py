"""Resolves a configuration to slots, topics and types, or lists its errors and their places.

All errors are found at once: each value is resolved under its place in the configuration, an error
is noted there, and what depends on a value that is missing is left out. Relations between relays
are checked last. A cycle of relays would pass a message on for ever; one relay in both directions
is none, as it does not take back what it has brought.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from llfsm.bridges.ros2.bridging._turtle_position import NODE, SERVICE, TYPE
from llfsm.bridges.ros2.bridging.bridge_config import (
    ActionConfig,
    BridgeConfig,
    KeyPath,
    RelayConfig,
    ServiceConfig,
)
from llfsm.bridges.ros2.bridging.service_slots import (
    action_slots,
    capacity_for,
    capacity_note,
    capacity_warning,
    service_slots,
)
from llfsm.bridges.ros2.errors import CdrError, KeyPathError, RosNameError, RosTypeError
from llfsm.bridges.ros2.graph import Names
from llfsm.bridges.ros2.qos import DurabilityPolicy, LivelinessPolicy, Qos, ReliabilityPolicy
from llfsm.bridges.ros2.ros_arguments import RosArguments
from llfsm.bridges.ros2.types import RosMessage, RosService, TypeLibrary
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.whiteboard import Message, Slot, SlotTypeError, WhiteboardError
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.message_text import parse_message
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST
from llfsm.whiteboard.messages.turtlesim import Pose
from llfsm.whiteboard.schema import fingerprint

_Where = tuple[str, int]
_KEYED_DEPTH = 100  # as tf2's listeners: many publishers send at once
C = TypeVar("C")
P = TypeVar("P")


class RelayPlan(NamedTuple):
    """A resolved relay."""

    slot: Slot[Any]
    name: str
    """The topic's name in the configuration."""
    topic: str
    """Its full name, remapped."""
    of: RosMessage[Any]
    to_ros: Qos | None
    """None: not relayed in that direction."""
    from_ros: Qos | None
    period: float
    """Seconds; 0: no limit."""
    keys: KeyPath | None = None
    """If given, there is a slot of that type for each key, and ``slot`` names their prefix."""
    at_loss: Message | None = None
    """The message to post on the slot when the process dies that posted the latest one."""


class ServicePlan(NamedTuple):
    """A resolved service or action through slots."""

    slots: Any
    """:class:`.ServiceSlots` or :class:`.ActionSlots`."""
    name: str
    """The name in the configuration."""
    full_name: str
    """Remapped."""
    timeout: float
    serve: bool


class PositionPlan(NamedTuple):
    """The resolved service turtle_position."""

    pose: Slot[Pose]
    of: RosService


class BridgePlan(NamedTuple):
    """The slots, topics, services and actions that a bridge connects."""

    node: Names
    arguments: RosArguments
    types: TypeLibrary
    relays: list[RelayPlan]
    clients: list[ServicePlan]
    servers: list[ServicePlan]
    actions: list[ServicePlan]
    position: PositionPlan | None
    warnings: list[ConfigurationError]
    """Possible, but messages are lost."""
    notes: list[ConfigurationError]
    """Choices where the configuration names nothing."""


class RelayEdge(NamedTuple):
    """A relay in one of its directions."""

    relay: int
    """Its index in the configuration."""
    source: str
    target: str


def find_cycle(edges: Iterable[RelayEdge]) -> tuple[int, list[str]] | None:
    """Find a cycle of relays; return a relay of it and its places, or None."""
    edges = list(edges)
    # A relay does not take back what it has brought.
    before = {
        edge: [each for each in edges if each.target == edge.source and each.relay != edge.relay]
        for edge in edges
    }
    try:
        TopologicalSorter(before).prepare()
    except CycleError as error:
        cycle: list[RelayEdge] = error.args[1]
        return cycle[0].relay, [edge.target for edge in cycle]
    return None


def make_plan(
    config: BridgeConfig,
    folder: Path,
    slots: list[SlotInfo],
    arguments: RosArguments = RosArguments(),  # noqa: B008 (immutable)
) -> tuple[BridgePlan, list[ConfigurationError]]:
    """Make the plan of a configuration, and list its errors; without any the plan is complete.

    ``folder`` is where relative ``types`` are searched, ``slots`` those on the board. The errors
    have a ``where`` in the configuration. ``arguments`` remap the node and the topics. Raise
    :class:`.RosArgumentError` for a name in them that is none.
    """
    planner = _Planner(config, folder, slots, arguments)
    return planner.plan(), planner.faults


class _Planner:
    def __init__(
        self, config: BridgeConfig, folder: Path, slots: list[SlotInfo], arguments: RosArguments
    ) -> None:
        self.faults: list[ConfigurationError] = []
        self._warnings: list[ConfigurationError] = []
        self._notes: list[ConfigurationError] = []
        self._config = config
        self._arguments = arguments
        self._on_board = {info.name: info for info in slots}
        self._slots: dict[str, Slot[Any]] = {}
        self._topic_types: dict[str, str] = {}
        self._library = TypeLibrary()
        self._node = Names("llfsm_bridge")
        with self._at("types"):
            self._library = TypeLibrary(share=[folder / text for text in config.types])
        with self._at("node"):
            namespace, _, name = config.node.rpartition("/")
            self._node = arguments.names(name, namespace or "/")

    def plan(self) -> BridgePlan:
        config = self._config
        relays = self._each("relay", config.relay, self._relay)
        clients = self._each("client", config.client, self._client)
        servers = self._each("server", config.server, self._server)
        actions = self._each("action", config.action, self._action)
        position = self._position()
        self._check_pairs(relays)
        self._check_loops(relays)
        used, served = set(), set()
        if position:
            used.add(REQUEST.name)
            served.add(self._arguments.names(NODE, only_one=False).full_service(SERVICE))
        self._check_served(clients | servers, "a service", used, served)
        self._check_served(actions, "an action", set(), set())
        return BridgePlan(
            self._node,
            self._arguments,
            self._library,
            list(relays.values()),
            list(clients.values()),
            list(servers.values()),
            list(actions.values()),
            position,
            self._warnings,
            self._notes,
        )

    @contextmanager
    def _at(self, *where: str | int) -> Iterator[None]:
        """Record an error of the value at `where`, and continue after the block."""
        try:
            yield
        except (RosNameError, RosTypeError, WhiteboardError) as error:
            self._fault(str(error), *where)

    def _fault(self, what: str, *where: str | int) -> None:
        self.faults.append(ConfigurationError(what, where))

    def _each(
        self, kind: str, configs: Sequence[C], make: Callable[[C, _Where], P | None]
    ) -> dict[_Where, P]:
        """Resolve the configurations of a kind; return the plans by their places."""
        places = {(kind, i): config for i, config in enumerate(configs)}
        made = {where: make(config, where) for where, config in places.items()}
        return {where: plan for where, plan in made.items() if plan is not None}

    def _relay(self, config: RelayConfig, where: _Where) -> RelayPlan | None:
        topic = of = slot = keys = at_loss = None
        name = config.topic or config.slot
        with self._at(*where, "topic" if config.topic else "slot"):
            topic = self._node.full(name)
        with self._at(*where, "type"):
            of = self._library.message(config.type)
        if of is not None:
            with self._at(*where, "keyed_by"):
                keys = self._keys(config, of)
            with self._at(*where, "slot"):
                held = of.message if keys is None else keys.part
                capacity = config.capacity or capacity_for(held)
                slot = self._claim(Slot(config.slot, held, capacity), keyed=keys is not None)
        if topic is None or of is None or slot is None:
            return None
        with self._at(*where, "at_loss"):
            at_loss = _loss(config, slot, of)
        other = self._topic_types.setdefault(topic, of.name)
        if other != of.name:
            self._fault(f"the topic {topic} has type {other} in another relay", *where, "type")
        self._check_capacity(slot, config.capacity, where)
        self._estimate_losses(slot, config.capacity, where)
        return RelayPlan(
            slot,
            name,
            topic,
            of,
            None if config.direction == "from_ros" else _qos(config, 10),
            None if config.direction == "to_ros" else _qos(config, _KEYED_DEPTH if keys else 1),
            1 / config.rate if config.rate else 0.0,
            keys,
            at_loss,
        )

    def _keys(self, config: RelayConfig, of: RosMessage[Any]) -> KeyPath | None:
        if config.keyed_by is None:
            return None
        if config.direction != "from_ros":
            raise KeyPathError('`keyed_by` is for relays with direction = "from_ros"')
        return KeyPath(config.keyed_by, of.message)

    def _client(self, config: ServiceConfig, where: _Where) -> ServicePlan | None:
        full, find = self._node.full_service, self._library.service
        return self._through_slots(config, where, "service", full, find, service_slots)

    def _server(self, config: ServiceConfig, where: _Where) -> ServicePlan | None:
        plan = self._client(config, where)
        return None if plan is None else plan._replace(serve=True)

    def _action(self, config: ActionConfig, where: _Where) -> ServicePlan | None:
        full, find = self._node.full, self._library.action
        plan = self._through_slots(config, where, "action", full, find, action_slots)
        return None if plan is None else plan._replace(serve=config.role == "server")

    def _through_slots(
        self,
        config: ServiceConfig | ActionConfig,
        where: _Where,
        key: str,
        full: Callable[[str], str],
        find: Callable[[str], Any],
        make: Callable[[str, Any, int | None], Any],
    ) -> ServicePlan | None:
        name = getattr(config, key)
        full_name = of = slots = None
        with self._at(*where, key):
            full_name = full(name)
        with self._at(*where, "type"):
            of = find(config.type)
        if of is not None:
            with self._at(*where, "slots" if config.slots else key):
                slots = make(config.slots or name.lstrip("/"), of, config.capacity)
                for slot in slots[:-1]:  # all but the type
                    self._claim(slot)
                    self._check_capacity(slot, config.capacity, where)
        if full_name is None or slots is None:
            return None
        return ServicePlan(slots, name, full_name, config.timeout, serve=False)

    def _position(self) -> PositionPlan | None:
        config = self._config.turtle_position
        if config is None:
            return None
        where = "turtle_position", "pose"
        with self._at(*where):
            pose = self._claim(Slot(config.pose, Pose))
            for slot in (REQUEST, ANSWER):
                self._claim(slot)
            return PositionPlan(pose, self._library.service(TYPE))
        return None

    def _claim(self, slot: Slot[Any], *, keyed: bool = False) -> Slot[Any]:
        """Claim a slot for a use, and return the one that all uses share.

        Raise if the board or another use has it with another type. With ``keyed`` it stands for the
        slots that have its name before theirs.
        """
        for name, info in self._on_board.items():
            meant = name.startswith(f"{slot.name}/") if keyed else name == slot.name
            if meant and fingerprint(info.schema) != slot.fingerprint:
                raise Slot(name, slot.type).clash(info.schema)
        used = self._slots.setdefault(slot.name, slot)
        if used.fingerprint != slot.fingerprint:
            raise SlotTypeError(
                f"slot {slot.name!r} is used with {used.type_name} elsewhere in the configuration"
            )
        return used

    def _check_capacity(self, slot: Slot[Any], wanted: int | None, where: _Where) -> None:
        info = self._on_board.get(slot.name)
        if wanted and info is not None and info.capacity < wanted:
            self._fault(
                f"slot {slot.name!r} is on the board with a capacity of {info.capacity}",
                *where,
                "capacity",
            )

    def _estimate_losses(self, slot: Slot[Any], wanted: int | None, where: _Where) -> None:
        info = self._on_board.get(slot.name)
        capacity = slot.capacity if info is None else info.capacity
        chosen = info is not None or wanted is not None
        if text := capacity_warning(slot, capacity, chosen=chosen):
            self._warnings.append(ConfigurationError(text, (*where, "capacity")))
        elif not chosen and (text := capacity_note(slot)):
            self._notes.append(ConfigurationError(text, (*where, "type")))

    def _check_pairs(self, relays: Mapping[_Where, RelayPlan]) -> None:
        """Report relays that repeat or reverse others."""
        done: dict[tuple[str, str], set[bool]] = {}
        for where, relay in relays.items():
            way = {to for to, qos in ((True, relay.to_ros), (False, relay.from_ros)) if qos}
            before = done.setdefault((relay.slot.name, relay.topic), set())
            pair = f"slot {relay.slot.name!r} and topic {relay.topic}"
            if before & way:
                self._fault(f"{pair} are relayed twice in this direction", *where)
            elif before:
                self._fault(
                    f'{pair} are relayed both ways: make it one relay with direction = "both", '
                    "so that messages do not come back",
                    *where,
                )
            before |= way

    def _check_loops(self, relays: Mapping[_Where, RelayPlan]) -> None:
        if self.faults:
            return  # pairs are the smallest cycles, and other errors would make cycles guesswork
        edges = []
        keyed = [relay.slot.name for relay in relays.values() if relay.keys]
        for (_, i), relay in relays.items():
            slot, topic = relay.slot.name, f"topic {relay.topic}"
            if relay.to_ros:  # the slot of a key stands for all of its relay
                slot = next((key for key in keyed if slot.startswith(f"{key}/")), slot)
                edges.append(RelayEdge(i, f"slot {slot}", topic))
            if relay.from_ros:
                edges.append(RelayEdge(i, topic, f"slot {slot}"))
        loop = find_cycle(edges)
        if loop:
            self._fault(f"messages would cycle for ever: {' -> '.join(loop[1])}", "relay", loop[0])

    def _check_served(
        self, plans: Mapping[_Where, ServicePlan], what: str, used: set[str], served: set[str]
    ) -> None:
        """Report slots that two services or actions share, and those that are served twice."""
        for where, plan in plans.items():
            slot = plan.slots[0].name
            if slot in used:
                self._fault(f"the slot {slot!r} already has {what}", *where)
            used.add(slot)
            if plan.serve:
                if plan.full_name in served:
                    key = "action" if where[0] == "action" else "service"
                    self._fault(f"{plan.full_name} is already served", *where, key)
                served.add(plan.full_name)


def _qos(config: RelayConfig, usual_depth: int) -> Qos:
    """Make the profile of an end of a relay's topic."""
    return Qos(
        ReliabilityPolicy[config.reliability.upper()],
        DurabilityPolicy[config.durability.upper()],
        depth=config.depth or usual_depth,
        deadline_ns=_ns(config.deadline),
        lifespan_ns=_ns(config.lifespan),
        liveliness=LivelinessPolicy[config.liveliness.upper()],
        lease_ns=_ns(config.lease),
    )


def _ns(seconds: float | None) -> int:
    return round((seconds or 0) * 1e9)


def _loss(config: RelayConfig, slot: Slot[Any], of: RosMessage[Any]) -> Message | None:
    """Parse a relay's ``at_loss`` as a message of its slot, if it is given."""
    if config.at_loss is None:
        return None
    if config.direction == "from_ros":
        raise RosTypeError("`at_loss` is for relays to ROS")
    message = parse_message(slot, json.dumps(config.at_loss))
    try:
        of.encode(message)
    except CdrError as error:
        raise RosTypeError(f"`at_loss` is not a {of.name}: {error}") from error
    return message
