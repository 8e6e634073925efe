"""The commands of ``llfsm``, a module each; imported when they are called."""
