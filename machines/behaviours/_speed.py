"""Limits of a velocity, and of how fast it changes."""

from math import copysign

from llfsm.machines.behaviours._slots import CMD_VEL, INPUT, REST
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3


class SpeedLimit(Machine):
    """Pass velocities on, ahead and of the turn, up to a limit; at rest while none arrives.

    Args:
        linear: m/s, ahead and back.
        angular: rad/s, to both sides.

    """

    input = Sensor(INPUT, default=REST, max_age_ms=500)
    cmd_vel = Actuator(CMD_VEL, at_end=REST)
    linear: float = 0.5
    angular: float = 1.0

    LIMITING = State(final=False)

    @LIMITING.internal
    def _(self) -> None:
        ahead = _limited(self.input.linear.x, self.linear)
        turn = _limited(self.input.angular.z, self.angular)
        self.cmd_vel(Twist(Vector3(x=ahead), Vector3(z=turn)))


class Ramp(Machine):
    """Follow velocities by steps, one a turn, so that a robot neither jerks nor tips over.

    While none arrives, it slows down to rest by the same steps. An end or a failure posts rest at
    once.

    Args:
        linear_step: m/s in a turn: an acceleration in m/s², times the period of the arrangement.
        angular_step: rad/s in a turn, likewise.

    """

    input = Sensor(INPUT, default=REST, max_age_ms=500)
    cmd_vel = Actuator(CMD_VEL, at_end=REST)
    linear_step: float = 0.05
    angular_step: float = 0.1
    linear: float = 0.0
    angular: float = 0.0

    FOLLOWING = State(final=False)

    @FOLLOWING.on_entry
    def _(self) -> None:
        self.linear = self.angular = 0.0  # at rest, also before it is resumed

    @FOLLOWING.internal
    def _(self) -> None:
        self.linear += _limited(self.input.linear.x - self.linear, self.linear_step)
        self.angular += _limited(self.input.angular.z - self.angular, self.angular_step)
        self.cmd_vel(Twist(Vector3(x=self.linear), Vector3(z=self.angular)))


def _limited(value: float, most: float) -> float:
    """Cut a value to a range around 0; what is no number is 0."""
    if value != value:  # NaN
        return 0.0
    return value if abs(value) <= most else copysign(most, value)
