def danger() -> bool:
    """True if there is a reason to leave the mine."""
    return gas.methane or gas.carbon_monoxide or failure.failed
