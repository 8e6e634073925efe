"""Slot to topic, and topic to slot: the newest message wins.

Each slot has a subscription of its own, so a thread of its own, asleep in the slot's futex. Ten
slots at 1 kHz each over Zenoh: it adds 30 us (median) to the 107 us that a message takes between
two Zenoh processes. One thread that polls all slots every 200 us would add 200 us and take 8 % of a
core while nothing changes; the threads take 0.5 %. Polling is better only if all slots change at
the same instant: 22 us of CPU a message instead of 43, as no interpreter lock changes hands.

* **No echo.** What a relay of both directions has sent comes back to it from both sides. It knows
  its messages on the board by their count, those in ROS by their publisher: an equal message from
  anybody else is a new one and is relayed (:class:`EchoFilter`).
* **Nothing is decoded twice, most of it never.** What is dropped was not decoded, and what goes
  from topic to slot to topic is sent as it came (:class:`LatestArrival`).
* **Loss of a commander.** Any process can be lost, also one without a machine's last will. As a
  will, ``at_loss`` is posted on the slot, by a compare-and-swap in place of the latest message: it
  never replaces the message of another process, one of several bridges posts it, and everybody sees
  it, not only ROS (:class:`LossWatch`).
* **A slot for each key**, where many publishers share a topic: with one slot, the newest message of
  one would hide those of the others (:class:`KeyedFromRos`).
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, NamedTuple

from llfsm.bridges.ros2.bridging.bridge_config import KeyPath
from llfsm.bridges.ros2.bridging.bridge_plan import RelayPlan
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.errors import CdrError, KeyPathError, TransportClosedError
from llfsm.bridges.ros2.node_parameters import NodeParameters, Parameter
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Publisher, SerializedMessage
from llfsm.bridges.ros2.types import RosMessage
from llfsm.whiteboard import Board, BoundSlot, Sample, Slot
from llfsm.whiteboard.errors import BoardClosedError, WhiteboardError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.message import M
from llfsm.whiteboard.subscription import Subscription

_LOG = logging.getLogger("llfsm.bridges.ros2")

_RETURN_S = 1.0  # within which a published message comes back, if at all
_MOST = 1000


class EchoFilter(Generic[M]):
    """Recognises the messages that a relay of both directions has sent itself.

    Where a transport does not report publishers, the messages themselves are compared: each one
    published cancels one that arrives within a second.
    """

    def __init__(
        self, publisher: Publisher[M], of: RosMessage[M], now: Callable[[], float] = time.monotonic
    ) -> None:
        self._gid = publisher.gid
        self._encode = of.encode
        self._now = now
        self._lock = threading.Lock()
        self._added = 0
        self._published: deque[tuple[float, bytes]] = deque(maxlen=_MOST)

    def add(self, slot: BoundSlot[M], message: M) -> int:
        """Add a message from ROS to the slot; return its count."""
        with self._lock:  # else it is relayed before its count is known
            self._added = slot.add(message)
            return self._added

    def is_news(self, count: int) -> bool:
        """Check that ROS has neither the message of this count nor a newer one."""
        with self._lock:
            return count > self._added

    def publishing(self, message: M) -> None:
        """Remember a message that is about to be published."""
        if not self._gid:
            with self._lock:
                self._published.append((self._now(), self._encode(message)))

    def is_ours(self, arrival: SerializedMessage[M]) -> bool:
        """Check if a received message was published here.

        Raise :class:`.CdrError` if it has to be decoded and cannot be.
        """
        if self._gid:
            return arrival.info.gid == self._gid
        if not self._published:
            return False
        data = self._encode(arrival.decode())  # not what arrived: encoders pad differently
        oldest = self._now() - _RETURN_S
        with self._lock:
            while self._published and self._published[0][0] < oldest:
                self._published.popleft()
            for entry in self._published:
                if entry[1] == data:
                    self._published.remove(entry)
                    return True
        return False


_LOOK_S = 0.05  # between two looks, of which the second must find the same
_MEET_S = 1.0  # for the robot's nodes to find the bridge's: the message must not be too early


@dataclass(eq=False)
class LossWatch(Generic[M]):
    """Posts a message in place of the latest one of a process that has died, from now on.

    It does so also if that was before; not if the latest message is this one already, whose bytes
    are ``data``. A machine's own last will is executed at once, and so before.
    """

    slot: BoundSlot[M]
    message: M
    data: bytes
    link: BridgeLink
    timer: TimerThread

    def __post_init__(self) -> None:
        self._lost = 0  # the count of a message whose process was dead at the last look
        self._is_over = False
        self.slot.reserve()  # so that it can be posted on a board that is full by then
        self.timer.call_later(_MEET_S, self._look)

    def finish(self) -> None:
        """Stop watching."""
        self._is_over = True

    def close(self) -> None:
        """Do nothing: the next look is the last."""

    def _look(self) -> None:
        if self._is_over:
            return
        try:
            encoded = self.slot.encoded()
            if encoded is not None:
                self._judge(encoded[0] == self.data, Sample[Any](*encoded))
        except BoardClosedError:
            return
        except WhiteboardError as error:
            self.link.count_fault(error)
        self.timer.call_later(_LOOK_S, self._look)

    def _judge(self, is_posted: bool, latest: Sample[Any]) -> None:
        if is_posted or writer_lives(latest):
            self._lost = 0
        elif self._lost != latest.count:
            self._lost = latest.count
        elif self.slot.add_after(self.message, latest.count):
            _LOG.warning(
                "%s: process %d, which commanded it, has died; posted at_loss",
                self.link.slot,
                latest.writer,
            )


_MOST_HZ = 1e6


class RelaySettings:
    """The settings of one relay, in both directions. One thread sets; any thread may read."""

    def __init__(self, period: float = 0.0) -> None:
        self.period = period
        """Seconds between two messages; 0: no limit."""
        self.enabled = True

    def set_rate(self, rate: float) -> None:
        """Let at most ``rate`` messages pass a second; 0: all."""
        self.period = 1 / rate if rate else 0.0


def declare_settings(
    relays: Sequence[RelayPlan], parameters: NodeParameters
) -> list[RelaySettings]:
    """Declare ``relays.TOPIC.rate`` and ``.enabled``; return the settings of each relay.

    Where several slots are relayed to one topic, it is ``TOPIC.SLOT``. Raise
    :class:`.ParameterOverrideError`.
    """
    relays_of = Counter(relay.topic for relay in relays)
    made = []
    for relay in relays:
        topic, slot = relay.topic, relay.slot.name
        name = topic if relays_of[topic] == 1 else f"{topic}.{slot}"
        settings = RelaySettings(relay.period)
        between = f"between {topic} and the slot {slot}"
        parameters.declare(
            {
                f"relays.{name}.rate": Parameter(
                    1 / relay.period if relay.period else 0.0,
                    f"Messages a second {between}, 0: no limit",
                    range=(0.0, _MOST_HZ),
                    changed=settings.set_rate,
                ),
                f"relays.{name}.enabled": Parameter(
                    True,
                    f"Whether messages pass {between}",
                    changed=partial(setattr, settings, "enabled"),
                ),
            }
        )
        made.append(settings)
    return made


class LatestArrival(Generic[M]):
    """The latest message that relays of a bridge have added to a slot, as it came from ROS."""

    def __init__(self) -> None:
        self._latest: tuple[int, SerializedMessage[M]] | None = None

    def keep(self, count: int, arrival: SerializedMessage[M]) -> None:
        """Keep the arrival that has just become the slot's message number ``count``."""
        self._latest = count, arrival

    def get(self, count: int) -> SerializedMessage[M] | None:
        """Return the arrival that became the message number ``count``; None if it is not known."""
        latest = self._latest
        return latest[1] if latest is not None and latest[0] == count else None


class _Taken(NamedTuple, Generic[M]):
    """A message to add: its decoder, and the arrival that it was, if that is the whole message."""

    decode: Callable[[], M]
    arrival: SerializedMessage[M] | None


class _Undecoded(NamedTuple):
    """A slot as its subscription follows it: by the messages' numbers alone."""

    slot: BoundSlot[Any]

    @property
    def count(self) -> int:  # type: ignore[override]  # hides tuple.count
        return self.slot.count

    def wait(self, *, after: int, timeout: float | None = None) -> Sample[Any] | None:
        count = self.slot.wait_count(after=after, timeout=timeout)
        return None if count is None else _undecoded(count)


def _undecoded(count: int) -> Sample[Any]:
    return Sample[Any](None, count, 0, 0)


HISTORY_S = 1.0  # that a latched topic has to deliver what it has kept


class ToRos(Generic[M]):
    """Publishes each change that it sees of a slot.

    What is on the slot already is not published unless ``latched``: a command from yesterday must
    not move a robot. In both directions ROS has a second to deliver the history that it has kept;
    else each side might end with what the other one had.
    """

    def __init__(
        self,
        slot: BoundSlot[M],
        publisher: Publisher[M],
        link: BridgeLink,
        *,
        settings: RelaySettings | None = None,
        latched: bool = False,
        echo: EchoFilter[M] | None = None,
        arrival: LatestArrival[M] | None = None,
    ) -> None:
        """Begin to publish, as ``settings`` allow.

        ``latched`` and with an ``echo``, it begins after a second. What is the latest
        ``arrival`` is published as it came.
        """
        self.slot = slot
        self._publisher = publisher
        self._link = link
        self._echo = echo
        self._settings = settings or RelaySettings()
        self._begin = time.monotonic() + (HISTORY_S if latched and echo else 0.0)
        self._over = threading.Event()
        self._arrival = arrival
        self._seen = 0 if latched else slot.count
        self._ahead = 0  # the number of a message that was read instead of an older one
        # Of what came from ROS, perhaps, the number is enough: most of it is not to be decoded.
        followed = slot if arrival is None and echo is None else _Undecoded(slot)
        self._subscription = Subscription(
            followed, self._relay, after=self._seen, backlog=1, on_error=self._failed
        )

    def finish(self) -> None:
        """Stop after publishing the message that is on the slot by now."""
        self._over.set()
        self._subscription.finish()

    def close(self) -> None:
        """Wait for that, and publish what machines added after their board was removed.

        The removal has ended the subscription, but it has also asked the machines to stop.
        """
        self._subscription.close()
        try:
            count = self.slot.count
        except WhiteboardError:  # closed
            return
        if count > max(self._seen, self._ahead):
            try:
                self._pass_on(_undecoded(count))
            except Exception as error:
                self._failed(error)

    def _relay(self, newer: Sample[Any]) -> None:
        self._seen = newer.count
        if newer.count == self._ahead:
            return
        begun = time.monotonic()
        if begun < self._begin:
            self._over.wait(self._begin - begun)
            if newer.count != self.slot.count:
                return  # the newest comes next
        try:
            self._pass_on(newer)
        finally:
            if period := self._settings.period:
                self._over.wait(begun + period - time.monotonic())

    def _pass_on(self, newer: Sample[Any]) -> None:
        count = newer.count
        if not self._settings.enabled or not (self._echo is None or self._echo.is_news(count)):
            return
        arrival = None if self._arrival is None else self._arrival.get(count)
        if arrival is not None:
            self._publisher.forward(arrival)
        elif not self._publish(newer):
            return
        self._link.count()

    def _publish(self, newer: Sample[Any]) -> bool:
        """Publish a message, or a newer one if it is not decoded yet, if ROS needs it."""
        sample = newer if newer.message is not None else self.slot.sample()
        if sample is None:  # its slot's name has just been given up
            return False
        if sample.count != newer.count:
            self._ahead = sample.count
        if self._echo is not None:
            if not self._echo.is_news(sample.count):
                return False
            self._echo.publishing(sample.message)
        self._publisher.publish(sample.message)
        return True

    def _failed(self, error: Exception) -> bool:
        if not isinstance(error, TransportClosedError):
            self._link.count_fault(error)
        return True


@dataclass(eq=False)
class FromRos(Generic[M]):
    """Adds received messages to a slot: :meth:`arrived` is a subscription's callback.

    Where ``settings`` have a period, the newest message within a period is added at its end; the
    others are never decoded. ``latest`` is given each arrival that was added.
    """

    slot: BoundSlot[M]
    link: BridgeLink
    timer: TimerThread
    settings: RelaySettings = field(default_factory=RelaySettings)
    echo: EchoFilter[M] | None = None
    latest: LatestArrival[M] | None = None

    def __post_init__(self) -> None:
        self._held: _Taken[M] | None = None
        self._due = 0.0
        self._lock = threading.Lock()

    def arrived(self, arrival: SerializedMessage[M]) -> None:
        """Add a message, now or at the end of the period; raise :class:`.CdrError`."""
        if self.echo is not None and self.echo.is_ours(arrival):
            return
        self._take(_Taken(arrival.decode, arrival))

    def take(self, message: M) -> None:
        """Add a message that was decoded, as :meth:`arrived` does."""
        self._take(_Taken(lambda: message, None))

    def _take(self, taken: _Taken[M]) -> None:
        if not self.settings.enabled:
            return
        if not self.settings.period or self._begins_period(taken):
            self._add(taken)

    def _begins_period(self, taken: _Taken[M]) -> bool:
        with self._lock:
            now = time.monotonic()
            if self._held is None and now >= self._due:
                self._due = now + self.settings.period
                return True
            if self._held is None:
                self.timer.call_later(self._due - now, self._add_held)
            self._held = taken
            return False

    def _add_held(self) -> None:
        with self._lock:
            taken, self._held = self._held, None
            self._due = time.monotonic() + self.settings.period
        if taken is not None:
            self._add(taken)

    def _add(self, taken: _Taken[M]) -> None:
        try:
            message = taken.decode()
            if self.echo is None:
                count = self.slot.add(message)
            else:
                count = self.echo.add(self.slot, message)
            if self.latest is not None and taken.arrival is not None:
                self.latest.keep(count, taken.arrival)
        except BoardClosedError:
            return  # the bridge ends
        except Exception as error:  # bad bytes, too large for the slot: the next may be right
            self.link.count_fault(error)
            return
        self.link.count()


@dataclass(eq=False)
class KeyedFromRos:
    """Adds received messages to the slots ``PREFIX/KEY``; :meth:`arrived` is a callback.

    ``slot`` is that of the prefix; the others have its type and capacity. A slash before a key, as
    before a frame's name, is removed. The settings, such as the rate, are those of each slot.
    """

    board: Board
    slot: Slot[Any]
    keys: KeyPath
    link: BridgeLink
    timer: TimerThread
    settings: RelaySettings

    def __post_init__(self) -> None:
        self._relays: dict[str, FromRos[Any]] = {}

    def arrived(self, arrival: SerializedMessage[Any]) -> None:
        """Add the messages of each key."""
        try:
            message = arrival.decode()
        except CdrError as error:  # the next may be right
            self.link.count_fault(error)
            return
        for key, part in self.keys.split(message):
            try:
                relay = self._relays.get(key) or self._add_relay(key)
            except BoardClosedError:
                return  # the bridge ends
            except (KeyPathError, WhiteboardError) as error:  # the next key may be right
                self.link.count_fault(error)
            else:
                relay.take(part)

    def _add_relay(self, key: str) -> FromRos[Any]:
        if not key:
            raise KeyPathError("a message has an empty key")
        slot = Slot(f"{self.slot.name}/{key}", self.slot.type, self.slot.capacity)
        relay = FromRos(self.board[slot], self.link, self.timer, self.settings)
        self._relays[key] = relay
        return relay
