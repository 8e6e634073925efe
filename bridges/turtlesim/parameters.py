"""The node's parameters and the reasons for which rclcpp refuses a value."""

from typing import Final

from .errors import ParameterError
from .pen import Color

__all__ = ["Parameters"]

_TYPES: Final = {bool: "bool", int: "integer", float: "double", str: "string"}


class Parameters:
    """Hold `background_r`, `background_g`, `background_b` (0 to 255) and `holonomic`."""

    def __init__(self) -> None:
        self._values: dict[str, int | bool] = {
            "background_r": 69,
            "background_g": 86,
            "background_b": 255,
            "holonomic": False,
        }
        self._derive()

    def _derive(self) -> None:
        values = self._values
        self.background = Color(
            values["background_r"], values["background_g"], values["background_b"]
        )
        self.holonomic = bool(values["holonomic"])

    def values(self) -> dict[str, int | bool]:
        """Return a copy of all parameters by name."""
        return dict(self._values)

    def set(self, name: str, value: object) -> None:
        """Set a parameter, or raise ParameterError with the reason in rclcpp's words."""
        if name not in self._values:
            raise ParameterError(f"parameter '{name}' cannot be set because it was not declared")
        wanted, given = type(self._values[name]), type(value)
        if not isinstance(value, int) or given is not wanted:
            raise ParameterError(
                f"Wrong parameter type, parameter {{{name}}} is of type {{{_TYPES[wanted]}}}, "
                f"setting it to {{{_TYPES.get(given, given.__name__)}}} is not allowed."
            )
        if not 0 <= value <= 255:
            raise ParameterError(f"Parameter {{{name}}} doesn't comply with integer range.")
        self._values[name] = value
        self._derive()
