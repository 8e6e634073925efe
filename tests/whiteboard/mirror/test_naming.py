"""Names here and names that travel: each has one counterpart at most, and leads back to it."""

from __future__ import annotations

import itertools
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.llfsm import LastWill, SafeValue, request_slot, will_slot
from llfsm.whiteboard.mirror.batches import Value, Version
from llfsm.whiteboard.mirror.groups import group_of
from llfsm.whiteboard.mirror.naming import Naming
from llfsm.whiteboard.mirror.settings import Settings
from simulation import Numbered, World
from thoroughness import examples

from .part import NUMBER, Number, Part

HOSTS = "robot7", "robot8", "operator"
FLEET = "robot*", "operator"

part = st.sampled_from([*HOSTS, "llfsm", "machine", "viewer", "pose", "arm", "", "é", "Robot7"])
names = st.lists(part, min_size=1, max_size=5).map("/".join).filter(bool)
long_names = st.integers(230, 255).map(lambda size: "n" * size)
namings = st.builds(
    Naming,
    st.sampled_from([*HOSTS, "machine"]),
    st.sampled_from([(), FLEET, ("*",), ("robot8", "a/b")]),
) | st.builds(Naming)


@settings(max_examples=examples(120), deadline=None)
@given(naming=namings, name=names | long_names)
@example(naming=Naming("robot7", FLEET), name="llfsm/viewer/")
@example(naming=Naming("robot7", FLEET), name="robot7/robot8/pose")
@example(naming=Naming("robot7", FLEET), name="llfsm/machine/robot7/llfsm")
def test_each_direction_undoes_the_other(naming: Naming, name: str) -> None:
    """So two slots never get one name, in either direction: the mapping is a bijection."""
    wire, local = naming.wire(name), naming.local(name)
    assert wire is None or naming.local(wire) == name
    assert local is None or naming.wire(local) == name


@settings(max_examples=examples(60), deadline=None)
@given(name=names)
def test_what_one_host_owns_another_one_has_in_its_folder(name: str) -> None:
    robot7, robot8 = Naming("robot7", FLEET), Naming("robot8", FLEET)
    wire = robot7.wire(name)
    if wire is not None and robot7.is_own(name):
        assert robot8.local(wire) == wire, "an own slot has a name on every host of the fleet"
        assert not robot8.is_own(wire)


@pytest.mark.parametrize(
    ("local", "wire"),
    [
        ("pose", "robot7/pose"),
        ("arm/angle", "robot7/arm/angle"),
        ("robot8/pose", "robot8/pose"),
        ("llfsm/machine/Wall", "llfsm/machine/robot7/Wall"),
        ("llfsm/request/robot8/Wall", "llfsm/request/robot8/Wall"),
        ("llfsm/viewer", "llfsm/viewer/robot7/"),
        ("robot8", "robot7/robot8"),  # no folder
    ],
)
def test_names_of_a_host_and_of_its_fleet(local: str, wire: str) -> None:
    naming = Naming("robot7", FLEET)
    assert (naming.wire(local), naming.local(wire)) == (wire, local)


@pytest.mark.parametrize("wire", ["pose", "yard/pose", "llfsm/machine/Wall", "robot7/robot8/pose"])
def test_what_no_host_of_the_fleet_has_has_no_name_here(wire: str) -> None:
    assert Naming("robot7", FLEET).local(wire) is None


def test_a_host_without_a_name_has_the_names_that_travel() -> None:
    naming = Naming()
    assert naming.wire("robot7/pose") == naming.local("robot7/pose") == "robot7/pose"


def will(slot: str, *slots: str) -> Value:
    values = tuple(SafeValue(each, b"") for each in slots)
    message = LastWill(1, 2, "computer", 3, values)
    return Value(slot, 4, Version(5, 6), msgspec.msgpack.encode(message))


def slots_of(value: Value | None) -> list[str]:
    assert value is not None
    message = msgspec.msgpack.decode(value.payload, type=LastWill)
    return [each.slot for each in message.values]


def test_an_own_last_will_names_its_slots_as_they_travel() -> None:
    naming = Naming("robot7", FLEET)
    here = will(will_slot("Wall").name, "cmd", "robot8/gripper", "robot7/x")
    sent = naming.leaving(here)
    assert sent.slot == "llfsm/will/robot7/Wall"
    assert slots_of(sent) == ["robot7/cmd", "robot8/gripper", "robot7/x"]
    assert slots_of(naming.arriving(will(sent.slot, "robot7/cmd"))) == ["cmd"]


def test_a_last_will_of_another_host_is_passed_on_as_it_came_and_executed_with_the_names_here() -> (
    None
):
    naming = Naming("robot7", FLEET)
    sent = will("llfsm/will/operator/Driver", "robot7/cmd", "robot8/cmd", "yard/x")
    there = naming.arriving(sent)
    assert there == naming.leaving(sent) == sent
    message = msgspec.msgpack.decode(sent.payload, type=LastWill)
    here = naming.will(sent.slot, message)
    assert [value.slot for value in here.values] == ["cmd", "robot8/cmd"]


def test_what_is_no_last_will_leaves_as_it_is() -> None:
    value = Value("llfsm/will/x", 4, Version(5, 6), b"\x93")
    assert Naming("robot7", FLEET).leaving(value) == msgspec.structs.replace(
        value, slot="llfsm/will/robot7/x"
    )


# ---- In the exchange ------------------------------------------------------------------------


def robot(name: str = "robot7", **others: object) -> Part:
    return Part(**{"as": name, "fleet": FLEET, **others})  # type: ignore[arg-type]


def send(sender: Part, receiver: Part) -> None:
    for data in sender.collect():
        receiver.exchange.receive_batch(data)


def test_globs_are_for_the_names_here() -> None:
    host, other = robot(leave=["pose"], enter=["cmd"]), Part(2)
    for slot in ("pose", "secret"):
        host.board.add_message(Slot(slot, Number), Number(1))
    send(host, other)
    assert [info.name for info in other.board.slots()] == ["robot7/pose"]
    for slot in ("robot7/cmd", "robot7/secret"):
        other.board.add_message(Slot(slot, Number), Number(2))
    send(other, host)
    assert host.get(Slot("cmd", Number)) == Number(2)
    assert host.get(Slot("secret", Number)) == Number(1)
    assert host.refused() == {"not listed: secret": 1}


def test_access_is_for_the_names_here() -> None:
    host, other = robot(access={"laptop": ["cmd"]}), Part(2)
    for slot in ("robot7/cmd", "robot7/pose"):
        other.board.add_message(Slot(slot, Number), Number(2))
    for data in other.collect():
        host.exchange.receive_batch(data, "laptop")
    assert host.get(Slot("cmd", Number)) == Number(2)
    assert host.refused() == {"from laptop: pose": 1}


def test_a_request_from_another_host_rings_the_bell() -> None:
    from llfsm.whiteboard.messages.llfsm import BELL, MachineRequest

    host, other = robot(), Part(2)
    other.board.add_message(request_slot("robot7/Wall"), MachineRequest("suspend"))
    send(other, host)
    assert host.get(request_slot("Wall")) == MachineRequest("suspend")
    assert host.board[BELL].count == 1


def test_a_folder_of_the_hosts_own_name_is_reported_and_stays() -> None:
    host = robot()
    host.board.add_message(Slot("robot7/pose", Number), Number(1))
    assert host.collect() == []
    assert host.refused() == {"no name for others: robot7/pose": 1}


def test_slots_outside_the_fleet_are_counted_and_not_made() -> None:
    host, other = robot(), Part(2)
    other.board.add_message(NUMBER, Number(1))
    send(other, host)
    assert host.board.slots() == []
    assert host.refused() == {"slots of no host in `fleet`": 1}


def test_what_is_sent_to_its_own_slots_is_read_by_a_named_host_that_is_not_eager() -> None:
    host = robot(eager=False)
    host.board.add_message(Slot("arm/angle", Number), Number(1))
    host.board.add_message(Slot("robot8/pose", Number), Number(1))
    host.collect()
    assert host.exchange.read([]) == {group_of("robot7/arm/angle")}
    assert host.exchange.read(["robot8/pose"]) == {
        group_of("robot7/arm/angle"),
        group_of("robot8/pose"),
    }
    assert Part(eager=False).exchange.read([]) == set()


# ---- Whole histories ------------------------------------------------------------------------

WIRE = [
    "robot7/pose", "robot7/arm/angle", "robot8/pose", "operator/goal", "llfsm/machine/robot7/Wall",
    "llfsm/viewer/robot8/",
]  # fmt: skip
CHOSEN = [
    Settings(as_="robot7", fleet=FLEET),
    Settings(as_="robot8", fleet=FLEET, eager=False),
    Settings(),
]
STEPS = st.lists(
    st.tuples(
        st.sampled_from(["add", "add", "read", "run", "cut", "join", "kill", "start"]),
        st.integers(0, len(CHOSEN) - 1),
        st.integers(0, len(WIRE) - 1),
    ),
    max_size=30,
)


@settings(max_examples=examples(5), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(steps=STEPS, loss=st.sampled_from([0.0, 0.3]), skew_ms=st.sampled_from([0.0, 5000.0]))
def test_any_history(steps: list[tuple[str, int, int]], loss: float, skew_ms: float) -> None:
    """Hosts with and without names agree, no board goes back, and no slot comes back as another."""
    namings = [Naming(each.as_, each.fleet) for each in CHOSEN]
    numbers = itertools.count()
    with TemporaryDirectory() as folder:
        world = World(0, len(CHOSEN), Path(folder), loss=loss, skew_ms=skew_ms, settings=CHOSEN)

        def slot(host: int, wire: str) -> Slot[Numbered]:
            local = namings[host].local(wire)
            assert local is not None
            return Slot(local, Numbered)

        for what, index, which in steps:
            host = world.hosts[index]
            if what == "add":
                host.board.add_message(slot(index, WIRE[which]), Numbered(next(numbers)))
            elif what == "read":
                host.board.get_message(slot(index, WIRE[which]))
            elif what == "run":
                world.run(20 * which)
            elif what == "cut":
                world.groups[index] = index + 1
            elif what == "join":
                world.groups = [0] * len(CHOSEN)
            elif what == "kill" and host.version_log is not None:
                host.kill()
            elif what == "start" and host.version_log is None:
                host.start()
        world.groups, world.loss = [0] * len(CHOSEN), 0.0
        for index, host in enumerate(world.hosts):
            if host.version_log is None:
                host.start()
            for wire in WIRE:
                host.board.get_message(slot(index, wire))
        world.run(1500)
        boards = [
            {namings[index].wire(info.name): host.board.get_message(slot(index, info_wire))
             for info in host.board.slots() if (info_wire := namings[index].wire(info.name) or "")}
            for index, host in enumerate(world.hosts)
        ]  # fmt: skip
        for board, host in zip(boards, world.hosts, strict=True):
            assert set(board) == set(WIRE), "no other slot was made"
            assert len(board) == len(host.board.slots()), "and none twice"
        assert boards[0] == boards[1] == boards[2]
        world.close()
