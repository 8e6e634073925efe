def stop_at_fault() -> None:
    """Post that nothing may flow, in the very turn that sees why."""
    if must_stop():
        drug(Drug(Rate.NONE))


def must_stop() -> bool:
    """Return whether there is a fault, or the nurse stops the pump."""
    return fault.present or panel.key is Key.STOP
