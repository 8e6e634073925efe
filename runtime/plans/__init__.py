"""What to run and how: arrangement files and clfsm's dispatch tables."""
