"""A system: several processes, started, watched and ended as one from one file."""
