from __future__ import annotations

import pytest
import xxhash
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.ros2.graph import Endpoint, Role
from llfsm.bridges.ros2.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    Qos,
    ReliabilityPolicy,
)
from llfsm.bridges.ros2.zenoh_transport.graph import (
    Token,
    data_key,
    endpoint_token,
    node_token,
    parse,
)
from llfsm.bridges.ros2.zenoh_transport.transport import open_node_session

HASH = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
TWIST = "geometry_msgs::msg::dds_::Twist_"
PARTS = st.from_regex(r"[a-z_][a-z0-9_]{0,5}", fullmatch=True)
NAMES = st.lists(PARTS, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
DURATIONS = st.integers(0, 2**63 - 3)  # above are "best available" and infinite
QOSES = st.builds(
    Qos,
    st.sampled_from(ReliabilityPolicy),
    st.sampled_from(DurabilityPolicy),
    st.sampled_from(HistoryPolicy),
    st.integers(1, 10_000),
    DURATIONS,
    DURATIONS,
    st.sampled_from(LivelinessPolicy),
    DURATIONS,
)
ALL_LIMITS = Qos(
    deadline_ns=1_000_000_005,
    lifespan_ns=2_000_000_006,
    liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
    lease_ns=7_000_000_008,
)


def cmd_vel(qos=Qos()):  # noqa: B008
    return Endpoint(
        Role.SUBSCRIPTION, "/turtlesim", "/turtle1/cmd_vel", "geometry_msgs/msg/Twist", HASH, qos
    )


def test_keys_are_as_rmw_zenoh_writes_them():
    node = node_token(0, "a1b2", 3, "/", "turtlesim")
    assert data_key(0, "/turtle1/cmd_vel", TWIST, HASH) == f"0/turtle1/cmd_vel/{TWIST}/{HASH}"
    assert node == "@ros2_lv/0/a1b2/3/3/NN/%/%/turtlesim"
    assert endpoint_token(node, 7, cmd_vel(), TWIST) == (
        f"@ros2_lv/0/a1b2/3/7/MS/%/%/turtlesim/%turtle1%cmd_vel/{TWIST}/{HASH}/::,10:,:,:,,"
    )
    limited = endpoint_token(node, 7, cmd_vel(ALL_LIMITS), TWIST)
    assert limited.rpartition("/")[2] == "::,10:1,5:2,6:3,7,8"
    assert node_token(5, "a1b2", 0, "/a/b", "n") == "@ros2_lv/5/a1b2/0/0/NN/%/%a%b/n"


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        ("::,10:,:,:,,", Qos()),
        ("::,:,:,:,,", Qos(depth=42)),  # what rmw_zenoh leaves out
        ("1:2:1,10:,:,:,,", Qos()),
        ("0:0:0,10:,:,:,,", Qos()),  # system defaults
        ("2::,5:,:,:,,", Qos(ReliabilityPolicy.BEST_EFFORT, depth=5)),
        (":1:,1:,:,:,,", Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)),
        ("::2,:,:,:,,", Qos(history=HistoryPolicy.KEEP_ALL, depth=42)),
        ("::,10:1,5:2,6:3,7,8", ALL_LIMITS),
        ("::,10:,:,:2,,", Qos(liveliness=LivelinessPolicy.MANUAL_BY_NODE)),
        ("3:3:3,10:,:,:4,,", Qos()),  # unknown, as of ends that another middleware relays
        ("::,10:9223372036,854775807:0,0:1,,", Qos()),  # infinite and unspecified
    ],
)
def test_a_qos_is_read_as_rmw_zenoh_means_it(text, qos):
    node = node_token(0, "a", 0, "/", "turtlesim")
    key = endpoint_token(node, 1, cmd_vel(), TWIST).rpartition("/")[0]
    assert parse(f"{key}/{text}") == Token("a", "/turtlesim", cmd_vel(qos))


@pytest.mark.parametrize("role", [Role.PUBLISHER, Role.SUBSCRIPTION])
@given(qos=QOSES.map(lambda qos: qos._replace(deadline_ns=0, lease_ns=0)))
def test_what_is_best_available_fits_all(role, qos):
    node = node_token(0, "a", 0, "/", "n")
    key = endpoint_token(node, 1, cmd_vel()._replace(role=role), TWIST).rpartition("/")[0]
    found = parse(f"{key}/4:4:,10:9223372036,854775806:,:5,9223372036,854775806").endpoint.qos
    requested, offered = (qos, found) if role is Role.PUBLISHER else (found, qos)
    assert requested.refused(offered) == []


@given(
    role=st.sampled_from(Role), namespace=st.just("/") | NAMES, node=PARTS, name=NAMES, qos=QOSES
)
def test_a_token_says_what_it_was_made_of(role, namespace, node, name, qos):
    full = f"{namespace.rstrip('/')}/{node}"
    end = Endpoint(role, full, name, "geometry_msgs/msg/Twist", HASH, qos)
    of_node = node_token(3, "abc", 1, namespace, node)
    assert parse(of_node) == Token("abc", full, None)
    assert parse(endpoint_token(of_node, 2, end, TWIST)) == Token("abc", full, end)


@pytest.mark.parametrize(
    "change",
    [
        lambda parts: parts[:-1],
        lambda parts: [*parts, "more"],
        lambda parts: ["@other", *parts[1:]],
        lambda parts: [*parts[:5], "XX", *parts[6:]],
        lambda parts: [*parts[:-1], ""],
        lambda parts: [*parts[:-1], "9:9:9,9:,:,:,,"],
        lambda parts: [*parts[:-1], "::x,y:,:,:,,"],
        lambda parts: parts[:3],
    ],
)
def test_what_is_no_token_is_not_taken_for_one(change):
    key = endpoint_token(node_token(0, "a", 0, "/", "n"), 1, cmd_vel(), TWIST)
    assert parse("/".join(change(key.split("/")))) is None


@given(st.text())
def test_any_text_is_a_token_or_not(text):
    parse(text)
    parse(f"@ros2_lv/0/a/0/1/MP/{text}")


def test_the_gid_of_a_message_is_made_of_its_endpoints_token(transport, domain, router, types):
    node = transport.node("we")
    publisher = node.publisher("chatter", types.message("std_msgs/msg/String"))
    with open_node_session([router])[0] as stranger:
        seen = stranger.liveliness().declare_subscriber(f"@ros2_lv/{domain}/**", history=True)
        token = next(key for key in (str(it.key_expr) for it in seen) if "/MP/" in key)
    assert publisher.gid == xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")
