"""The lines of a function that is compiled, the variables in them, and its globals."""

from __future__ import annotations

from typing import Any

__all__ = ["GeneratedFunction"]


class GeneratedFunction:
    """Gives out names; no variable is assigned twice."""

    def __init__(self, names: dict[str, Any]) -> None:
        self.lines: list[str] = []
        self.count = 0
        """How many variables have got a name."""
        self._names = names  # the globals of the compiled code

    def new(self) -> str:
        """Return the name of a new variable."""
        self.count += 1
        return f"v{self.count}"

    def assign(self, expression: str) -> str:
        """Assign to a new variable, and return its name."""
        target = self.new()
        self.emit(f"{target} = {expression}")
        return target

    def emit(self, line: str) -> None:
        """Let a line follow."""
        self.lines.append(line)

    def named(self, value: Any) -> str:
        """Return the name of a new global with that value."""
        name = f"g{len(self._names)}"
        self._names[name] = value
        return name
