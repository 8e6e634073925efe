"""The command line: on top of everything, imported by nothing."""

# Reading it from what is installed would be a fifth of what `llfsm run` needs to start.
VERSION = "0.1.0"
