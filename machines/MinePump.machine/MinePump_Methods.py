def wanted() -> bool:
    """True if the water is high, or the operator asks for less of it."""
    asked = water.level is WaterLevel.BETWEEN and operator.wish is Wish.ON
    return water.level is WaterLevel.HIGH or asked


def done() -> bool:
    """True if the sump is empty, or the operator stops the pump below high water."""
    stopped = water.level is WaterLevel.BETWEEN and operator.wish is Wish.OFF
    return water.level is WaterLevel.LOW or stopped
