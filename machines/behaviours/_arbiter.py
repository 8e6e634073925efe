"""One of several sources of velocity, by priority and freshness, as ``twist_mux`` chooses."""

from llfsm.machines.behaviours._slots import AUTONOMY, BOOLS, CMD_VEL, EMERGENCY, REST, TELEOP
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard.messages.std_msgs import Bool


class CommandArbiter(Machine):
    """Pass on what a person commands, else what the robot's own plan does, else nothing.

    A source that has been silent for half a second has none. Nothing passes during an emergency
    stop, nor before `EmergencyStop` has posted that there is none.
    """

    emergency = Sensor(EMERGENCY, default=Bool(True), domain=BOOLS)
    teleop = Sensor(TELEOP, max_age_ms=500)
    autonomy = Sensor(AUTONOMY, max_age_ms=500)
    cmd_vel = Actuator(CMD_VEL, at_end=REST)

    AT_REST = State()
    BY_PERSON = State()
    BY_PLAN = State()

    @AT_REST.on_entry
    def _(self) -> None:
        self.cmd_vel(REST)

    @BY_PERSON.internal
    def _(self) -> None:
        if self.teleop is not None:
            self.cmd_vel(self.teleop)

    @BY_PERSON.on_exit
    def _(self) -> None:
        self.cmd_vel(REST)

    @BY_PLAN.internal
    def _(self) -> None:
        if self.autonomy is not None:
            self.cmd_vel(self.autonomy)

    @BY_PLAN.on_exit
    def _(self) -> None:
        self.cmd_vel(REST)

    def person_commands(self) -> bool:
        """True if a person commands, and may."""
        return self.teleop is not None and not self.emergency.data

    def plan_commands(self) -> bool:
        """True if the robot's plan commands, and may."""
        return self.autonomy is not None and self.teleop is None and not self.emergency.data

    AT_REST.to(BY_PERSON, when=person_commands)
    AT_REST.to(BY_PLAN, when=plan_commands)
    BY_PERSON.to(AT_REST, when=lambda self: not self.person_commands())
    BY_PLAN.to(BY_PERSON, when=person_commands)
    BY_PLAN.to(AT_REST, when=lambda self: not self.plan_commands())
