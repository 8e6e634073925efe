"""Numbers as options take them, which may be limited to a range.

An error calls them what users do: click speaks of an "integer range", also where there is none.
"""

from __future__ import annotations

import click

__all__ = ["Integer", "Number"]


class Integer(click.IntRange):
    """A whole number."""

    name = "integer"


class Number(click.FloatRange):
    """A number."""

    name = "number"
