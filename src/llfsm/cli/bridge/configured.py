"""A bridge's configuration, from a file and from flags, and where each part of it is from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

import click
from msgspec.structs import replace

from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan, make_plan
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.plans.toml_files import line_of, read_toml
from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board import SlotInfo

__all__ = ["BadConfigurationError", "Configured", "slots_on"]


class BadConfigurationError(click.ClickException):
    """A configuration that cannot be used; the exit status is that of wrong usage."""

    exit_code = 2


def slots_on(board: str) -> list[SlotInfo]:
    """Return the slots of a whiteboard; none if it does not exist."""
    try:
        with Whiteboard(board, create=False) as wb:
            return wb.slots()
    except BoardNotFoundError:
        return []


class Configured(NamedTuple):
    """A configuration, its file, and the flags that added its last relays."""

    config: BridgeConfig
    file: Path | None = None
    flags: tuple[str, ...] = ()

    @classmethod
    def read(cls, file: Path | None, flags: Sequence[tuple[str, RelayConfig]] = ()) -> Self:
        """Read the file, if one is given, and add the relays of flags."""
        try:
            config = BridgeConfig() if file is None else read_toml(file, BridgeConfig)
        except ConfigurationError as error:
            raise BadConfigurationError(str(error)) from error
        relays = (*config.relay, *(relay for _, relay in flags))
        return cls(replace(config, relay=relays), file, tuple(text for text, _ in flags))

    def plan(self, slots: list[SlotInfo]) -> BridgePlan:
        """Return the plan for a board with these slots; raise `BadConfigurationError`."""
        plan, faults = self.examine(slots)
        if faults:
            more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
            raise BadConfigurationError(faults[0] + more)
        return plan

    def examine(self, slots: list[SlotInfo]) -> tuple[BridgePlan, list[str]]:
        """Return the plan, and a line for each fault of the configuration."""
        folder = Path() if self.file is None else self.file.parent
        plan, faults = make_plan(self.config, folder, slots)
        return plan, [self._located(fault) for fault in faults]

    def _located(self, fault: ConfigurationError) -> str:
        match fault.where:
            case "relay", int(i), *_ if i >= len(self.config.relay) - len(self.flags):
                return f"{self.flags[i - len(self.config.relay)]}: {fault.what}"
        if self.file is None:
            return fault.what
        line = line_of(self.file.read_text(encoding="utf-8"), fault.where)
        return str(ConfigurationError(fault.what, file=self.file, line=line))
