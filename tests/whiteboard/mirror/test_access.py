"""The right to add to slots, by the names in certificates made here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from free_ports import free_endpoint
from llfsm.whiteboard import NetworkError, Slot, Whiteboard
from llfsm.whiteboard.messages import llfsm as own
from llfsm.whiteboard.messages.llfsm import (
    LastWill,
    MachineRequest,
    SafeValue,
    request_slot,
    will_slot,
)
from llfsm.whiteboard.mirror.batches import VERSION, Batch, Declaration, Heartbeat, Value, Version
from llfsm.whiteboard.mirror.groups import group_of
from llfsm.whiteboard.mirror.settings import Settings, matcher
from llfsm.whiteboard.mirror.zenoh_config import configure
from waiting import wait_for

from .conftest import (
    NAME,
    Certify,
    Host,
    MakeHost,
    Number,
    number_slot,
    plain_session,
)
from .part import Part, batch

GOAL, ARM = number_slot("operator/goal"), number_slot("robot/arm")


@pytest.fixture
def robot(make_host: MakeHost, certify: Certify, tmp_path: Path) -> Host:
    """A host that lets two others add to some slots."""
    settings = tmp_path / "robot.toml"
    settings.write_text('[access]\nlaptop = ["operator/*"]\ntablet = ["*"]\n')
    robot = make_host("robot", free_endpoint("localhost", "tls"))
    robot.start("--config", str(settings), "--zenoh", str(certify("robot", "ours")))
    return robot


def refused(host: Host) -> set[str]:
    return {each["what"] for each in host.status()["refused"]}


def test_each_host_adds_to_the_slots_that_it_may(
    robot: Host, make_host: MakeHost, certify: Certify
) -> None:
    laptop, stranger = (
        make_host(name, free_endpoint("localhost", "tls")) for name in ("laptop", "stranger")
    )
    laptop.start("--zenoh", str(certify("laptop", "ours")), connect=[robot])
    stranger.start("--zenoh", str(certify("stranger", "ours")), connect=[robot])
    robot.add(1, ARM)
    wait_for(lambda: laptop.get(ARM) == 1)
    stranger.add(666, GOAL)
    laptop.add(666, ARM)
    laptop.add(2, GOAL)
    wait_for(lambda: robot.get(GOAL) == 2)
    wait_for(
        lambda: (
            refused(robot)
            >= {"from laptop: robot/arm", "a connection: `access` does not list 'stranger'"}
        )
    )
    status = robot.status()
    assert robot.get(ARM) == 1
    assert [peer["certificate"] for peer in status["peers"]] == ["laptop"]
    assert [quota["name"] for quota in status["quotas"]] == ["laptop"]
    with Whiteboard.connect(robot.endpoint, NAME, zenoh=str(certify("tablet", "ours"))) as tablet:
        tablet.add_message(ARM, Number(3))
        wait_for(lambda: robot.get(ARM) == 3)
        assert tablet.get_message(GOAL) == Number(2)


def test_a_host_does_not_pass_for_another(robot: Host, certify: Certify) -> None:
    """Whatever it claims: Zenoh lets it use no keys but those of its certificate's name."""
    with plain_session(robot, certify("laptop", "ours")) as session:
        root = f"llfsm/{VERSION}/{NAME}"
        forged = [
            session.declare_publisher(f"{root}/slots/{name}/{group_of(GOAL.name)}/{kind}")
            for name in ("tablet", "-", "robot")
            for kind in ("batch", "beat")
        ]
        own = session.declare_publisher(f"{root}/slots/laptop/{group_of(GOAL.name)}/batch")
        beat = msgspec.msgpack.encode(Heartbeat(7, 1, 1, 10**12, "tablet"))

        def send(number: int) -> None:
            value = msgspec.msgpack.encode(Number(number))
            version = Version(10**12 + number, 7)
            slots = GOAL, ARM
            values = tuple(Value(s.name, s.fingerprint, version, value) for s in slots)
            declarations = tuple(Declaration(s.name, s.capacity, s.schema) for s in slots)
            data = msgspec.msgpack.encode(Batch(7, 1, number, 10**12, values, declarations))
            for publisher in forged:
                publisher.put(beat if str(publisher.key_expr).endswith("beat") else data)
            own.put(data)

        for number in range(1, 20):
            send(number)
            wait_for(lambda number=number: robot.get(GOAL) == number)
        assert robot.get(ARM) is None
    wait_for(lambda: refused(robot) == {"from laptop: robot/arm"})
    assert [quota["name"] for quota in robot.status()["quotas"]] == ["laptop"]


def test_what_may_not_enter_from_any_host_may_not_from_a_listed_one() -> None:
    part = Part(access={"laptop": ["*"]}, enter=["operator/*"])
    part.exchange.receive_batch(batch(1, ARM), "laptop")
    part.exchange.receive_batch(batch(2, GOAL), "laptop")
    part.exchange.receive_batch(batch(3, number_slot("operator/speed")), "tablet")
    assert [info.name for info in part.board.slots()] == ["operator/goal"]
    assert part.refused() == {"not listed: robot/arm": 1, "from tablet: operator/speed": 1}


def test_hosts_of_one_certificate_share_a_quota_and_others_do_not() -> None:
    part = Part(access={"laptop": ["*"], "tablet": ["*"]}, quota={"slots": 2})
    for host, name in enumerate(("laptop", "laptop", "laptop", "tablet"), 2):
        part.exchange.receive_batch(batch(1, number_slot(f"slot{host}"), host=host), name)
    assert [info.name for info in part.board.slots()] == ["slot2", "slot3", "slot5"]
    assert {quota.name: quota.slots for quota in part.exchange.status().quotas} == {
        "laptop": 2,
        "tablet": 1,
    }


def test_access_needs_certificates(tmp_path: Path, certify: Certify) -> None:
    config = tmp_path / "plain.json5"
    config.write_text("{}")
    for file in (None, str(config)):
        with pytest.raises(NetworkError, match="`enable_mtls: true`"):
            configure(Settings(access={"laptop": ("*",)}, zenoh=file), "peer")
    tls = json.loads(certify("robot", "ours").read_text())
    config.write_text(json.dumps({**tls, "access_control": {"enabled": True}}))
    with pytest.raises(NetworkError, match="in the Zenoh configuration file, and in `access`"):
        configure(Settings(access={"laptop": ("*",)}, zenoh=str(config)), "peer")


def will_of(part: Part, *slots: Slot[Any], name: str = "laptop", **how: Any) -> list[str]:
    """Let a host leave a last will for some slots; list those that a guard here would post to."""
    values = tuple(SafeValue(slot.name, msgspec.msgpack.encode(Number(666))) for slot in slots)
    left = LastWill(999, 1, "evil", 5, values, 0)
    part.exchange.receive_batch(batch(1, will_slot("Evil"), left, **how), name)
    found = part.board.get_message(will_slot("Evil"))
    assert found is not None
    return [value.slot for value in found.values]


@pytest.mark.parametrize(
    "settings",
    [
        {"enter": ["llfsm/*", "operator/*"]},
        {"access": {"laptop": ["llfsm/*", "operator/*"]}},
        {"access": {"laptop": ["*"]}, "enter": ["llfsm/*", "operator/*"]},
    ],
)
def test_a_last_will_moves_nothing_that_its_sender_may_not_move(settings: Any) -> None:
    part = Part(**settings)
    assert will_of(part, ARM, GOAL) == [GOAL.name]
    (what,) = part.refused()
    assert what.startswith("in a last will from")
    assert what.endswith(": robot/arm")


@pytest.mark.parametrize("settings", [{}, {"access": {"laptop": ["*"]}}])
def test_a_last_will_of_who_may_add_to_all_stays_as_it_is(settings: Any) -> None:
    part = Part(**settings)
    assert will_of(part, ARM, GOAL) == [ARM.name, GOAL.name]
    assert not part.refused()


def requested(part: Part, request: MachineRequest, name: str = "laptop") -> MachineRequest | None:
    part.exchange.receive_batch(batch(1, request_slot("Wall"), request), name)
    return part.board.get_message(request_slot("Wall"))


OVERRIDE = MachineRequest("override", 'goal {"n": 666}', 5.0)


@pytest.mark.parametrize(
    ("settings", "may"),
    [
        ({"enter": ["llfsm/*", "operator/*"]}, False),
        ({"access": {"laptop": ["llfsm/*", "operator/*"]}}, False),
        ({"access": {"laptop": ["*"]}}, True),
        ({}, True),
    ],
)
def test_an_override_is_of_who_may_add_to_all_slots(settings: Any, may: bool) -> None:
    part = Part(**settings)
    part.board.add_message(ARM, Number(1))
    part.board.add_message(GOAL, Number(1))
    assert requested(part, OVERRIDE) == (OVERRIDE if may else None)
    assert bool(part.refused()) is not may


def test_an_override_of_a_slot_that_is_not_there_yet_is_refused() -> None:
    part = Part(enter=["llfsm/*"])
    assert requested(part, OVERRIDE) is None
    assert len(part.refused()) == 1


@pytest.mark.parametrize("action", ["suspend", "stop", "pause", "release", "reload"])
def test_a_request_that_gives_no_message_is_of_who_may_send_requests(action: Any) -> None:
    part = Part(enter=["llfsm/*"])
    part.board.add_message(ARM, Number(1))
    assert requested(part, MachineRequest(action)) == MachineRequest(action)


# What follows from a message of each kind in llfsm's own slots, if it enters from another host.
EFFECTS = {
    "llfsm/machine/": "shown",
    "llfsm/definition/": "shown",
    "llfsm/variables/": "shown",
    "llfsm/why/": "shown",
    "llfsm/commander/": "shown",
    "llfsm/executed/": "shown",
    "llfsm/folders": "shown",
    "llfsm/summary": "shown",
    "llfsm/viewer": "more is published",
    "llfsm/request/": "obeyed: an override is of who may add to all slots",
    "llfsm/will/": "posted: what the sender may not post is taken out",
    "llfsm/bell": "never enters",
    "llfsm/wills": "never enters",
    "llfsm/stand_ins": "never enters",
    "llfsm/recorder": "never enters",
    "llfsm/mirror": "never enters",
    "llfsm/hosts": "never enters",
    "llfsm/journal/": "never enters",
}


def own_slots() -> set[str]:
    """Name a slot of every kind that llfsm's processes have for each other."""
    slots = [each for each in vars(own).values() if isinstance(each, Slot)]
    for name, make in vars(own).items():
        if name.endswith("_slot") and not name.startswith("_"):
            slots.append(make(1) if name == "journal_slot" else make("host"))
    return {slot.name for slot in slots}


def test_every_kind_of_message_that_processes_act_on_has_a_gate() -> None:
    """Whoever adds a kind has to know what follows from it."""
    allowed = matcher(("*",))
    found = set()
    for name in own_slots():
        (kind,) = [each for each in EFFECTS if f"{name}/".startswith(f"{each.rstrip('/')}/")]
        found.add(kind)
        assert allowed(name) is (EFFECTS[kind] != "never enters"), name
    assert found == EFFECTS.keys()
