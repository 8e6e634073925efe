"""The node's parameters: the background's colour, and `holonomic`."""

from __future__ import annotations

from llfsm.bridges.ros2.node_parameters import NodeParameters, Parameter, Value
from llfsm.bridges.turtlesim.canvas import Rgb
from llfsm.bridges.turtlesim.errors import TurtlesimError

_BYTE = (0, 255)


class Parameters(NodeParameters):
    """The values of `background_r`, `background_g`, `background_b` (0 to 255) and `holonomic`."""

    background: Rgb
    holonomic: bool

    def __init__(self) -> None:
        super().__init__(
            {
                "background_r": Parameter(69, "Red channel of the background color", _BYTE),
                "background_g": Parameter(86, "Green channel of the background color", _BYTE),
                "background_b": Parameter(255, "Blue channel of the background color", _BYTE),
                "holonomic": Parameter(False, "If true, then turtles will be holonomic"),
            }
        )
        self._derive()

    def set(self, name: str, value: Value) -> None:
        """Set a parameter; raise `TurtlesimError` with the reason in rclcpp's words."""
        if reason := self.refusal((name, value)):
            raise TurtlesimError(reason)
        self.assign(name, value)

    def assign(self, name: str, value: Value) -> None:
        """Give a parameter a value that it does not refuse."""
        super().assign(name, value)
        self._derive()

    def _derive(self) -> None:
        values = self.values()
        self.background = Rgb(*(values[f"background_{channel}"] for channel in "rgb"))
        self.holonomic = values["holonomic"]
