"""Pause machines between two turns, step them, and see why they are where they are."""

from llfsm.runtime.debugging.debugger import Debugger

__all__ = ["Debugger"]
