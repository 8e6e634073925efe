"""Keep machines in a file, in which they outlive their process."""

from llfsm.runtime.keeping._keeping import keep_in

__all__ = ["keep_in"]
