from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.ros2.transport import MessageInfo
from llfsm.bridges.ros2.zenoh_transport.endpoints import pack, unpack

INT64 = st.integers(-(2**63), 2**63 - 1)


def test_the_bytes_are_those_of_rmw_zenoh():
    gid = bytes(range(16))
    expected = (5).to_bytes(8, "little") + (1_000).to_bytes(8, "little") + b"\x10" + gid
    assert pack(5, 1_000, gid) == expected


@given(INT64, INT64, st.binary(min_size=16, max_size=16))
def test_what_is_packed_is_unpacked(sequence, time_ns, gid):
    assert unpack(pack(sequence, time_ns, gid)) == MessageInfo(time_ns, sequence, gid)


@given(st.binary(max_size=40))
def test_other_bytes_are_no_attachment(data):
    info = unpack(data)
    assert (info is not None) == (len(data) == 33 and data[16] == 16)


def test_a_gid_of_another_length_is_none():
    assert unpack(b"\0" * 16 + b"\x0f" + b"\0" * 16) is None
