"""Machines on the board, for other processes to see and to control."""
