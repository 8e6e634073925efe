"""A goal of the action rotate_absolute: turn on the spot to a heading."""

from llfsm.runtime.goals import GoalStatus

from .arithmetic import float32, normalize

__all__ = ["RotateGoal"]

SPEED = 1.0  # rad/s
NEAR = 0.02  # rad; closer than this the goal is reached


class RotateGoal:
    """Follow one accepted goal to its end.

    theta: the wanted heading in rad, float32; it may lie beyond pi.
    status: where the goal stands; SUCCEEDED, CANCELED and ABORTED are final.
    remaining: the latest feedback, rad still to turn, float32; new after each step that begins
        with the status EXECUTING, the one that succeeds included.
    delta: the result, start minus end in rad, float32, as of the latest feedback.
    """

    __slots__ = ("_start", "delta", "remaining", "status", "theta")

    def __init__(self, theta: float, start: float) -> None:
        self.theta = theta
        self.status = GoalStatus.EXECUTING
        self.remaining = 0.0
        self.delta = 0.0
        self._start = start

    @property
    def active(self) -> bool:
        """Whether the goal has not ended."""
        return self.status.active

    def cancel(self) -> bool:
        """Ask for the goal's end at the next step; return False if it has ended already."""
        if self.active:
            self.status = GoalStatus.CANCELING
            return True
        return False

    def advance(self, heading: float) -> float:
        """Go on by a step from a heading in rad; return the speed to turn at, 0 at the end."""
        if self.status is GoalStatus.CANCELING:
            self.status = GoalStatus.CANCELED
            return 0.0
        # turtlesim mixes precisions here: the heading as float32, the goal wrapped as double.
        goal = normalize(self.theta)
        remaining = normalize(goal - float32(heading))
        self.delta = float32(normalize(float32(self._start - heading)))
        self.remaining = float32(remaining)
        if abs(normalize(float32(heading) - goal)) < NEAR:
            self.status = GoalStatus.SUCCEEDED
            return 0.0
        return -SPEED if remaining < 0.0 else SPEED
