"""Let ``python -m llfsm.runtime`` be ``llfsm``, for those who start it from a program."""

from .cli import main

main(prog_name="llfsm")
