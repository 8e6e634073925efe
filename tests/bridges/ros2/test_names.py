from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.ros2.errors import RosNameError
from llfsm.bridges.ros2.graph import Names

BAD = [
    "",
    "/",
    "a b",
    "1a",
    "a/",
    "/a//b",
    "a-b",
    "a/1",
    "~a",
    "a~",
    "~/",
    "ä",
    "a\n",
    "{node}",
    "//a",
]


@pytest.mark.parametrize("name", BAD)
def test_a_name_of_a_topic_that_breaks_the_rules_is_refused(name):
    with pytest.raises(RosNameError) as raised:
        Names("node").full(name)
    assert repr(name) in str(raised.value)


@pytest.mark.parametrize("name", ["", "a/b", "1a", "a b", "~", "a\n", "x" * 256])
def test_a_name_of_a_node_that_breaks_the_rules_is_refused(name):
    with pytest.raises(RosNameError, match="node name"):
        Names(name)


@pytest.mark.parametrize("namespace", ["a b", "/a/", "//", "1", "/a//b"])
def test_a_namespace_that_breaks_the_rules_is_refused(namespace):
    with pytest.raises(RosNameError, match="namespace"):
        Names("node", namespace)


def test_a_bad_name_to_remap_is_refused():
    with pytest.raises(RosNameError, match="b b"):
        Names("node", remap={"a": "b b"})


def test_a_name_may_be_as_long_as_the_middleware_takes():
    assert len(Names("n").full("/" + "x" * 246)) == 247
    with pytest.raises(RosNameError, match="248 of 247"):
        Names("n").full("/" + "x" * 247)


@pytest.mark.parametrize(
    ("namespace", "name", "full"),
    [
        ("/", "a", "/a"),
        ("", "a/b", "/a/b"),
        ("ns", "a", "/ns/a"),
        ("/a/b", "c", "/a/b/c"),
        ("/a/b", "/c", "/c"),
        ("/a/b", "~/c", "/a/b/n/c"),
        ("/", "~", "/n"),
        ("/", "rotate/_action/send_goal", "/rotate/_action/send_goal"),
    ],
)
def test_a_name_is_made_full(namespace, name, full):
    assert Names("n", namespace).full(name) == full


@given(st.text(max_size=20))
def test_any_text_is_refused_or_becomes_a_full_name(text):
    names = Names("n", "/ns")
    try:
        full = names.full(text)
    except RosNameError:
        return
    assert full.startswith("/")
    assert names.full(full) == full
