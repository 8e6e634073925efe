"""What holds for any requests at any steps, and what is refused."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.turtlesim.canvas import Pen, Rgb
from llfsm.bridges.turtlesim.errors import TurtlesimError
from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.bridges.turtlesim.turtle import FIELD, PI, Level, float32, normalize

speeds = st.floats(-1000, 1000)
places = st.floats(-1e6, 1e6)
names = st.sampled_from(["turtle1", "turtle2", "turtle3", "bob", "Zoe", "_x", "a/b"])

requests = st.one_of(
    st.tuples(st.just("step")),
    st.tuples(st.just("command"), names, speeds, speeds, speeds),
    st.tuples(st.just("teleport_absolute"), names, places, places, speeds),
    st.tuples(st.just("teleport_relative"), names, places, speeds),
    st.tuples(st.just("rotate_absolute"), names, speeds),
    st.tuples(
        st.just("set_pen"), names, *[st.integers(0, 255)] * 3, st.integers(0, 9), st.booleans()
    ),
    st.tuples(st.just("spawn"), places, places, speeds, st.one_of(st.just(""), names)),
    st.tuples(st.just("kill"), names),
    st.tuples(st.just("clear")),
    st.tuples(st.just("reset")),
)
OF_A_TURTLE = {"command", "teleport_absolute", "teleport_relative", "rotate_absolute", "set_pen"}


def request(simulator, name, *arguments):
    """Make a request, unless it is for a turtle that is not there."""
    if name not in OF_A_TURTLE or arguments[0] in simulator.turtles:
        return getattr(simulator, name)(*arguments)
    return None


def is_float32(value):
    return struct.unpack("f", struct.pack("f", value))[0] == value


@given(st.lists(requests, max_size=60), st.booleans())
def test_poses_stay_in_the_field_as_float32(script, holonomic):
    simulator = Simulator()
    simulator.parameters.set("holonomic", holonomic)
    for item in script:
        request(simulator, *item)
    simulator.step()
    for turtle in simulator.turtles.values():
        pose = turtle.pose
        assert all(map(is_float32, pose))
        assert 0 <= pose.x <= FIELD
        assert 0 <= pose.y <= FIELD
        assert -PI - 1e-6 <= pose.theta <= PI + 1e-6
        assert pose.linear_velocity >= 0


@given(st.lists(requests, max_size=60))
def test_the_same_requests_give_the_same_run(script):
    def run():
        log = []
        simulator = Simulator(log=lambda level, text: log.append((level, text)))
        for item in script:
            log.append(request(simulator, *item) if item[0] == "spawn" else None)
            if item[0] != "spawn":
                request(simulator, *item)
            log.extend((t.name, t.pose, t.color) for t in simulator.turtles.values())
        return log, [stroke.points for stroke in simulator.canvas.strokes]

    assert run() == run()


@given(st.lists(requests, max_size=60))
def test_spawn_kill_and_reset_keep_the_turtles_in_order(script):
    simulator = Simulator()
    for name, *arguments in script:
        before = set(simulator.turtles)
        answer = request(simulator, name, *arguments)
        after = list(simulator.turtles)
        assert after == sorted(after)
        if name == "spawn":
            assert set(after) == before | ({answer} - {""})
            assert (answer == "") == (arguments[3] in before)
        elif name == "kill":
            assert set(after) == before - {arguments[0]}
        elif name == "reset":
            assert after == ["turtle1"]
        else:
            assert set(after) == before


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_rounding_to_float32(value):
    try:
        expected = struct.unpack("f", struct.pack("f", value))[0]
    except OverflowError:
        expected = math.copysign(math.inf, value)
    assert float32(value) == expected


@given(st.floats(-1e6, 1e6))
def test_wrapping_keeps_the_direction(angle):
    wrapped = normalize(angle)
    assert -PI - 1e-9 <= wrapped <= PI + 1e-9
    turns = (angle - wrapped) / (2 * PI)
    assert turns == pytest.approx(round(turns), abs=1e-6)


def test_a_free_name_is_the_next_never_given(simulator):
    assert simulator.spawn(1, 1, 0) == "turtle2"
    assert simulator.spawn(1, 1, 0, "turtle3") == "turtle3"
    simulator.kill("turtle2")
    assert simulator.spawn(1, 1, 0) == "turtle4"
    simulator.reset()
    assert simulator.spawn(1, 1, 0) == "turtle2"


@pytest.mark.parametrize("name", ["bob", "_b", "B0b_", "fleet/bob", "x" * 210])
def test_legal_names(simulator, name):
    assert simulator.spawn(1, 1, 0, name) == name


@pytest.mark.parametrize(
    "name",
    ["bad name!", "1st", "a-b", "é", "/bob", "bob/", "a//b", "a/1", "~", "{node}", "a\n", " "],
)
def test_illegal_names_are_refused_and_logged(simulator, log, name):
    assert simulator.spawn(1, 1, 0, name) == ""
    assert log == [
        (
            Level.ERROR,
            f"Cannot spawn a turtle named {name!r}: a name is made of letters, digits and '_', "
            "does not start with a digit, and may join several such parts by '/'",
        )
    ]
    assert list(simulator.turtles) == ["turtle1"]


def test_a_name_too_long_for_its_topics_is_refused(simulator, log):
    assert simulator.spawn(1, 1, 0, "x" * 211) == ""
    assert log[0][0] is Level.ERROR
    assert log[0][1].endswith("it has more than 210 characters")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("request_", "act"),
    [
        (lambda s, bad: s.command("turtle1", 1.0, 0.0, bad), "move turtle [turtle1]"),
        (lambda s, bad: s.teleport_absolute("turtle1", 1.0, bad, 0), "teleport turtle [turtle1]"),
        (lambda s, bad: s.teleport_relative("turtle1", bad, 0), "teleport turtle [turtle1]"),
        (lambda s, bad: s.rotate_absolute("turtle1", bad), "rotate turtle [turtle1]"),
        (lambda s, bad: s.spawn(bad, 1, 1, "bob"), "spawn a turtle"),
    ],
    ids=["command", "teleport_absolute", "teleport_relative", "rotate_absolute", "spawn"],
)
def test_numbers_that_are_not_finite_are_refused_and_logged(simulator, log, request_, act, bad):
    before = simulator.turtle("turtle1").pose
    assert not request_(simulator, bad)
    simulator.step()
    assert simulator.turtle("turtle1").pose == before
    assert list(simulator.turtles) == ["turtle1"]
    ((level, text),) = log
    assert level is Level.ERROR
    assert text.startswith(f"Cannot {act}: not all finite: ")
    assert str(bad) in text


def test_enormous_finite_speeds_are_survived(simulator):
    simulator.command("turtle1", 1e308, 0.0, -1e308)
    simulator.step()
    simulator.step()
    pose = simulator.turtle("turtle1").pose
    assert pose.linear_velocity == math.inf  # as C converts it to float32
    assert 0 <= pose.x <= FIELD
    assert 0 <= pose.y <= FIELD


@pytest.mark.parametrize(
    "request_",
    [
        lambda s: s.turtle("bob"),
        lambda s: s.command("bob", 1, 0, 0),
        lambda s: s.set_pen("bob", 1, 2, 3, 4),
        lambda s: s.teleport_absolute("bob", 1, 1, 1),
        lambda s: s.teleport_relative("bob", 1, 1),
        lambda s: s.rotate_absolute("bob", 1),
    ],
)
def test_an_unknown_turtle_is_an_error_that_lists_the_others(simulator, request_):
    simulator.spawn(1, 1, 0)
    with pytest.raises(TurtlesimError) as caught:
        request_(simulator)
    assert str(caught.value) == "no turtle is named 'bob'; there are: turtle1, turtle2"


def test_an_unknown_turtle_when_there_are_none(simulator):
    simulator.kill("turtle1")
    with pytest.raises(TurtlesimError, match="there are: none"):
        simulator.turtle("turtle1")


@pytest.mark.parametrize("field", ["r", "g", "b", "width"])
@pytest.mark.parametrize("value", [-1, 256])
def test_a_pen_beyond_uint8_is_an_error(simulator, field, value):
    pen = {"r": 1, "g": 2, "b": 3, "width": 4} | {field: value}
    with pytest.raises(TurtlesimError, match=f"a pen's {field} is from 0 to 255, not {value}"):
        simulator.set_pen("turtle1", **pen)
    assert simulator.turtle("turtle1").pen == Pen()


def test_pens(simulator):
    turtle = simulator.turtle("turtle1")
    assert turtle.pen == Pen(Rgb(179, 184, 255), 3)
    simulator.set_pen("turtle1", 1, 2, 3, 0)
    assert turtle.pen == Pen(Rgb(1, 2, 3), 1)
    simulator.set_pen("turtle1", 9, 9, 9, 9, off=True)
    assert (turtle.pen, turtle.pen_down) == (Pen(Rgb(1, 2, 3), 1), False)
    simulator.set_pen("turtle1", 4, 5, 6, 7)
    assert (turtle.pen, turtle.pen_down) == (Pen(Rgb(4, 5, 6), 7), True)


def test_a_command_without_holonomic_keeps_the_last_speed_aside(simulator):
    simulator.parameters.set("holonomic", True)
    simulator.command("turtle1", 0.0, 1.0, 0.0)
    simulator.step()
    simulator.parameters.set("holonomic", False)
    simulator.command("turtle1", 0.0, 5.0, 0.0)
    simulator.step()
    assert simulator.turtle("turtle1").pose.linear_velocity == 1.0


def test_teleports_apply_in_order_at_the_next_step(simulator):
    before = simulator.turtle("turtle1").pose
    simulator.teleport_absolute("turtle1", 2.0, 3.0, 0.0)
    simulator.teleport_relative("turtle1", 1.0, math.pi / 2)
    assert simulator.turtle("turtle1").pose == before
    simulator.step()
    pose = simulator.turtle("turtle1").pose
    assert (pose.x, pose.y) == pytest.approx((2.0, 4.0), abs=1e-6)


def test_what_was_drawn_outlives_its_turtle_but_no_reset(simulator):
    simulator.command("turtle1", 2.0, 0.0, 0.0)
    simulator.step()
    simulator.kill("turtle1")
    assert [stroke.turtle for stroke in simulator.canvas.strokes] == ["turtle1"]
    simulator.reset()
    assert simulator.canvas.strokes == ()


def test_a_motion_too_small_for_qt_draws_nothing(simulator):
    simulator.command("turtle1", 1e-11, 0.0, 0.0)
    simulator.step()
    assert simulator.canvas.strokes == ()


def test_a_log_may_change_the_turtles(simulator):
    """A callback that answers a line with a request does not disturb the step under way."""

    def kill(level, text):
        if level is Level.WARN:
            simulator.kill("a")
            simulator.spawn(1, 1, 0)

    simulator = Simulator(log=kill)
    simulator.spawn(20, 1, 0, "a")
    simulator.spawn(1, 1, 0, "b")
    simulator.step()
    assert list(simulator.turtles) == ["b", "turtle1", "turtle2"]


WHITE = Rgb(255, 255, 255)


def test_the_color_sensor_reads_what_was_drawn_before(simulator):
    turtle = simulator.turtle("turtle1")
    simulator.step()
    assert turtle.color == WHITE  # nothing is drawn here: the background is no drawing
    simulator.command("turtle1", 2.0, 0.0, 0.0)
    for _ in range(70):
        simulator.step()
    assert turtle.color == turtle.pen.color  # it stands on the end of its own trail
    simulator.command("turtle1", 0.0, 0.0, 3.0)
    for _ in range(10):
        simulator.step()
    simulator.command("turtle1", 10.0, 0.0, 0.0)
    simulator.step()
    assert turtle.color == WHITE  # the line to here is drawn after the reading
    simulator.teleport_absolute("turtle1", 3.0, 8.0, 0.0)
    simulator.command("turtle1", 0.0, 0.0, 0.0)
    simulator.step()
    assert turtle.color == turtle.pen.color  # a teleport's line is drawn before
    simulator.clear()
    simulator.step()
    assert turtle.color == WHITE


def test_a_turtle_reads_what_another_drew(simulator):
    simulator.set_pen("turtle1", 200, 0, 0, 9)
    simulator.teleport_absolute("turtle1", 9.0, 9.0, 0.0)
    simulator.step()
    simulator.spawn(8.0, 8.0, 0.0, "bob")
    simulator.kill("turtle1")
    simulator.step()
    assert simulator.turtle("bob").color == Rgb(200, 0, 0)
