"""Keep machines in a file, in which they outlive their process."""

from llfsm.runtime.keeping._keeping import go_on, keep_in

__all__ = ["go_on", "keep_in"]
