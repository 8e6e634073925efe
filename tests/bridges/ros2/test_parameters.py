"""Parameters: what is refused and why, and what their services answer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.ros2.errors import ParameterOverrideError
from llfsm.bridges.ros2.node_parameters import NodeParameters, Parameter, ParameterType, type_of
from llfsm.bridges.ros2.parameter_server import ParameterServer
from llfsm.bridges.ros2.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    Qos,
    ReliabilityPolicy,
    overridden,
)
from llfsm.bridges.ros2.types import TypeLibrary
from memory_transport import MemoryTransport, MemoryWorld
from waiting import PATIENCE_S

TYPES = TypeLibrary()
NODE = "/ns/robot"
DECLARED = {
    "speed": Parameter(0.5, "How fast"),
    "name": Parameter("r2"),
    "count": Parameter(3, range=(-1, 9)),
    "arm.length": Parameter(2),
    "arm.hand.open": Parameter(False),
    "armour": Parameter(True),
    "gain": Parameter(1.0, range=(0.0, 2.0)),
    "serial": Parameter("x1", read_only=True),
}


def message(kind, /, **fields):
    return TYPES.message(f"rcl_interfaces/msg/{kind}").message(**fields)


@pytest.fixture
def parameters():
    return NodeParameters(DECLARED)


@pytest.fixture
def call(parameters):
    """Call a service of the parameters' server."""
    world = MemoryWorld()
    with MemoryTransport(world) as ours, MemoryTransport(world) as theirs:
        ParameterServer(ours.node("robot", "ns"), TYPES, parameters, lambda do: do())
        node = theirs.node("tool")

        def call(name, **fields):
            of = TYPES.service(
                f"rcl_interfaces/srv/{''.join(map(str.capitalize, name.split('_')))}"
            )
            client = node.client(f"{NODE}/{name}", of)
            return client.call(of.request.message(**fields), timeout=PATIENCE_S).result(PATIENCE_S)

        call.node = node
        yield call


def wanted(**values):
    """Return parameters for a request to set them; `__` stands for the separator."""
    fields = {bool: "bool", int: "integer", float: "double", str: "string", bytes: "byte_array"}
    return tuple(
        message(
            "Parameter",
            name=name.replace("__", "."),
            value=message(
                "ParameterValue",
                type=int(type_of(value)),
                **({f"{fields[type(value)]}_value": value} if value is not None else {}),
            ),
        )
        for name, value in values.items()
    )


@given(
    st.sampled_from(sorted(DECLARED)),
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-20, 20),
        st.floats(),
        st.text(),
        st.binary(),
        st.lists(st.booleans()).map(tuple),
        st.lists(st.text()).map(tuple),
    ),
)
def test_a_parameter_keeps_its_type_and_its_range(name, value):
    parameters = NodeParameters(DECLARED)
    declared = DECLARED[name]
    fits = type(value) is type(declared.default) and not declared.read_only
    if declared.range and fits:
        fits = declared.range[0] <= value <= declared.range[1]
    assert (parameters.refusal((name, value)) is None) == fits


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (True, "bool"),
        (1, "integer"),
        (1.0, "double"),
        ("1", "string"),
        (b"1", "byte_array"),
        ((True,), "bool_array"),
        ((1,), "integer_array"),
        ((1.0,), "double_array"),
        (("1",), "string_array"),
        ((), "byte_array"),
    ],
)
def test_a_reason_names_both_types(value, kind):
    assert str(type_of(value)) == kind
    parameters = NodeParameters({"x": Parameter(0 if kind == "string" else "")})
    if kind == "string":
        assert "is of type {integer}, setting it to {string}" in parameters.refusal(("x", value))
    else:
        assert f"is of type {{string}}, setting it to {{{kind}}}" in parameters.refusal(
            ("x", value)
        )


def test_values_and_types_are_answered_in_the_order_of_the_names(call):
    names = ("count", "name", "armour", "speed")
    values = call("get_parameters", names=names).values
    assert values == (
        message("ParameterValue", type=2, integer_value=3),
        message("ParameterValue", type=4, string_value="r2"),
        message("ParameterValue", type=1, bool_value=True),
        message("ParameterValue", type=3, double_value=0.5),
    )
    assert list(call("get_parameter_types", names=names).types) == [
        ParameterType.INTEGER,
        ParameterType.STRING,
        ParameterType.BOOL,
        ParameterType.DOUBLE,
    ]


def test_one_unknown_name_leaves_the_whole_answer_empty(call):
    names = ("count", "nosuch")
    assert call("get_parameters", names=names).values == ()
    assert call("get_parameter_types", names=names).types == b""
    assert call("describe_parameters", names=names).descriptors == ()


def test_descriptions(call):
    speed, count = call("describe_parameters", names=("speed", "count")).descriptors
    assert speed == message("ParameterDescriptor", name="speed", type=3, description="How fast")
    (limits,) = count.integer_range
    assert (count.type, limits.from_value, limits.to_value, limits.step) == (2, -1, 9, 1)


ALL = sorted(DECLARED)


@pytest.mark.parametrize(
    ("prefixes", "depth", "names", "found"),
    [
        ((), 0, ALL, ["arm.hand", "arm"]),
        ((), 1, ["armour", "count", "gain", "name", "serial", "speed"], []),
        ((), 2, ["arm.length", "armour", "count", "gain", "name", "serial", "speed"], ["arm"]),
        (("arm",), 0, ["arm.hand.open", "arm.length"], ["arm.hand", "arm"]),
        (("arm",), 1, ["arm.length"], ["arm"]),
        (("arm.hand", "speed"), 1, ["arm.hand.open", "speed"], ["arm.hand"]),
        (("nosuch",), 0, [], []),
    ],
)
def test_listing(call, prefixes, depth, names, found):
    result = call("list_parameters", prefixes=prefixes, depth=depth).result
    assert list(result.names) == names
    assert list(result.prefixes) == found


def test_each_is_set_for_itself(call, parameters):
    results = call("set_parameters", parameters=wanted(count=5, name=1, nosuch=1, arm__length=4))
    assert [result.successful for result in results.results] == [True, False, False, True]
    assert parameters.values() | {"count": 5, "arm.length": 4} == parameters.values()
    assert parameters.values()["name"] == "r2"


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"nosuch": 1}, "not declared"),
        ({"count": 10}, "{count}"),
        ({"name": None}, "undeclare"),
        ({"name": b""}, "{name}"),
    ],
)
def test_all_are_set_or_none(call, parameters, bad, reason):
    before = parameters.values()
    result = call("set_parameters_atomically", parameters=wanted(speed=2.0, **bad)).result
    assert not result.successful
    assert reason in result.reason
    assert parameters.values() == before
    good = wanted(speed=2.0, count=9)
    assert call("set_parameters_atomically", parameters=good).result.successful
    assert (parameters.values()["speed"], parameters.values()["count"]) == (2.0, 9)


def test_a_type_that_nobody_knows_is_refused(call):
    strange = message("Parameter", name="count", value=message("ParameterValue", type=99))
    (result,) = call("set_parameters", parameters=(strange,)).results
    assert result.reason == "cannot undeclare a statically typed parameter"


def test_events_tell_what_was_set_together(call, seen):
    got = seen()
    event = TYPES.message("rcl_interfaces/msg/ParameterEvent")
    call.node.subscription("/parameter_events", event, lambda arrival: got(arrival.decode()))
    call("set_parameters", parameters=wanted(count=1, name="a"))
    call("set_parameters_atomically", parameters=wanted(count=10, name="b"))
    call("set_parameters_atomically", parameters=wanted(count=2, name="c"))
    got.wait(lambda got: len(got) == 3)
    reported = [
        {each.name: each.value.integer_value or each.value.string_value for each in changed}
        for changed in (one.changed_parameters for one in got)
    ]
    assert reported == [{"count": 1}, {"name": "a"}, {"count": 2, "name": "c"}]
    assert {one.node for one in got} == {NODE}
    assert all(one.stamp.sec > 1_600_000_000 for one in got)


def test_an_event_announces_what_a_node_has_declared(seen):
    world, got = MemoryWorld(), seen()
    event = TYPES.message("rcl_interfaces/msg/ParameterEvent")
    with MemoryTransport(world) as ours, MemoryTransport(world) as theirs:
        topic = "/parameter_events"
        theirs.node("tool").subscription(topic, event, lambda arrival: got(arrival.decode()))
        ParameterServer(ours.node("robot"), TYPES, NodeParameters(DECLARED), lambda do: do())
        got.wait(len)
    assert sorted(one.name for one in got[0].new_parameters) == ALL
    assert not got[0].changed_parameters


def test_what_is_read_only_cannot_be_set_and_is_described_so(call):
    (result,) = call("set_parameters", parameters=wanted(serial="x2")).results
    assert result.reason == "parameter 'serial' cannot be set because it is read-only"
    (described,) = call("describe_parameters", names=("serial",)).descriptors
    assert described.read_only


def test_a_range_of_floats(call):
    (result,) = call("set_parameters", parameters=wanted(gain=2.5)).results
    assert result.reason == "Parameter {gain} doesn't comply with floating point range."
    assert call("set_parameters", parameters=wanted(gain=0.0)).results[0].successful
    (described,) = call("describe_parameters", names=("gain",)).descriptors
    (limits,) = described.floating_point_range
    assert (limits.from_value, limits.to_value) == (0.0, 2.0)
    assert described.integer_range == ()


def test_reasons_for_several_at_once_are_rclcpps(call):
    several = call("set_parameters_atomically", parameters=wanted(count=1, nosuch=1)).result
    assert several.reason == "One or more parameters were not declared before setting"
    for bad, first in (
        ({"count": 10, "name": None, "serial": "x2"}, "read-only"),
        ({"count": 10, "name": None}, "undeclare"),
        ({"count": 10, "name": 1}, "{count}"),
    ):
        refused = call("set_parameters_atomically", parameters=wanted(**bad)).result
        assert first in refused.reason
    nothing = call("set_parameters_atomically", parameters=()).result
    assert nothing.reason.startswith("parameter list cannot be empty")


def test_overrides_are_the_values_at_the_start_and_must_fit():
    set_to = []
    parameters = NodeParameters(DECLARED)
    parameters.override({"count": 5, "serial": "x9", "later": 2, "nosuch": 1})
    parameters.declare({"later": Parameter(1, changed=set_to.append)})
    parameters.assign("later", 3)
    parameters.assign("later", 2)
    assert parameters.values() | {"count": 5, "serial": "x9", "later": 2} == parameters.values()
    assert set_to == [2, 3, 2]
    for bad in ({"count": 5.0}, {"count": 10}, {"gain": 3.0}, {"serial": True}):
        with pytest.raises(ParameterOverrideError, match=next(iter(bad))):
            NodeParameters(DECLARED).override(bad)


EVENTS = "qos_overrides./parameter_events.publisher."


def test_qos_overrides_are_parameters_and_are_followed():
    parameters = NodeParameters()
    parameters.override({EVENTS + "depth": 5, EVENTS + "reliability": "best_effort"})
    qos = overridden(Qos(depth=1000), parameters, "/parameter_events", "publisher")
    assert qos == Qos(ReliabilityPolicy.BEST_EFFORT, depth=5)
    assert parameters.values() == {
        EVENTS + "depth": 5,
        EVENTS + "durability": "volatile",
        EVENTS + "history": "keep_last",
        EVENTS + "reliability": "best_effort",
    }
    assert all(one.read_only for one in parameters.declared.values())


def test_every_policy_of_an_end_can_be_overridden():
    parameters, prefix = NodeParameters(), "qos_overrides./scan.subscription."
    parameters.override(
        {
            prefix + "deadline": 10**9,
            prefix + "liveliness": "manual_by_topic",
            prefix + "liveliness_lease_duration": 5,
            prefix + "durability": "transient_local",
        }
    )
    qos = overridden(Qos(), parameters, "/scan", "subscription", every=True)
    assert qos == Qos(
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        deadline_ns=10**9,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        lease_ns=5,
    )
    assert prefix + "lifespan" not in parameters.declared  # it is only offered
    overridden(Qos(), parameters, "/scan", "publisher", every=True)
    assert parameters.values()["qos_overrides./scan.publisher.lifespan"] == 0


@pytest.mark.parametrize(
    ("policy", "value"),
    [
        ("depth", 0),
        ("history", "some"),
        ("depth", 2**31),
        ("deadline", -1),
        ("liveliness", "manual_by_node"),
    ],
)
def test_a_policy_that_is_none_is_refused(policy, value):
    parameters = NodeParameters()
    parameters.override({EVENTS + policy: value})
    with pytest.raises(ParameterOverrideError, match=f"{policy}={value}"):
        overridden(Qos(), parameters, "/parameter_events", "publisher", every=True)
