"""Run ``llfsm`` as ``python -m llfsm.cli``, the way for programs to start it."""

from llfsm.cli.root import main

main(prog_name="llfsm")
