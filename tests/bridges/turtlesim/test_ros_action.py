"""The action rotate_absolute of our node: goals, feedback and ends as recorded."""

from __future__ import annotations

import re
from uuid import uuid4

import pytest

from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.runtime.goals import GoalStatus

NAME = "/turtle1/rotate_absolute/_action"
TYPE = "turtlesim/action/RotateAbsolute"


class Client:
    """A client of the action, made of its services and topics."""

    def __init__(self, ros):
        self.ros = ros
        self.feedback = ros.hear(f"{NAME}/feedback", f"{TYPE}_FeedbackMessage")
        kept = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=100)
        self.statuses = ros.hear(f"{NAME}/status", "action_msgs/msg/GoalStatusArray", kept)

    def send(self, theta):
        """Send a goal; return its id, and whether it was accepted."""
        id_of = self.ros.types.message("unique_identifier_msgs/msg/UUID").message
        goal_of = self.ros.types.message(f"{TYPE}_Goal").message
        goal_id = id_of(uuid=uuid4().bytes)
        answer = self.ros.call(
            f"{NAME}/send_goal", f"{TYPE}_SendGoal", goal_id=goal_id, goal=goal_of(theta=theta)
        )
        return goal_id, answer.accepted

    def result(self, goal_id):
        """Ask for a goal's result without waiting for it."""
        return self.ros.ask(f"{NAME}/get_result", f"{TYPE}_GetResult", goal_id=goal_id)

    def cancel(self, goal_id):
        info = self.ros.types.message("action_msgs/msg/GoalInfo").message(goal_id=goal_id)
        return self.ros.call(f"{NAME}/cancel_goal", "action_msgs/srv/CancelGoal", goal_info=info)

    def status(self, goal_id):
        """Return the latest status that was published of a goal; None if it is not there yet."""
        found = (
            GoalStatus(each.status)
            for statuses in self.statuses[-1:]
            for each in statuses.status_list
            if each.goal_info.goal_id == goal_id
        )
        return next(found, None)


def fields(message):
    return {name: getattr(message, name) for name in message.__struct_fields__}


@pytest.fixture
def client(ros):
    return Client(ros)


@pytest.mark.parametrize("ros", ["memory", "zenoh"], indirect=True)
def test_recorded_goals(ros, client, recorded, log):
    poses = ros.hear("/turtle1/pose", "turtlesim/msg/Pose")
    for record in recorded("turtlesim_action.json"):
        replay(client, poses, record, log)
        poses.clear()
        ros.step(60)  # until the command that ended the goal has ended
        ros.until(lambda: len(poses) == 60)


def replay(client, poses, record, log):
    ros, label, count = client.ros, record["label"], record["feedback_count"]
    log.clear()
    client.feedback.clear()
    assert not poses or fields(poses[-1]) == record["start"], label
    poses.clear()
    goal_id, accepted = client.send(record["goal_theta"])
    assert accepted is record["accepted"]
    result = client.result(goal_id)
    ros.step(count)
    if "after 0.5 s" not in label:
        steps = 1
    elif "cancelled" in label:
        assert not result.done()
        assert client.cancel(goal_id).return_code == 0
        steps = 1
    else:
        assert not result.done()
        ros.command(x=0.5)
        steps = 4  # when the recorder looked
    ros.step(steps)
    ros.until(result.done)
    end = result.result()
    assert (end.status, end.result.delta) == (record["status"], record["delta"]), label
    ros.until(lambda: len(client.feedback) >= count)
    assert all(each.goal_id == goal_id for each in client.feedback)
    reported = [each.feedback.remaining for each in client.feedback]
    assert len(reported) == count, label
    assert reported[:2] == record["feedback_first"], label
    assert reported[-2:] == record["feedback_last"], label
    ros.until(lambda: len(poses) == count + steps)
    assert fields(poses[-1]) == record["end"], label
    expected = re.fullmatch(r"\[(\w+)\] \[.*\] \[turtlesim\]: (.*)", *record["log"]).groups()
    assert [(level.name, text) for level, text in log] == [expected], label
    ros.until(lambda: client.status(goal_id) == record["status"])


def test_a_newer_goal_aborts_the_one_before(ros, client, log):
    first, _ = client.send(3.0)
    ended = client.result(first)
    ros.step(10)
    second, accepted = client.send(-1.0)
    assert accepted
    ros.until(ended.done)
    assert ended.result().status == GoalStatus.ABORTED
    assert ended.result().result.delta == pytest.approx(-9 * 0.016)
    assert log[-1][1].startswith("Rotation goal received before a previous goal finished.")
    ros.until(lambda: client.status(second) is GoalStatus.EXECUTING)
    assert client.status(first) is GoalStatus.ABORTED


def test_a_goal_that_is_no_number_is_refused_and_the_one_before_goes_on(ros, client, log):
    first, _ = client.send(3.0)
    ros.step()
    refused, accepted = client.send(float("nan"))
    assert not accepted
    assert log[-1][0].name == "ERROR"
    unknown = client.result(refused)
    ros.until(unknown.done)
    assert unknown.result().status == GoalStatus.UNKNOWN
    client.feedback.clear()
    ros.step()
    ros.until(lambda: client.feedback)
    assert client.feedback[0].goal_id == first


@pytest.mark.parametrize("end", ["kill", "reset"])
def test_a_goal_whose_turtle_goes_has_ended_cancelled(ros, client, end):
    goal_id, _ = client.send(3.0)
    result = client.result(goal_id)
    ros.step()
    if end == "kill":
        ros.call("/kill", "turtlesim/srv/Kill", name="turtle1")
    else:
        ros.call("/reset", "std_srvs/srv/Empty")
    ros.until(result.done)
    assert result.result().status == GoalStatus.CANCELED
    ros.step()


def test_a_command_has_ended_a_goal_before_a_later_request_is_looked_at(ros, client):
    goal_id, _ = client.send(3.0)
    ros.step()
    ros.command(x=1.0)
    terminated = 3
    assert client.cancel(goal_id).return_code == terminated
    ros.until(lambda: client.status(goal_id) is GoalStatus.ABORTED)


def test_a_flood_of_goals_keeps_neither_the_poses_back_nor_all_results(ros, client):
    poses = ros.hear("/turtle1/pose", "turtlesim/msg/Pose")
    first, _ = client.send(3.0)
    for number in range(520):
        latest, _ = client.send(number / 100)
    ros.until(lambda: client.status(latest))
    assert len(client.statuses[-1].status_list) <= 502
    answer = client.result(first)
    ros.until(answer.done)
    assert answer.result().status == GoalStatus.UNKNOWN
    for _ in range(3000):
        ros.turtlesim.queue.put(lambda: None)
    before = len(poses)
    ros.step()
    ros.until(lambda: len(poses) > before)
