"""Let ``python -m llfsm.cli`` be ``llfsm``, for those who start it from a program."""

from .root import main

main(prog_name="llfsm")
