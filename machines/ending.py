"""How every machine here ends: the middleware is gone, or an end was asked for."""

from llfsm.runtime import Machine

__all__ = ["stopping"]


def stopping(machine: Machine) -> bool:
    """Guard the last transition of every state: make for END."""
    return machine.stopping
