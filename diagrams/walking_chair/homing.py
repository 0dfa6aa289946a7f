"""Homing of the chair's branches against the retracted ends of their strokes."""

from typing import Any

import numpy as np

from parapod.diagrams.homing import (
    ByStandstill,
    Check,
    Homing,
    Procedure,
    Sign,
    find_far_ends,
    lead,
)
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT, LegGeometry

_POSITION, _VELOCITY, _CURRENT = "legs.position", "legs.velocity", "legs.current"
# Velocities of the search [m/s].
_FAST, _SLOW = 0.02, 0.005
# Share of its limit that the current of a motor has which is held up [-].
_PUSHING = 0.8
# Distance of the branches from their retracted ends afterwards [m].
_OFF = 3e-3
_STROKE_BOUND = 1e-3  # [m]


def _sign(driver: Any, index: int, period: float) -> Sign:
    pushing = _PUSHING * driver.homing_current_a
    return ByStandstill(index, _VELOCITY, _CURRENT, pushing)


def make_homing(geometry: LegGeometry) -> Homing:
    """The homing of a chair's branches.

    Args:
        geometry: its legs.
    """
    retracted, extended = np.tile(geometry.strokes, (LEG_COUNT, 1)).T

    def positions(driver: Any) -> list[float]:
        ends: list[float] = retracted.tolist()
        return ends

    def check_strokes(homing: Homing, driver: Any, period: float) -> Procedure[list[Check]]:
        """Extends all branches to their other ends, and retracts them again.

        What has stopped a branch at one end is the end of its stroke if the other is as far away
        as the drawing says; so are screw, gear and encoder's counts.
        """
        ends = yield from find_far_ends(homing, driver, "legs", period)
        yield from lead(homing, _POSITION, (retracted + _OFF).tolist())
        error = ends - extended
        worst = int(np.argmax(np.abs(error)))
        return [
            Check(
                "stroke_error_mm",
                1e3 * float(error[worst]),
                "mm",
                1e3 * _STROKE_BOUND,
                f"way from end to end against the drawing, largest: {BRANCHES[worst]}",
            )
        ]

    return Homing(
        command="velocity_command",
        measures="position",
        gain=1.0,
        fast=-_FAST,
        slow=-_SLOW,
        longest=1.05 * geometry.stroke,
        sign=_sign,
        positions=positions,
        size=len(BRANCHES),
        in_turn=False,
        checks=check_strokes,
        rest={"brake": 0.0},
        prepare="hung up, feet in the air, without a person on it",
        checking="all legs go to their other ends, and come back",
    )
