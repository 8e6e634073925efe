"""Groups whose commands are imported when they are called, so that ``--help`` is fast.

The table of a group names each command as ``module:function``, which no type checker sees:
tests/cli/test_lazy.py resolves every row.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import click

from llfsm.errors import did_you_mean

__all__ = ["LazyGroup"]


class LazyGroup(click.Group):
    """A group made from a table: a command's name to ``module:function`` and its short help."""

    def __init__(self, *args: Any, table: Mapping[str, tuple[str, str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in the table's order."""
        return list(self.table)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Import a command."""
        if name not in self.table:
            return None
        module, _, attribute = self.table[name][0].partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the arguments; the error for an unknown one names similar ones."""
        name = args[0]
        if name in self.table or name.startswith("-") or ctx.resilient_parsing:
            return super().resolve_command(ctx, args)
        near = did_you_mean(name, self.table) or f"; see `{ctx.command_path} --help`"
        raise click.UsageError(f"no command {name!r}{near}", ctx)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table's short help of each command, without importing it."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self.table.items()])
