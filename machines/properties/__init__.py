"""Properties of the machines that ship, one module for each case study.

A module names its machines in the order of their turns, and their properties. All hold, but those
whose docstring says why they do not.
"""
