def danger() -> bool:
    """Return whether there is a reason to leave the mine."""
    return gas.methane or gas.carbon_monoxide or failure.failed
