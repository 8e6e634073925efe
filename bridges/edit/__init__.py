"""The page in which a machine is drawn, written and simulated; it needs the extra ``view``."""
