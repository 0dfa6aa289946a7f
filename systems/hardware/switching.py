"""Commands of switches, such as brakes, stops, locks and clamps."""


def switched(command: float) -> bool | None:
    """Side of a command of a switch: False near 0, True near 1, None where it is near neither.

    None is what no controller means, such as NaN, an infinity, -1 or 1e300: the device then takes
    the safe side, and nothing that is latched is acknowledged.
    """
    if abs(command) <= 0.5:
        return False
    return True if abs(command - 1.0) <= 0.5 else None
