"""A bridge's configuration from a file and from flags; its faults have their line or flag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

import click
from msgspec.structs import replace

from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan, make_plan
from llfsm.bridges.ros2.ros_arguments import RosArguments
from llfsm.cli.echo import echo
from llfsm.cli.options import BoardPlace
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.plans import line_of, read_toml
from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.board import SlotInfo


class BadConfigurationError(click.ClickException):
    """A configuration that cannot be used; the exit status is that of wrong usage."""

    exit_code = 2


def slots_on(board: BoardPlace) -> list[SlotInfo]:
    """List the slots of a whiteboard; none if it does not exist."""
    try:
        with board.open(create=False) as wb:
            return wb.slots()
    except BoardNotFoundError:
        return []


class Findings(NamedTuple):
    """Faults, warnings and notes of a configuration: a line for each, with its place."""

    faults: list[str]
    warnings: list[str]
    notes: list[str]


class Configured(NamedTuple):
    """A configuration, its file, and the flags that added its last relays."""

    config: BridgeConfig
    file: Path | None = None
    flags: tuple[str, ...] = ()
    is_named: bool = False  # True if a flag has given the node's name

    @classmethod
    def read(cls, file: Path | None, flags: Sequence[tuple[str, RelayConfig]] = ()) -> Self:
        """Read the file, if one is given, and add the relays of flags."""
        try:
            config = BridgeConfig() if file is None else read_toml(file, BridgeConfig)
        except ConfigurationError as error:
            raise BadConfigurationError(str(error)) from error
        relays = (*config.relay, *(relay for _, relay in flags))
        return cls(replace(config, relay=relays), file, tuple(text for text, _ in flags))

    def named(self, node: str | None) -> Self:
        """Give the bridge's node another name, if `--node` has one."""
        if node is None:
            return self
        return self._replace(config=replace(self.config, node=node), is_named=True)

    def plan(self, slots: list[SlotInfo], arguments: RosArguments) -> BridgePlan:
        """Make the plan for a board with these slots, and print its warnings and notes."""
        plan, findings = self.examine(slots, arguments)
        if findings.faults:
            more = f" (and {len(findings.faults) - 1} more)" if len(findings.faults) > 1 else ""
            raise BadConfigurationError(findings.faults[0] + more)
        for line in (*findings.warnings, *findings.notes):
            echo(line, err=True)
        return plan

    def examine(
        self,
        slots: list[SlotInfo],
        arguments: RosArguments = RosArguments(),  # noqa: B008 (immutable)
    ) -> tuple[BridgePlan, Findings]:
        """Make the plan for a board with these slots, and list all faults and notes."""
        folder = Path() if self.file is None else self.file.parent
        plan, faults = make_plan(self.config, folder, slots, arguments)
        return plan, Findings(
            [self._located(fault) for fault in faults],
            [self._located(each, "warning: ") for each in plan.warnings],
            [self._located(each, "note: ") for each in plan.notes],
        )

    def _located(self, fault: ConfigurationError, kind: str = "") -> str:
        what = kind + fault.what
        match fault.where:
            case ["node"] if self.is_named:
                return f"--node: {what}"
            case "relay", int(i), *_ if i >= len(self.config.relay) - len(self.flags):
                return f"{self.flags[i - len(self.config.relay)]}: {what}"
        if self.file is None:
            return what
        line = line_of(self.file.read_text(encoding="utf-8"), fault.where)
        return str(ConfigurationError(what, file=self.file, line=line))
