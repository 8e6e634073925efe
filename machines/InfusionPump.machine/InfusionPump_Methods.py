def stop_at_fault() -> None:
    """Stop the drug in the very turn that sees the reason."""
    if must_stop():
        drug(Drug(Rate.NONE))


def must_stop() -> bool:
    """True if there is a fault, or the nurse stops the pump."""
    return fault.present or panel.key is Key.STOP
