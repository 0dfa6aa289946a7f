"""Tables of the terrain simulator's paper, and equations as they stand there.

Nothing simulates with them: they stand beside the corrected ones, in tests and in the report.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parapod.systems.terrain_simulator.geometry import BenchGeometry


class Specification(NamedTuple):
    """Table 1, in SI units; angles by the bench.

    Attributes:
        x_range: horizontal range of motion [m].
        z_range: vertical range of motion [m].
        speed: largest speeds of x, z and phi [m/s, m/s, rad/s].
        load: largest horizontal and continuous vertical load [N].
        pedal_angle: rotation of the pedal either way [rad].
        treadmill_angle: rotation of the treadmill either way [rad].
    """

    x_range: float
    z_range: float
    speed: tuple[float, float, float]
    load: tuple[float, float]
    pedal_angle: float
    treadmill_angle: float


SPECIFICATION = Specification(
    0.5,
    0.2,
    (2.75, 2.5, math.radians(900.0)),
    (500.0, 1000.0),
    math.radians(45.0),
    math.radians(14.0),
)
# Table 2 [m, deg], a column a bench. The treadmill's l_5 is 0 there.
LINK = 0.30
STRUT = {"pedal": 0.42, "treadmill": 0.45}
LEVER = {"pedal": 0.09, "treadmill": 0.60}
PLATE = {"pedal": 0.12, "treadmill": 0.0}
OFFSET_DEG = {"pedal": 33.0, "treadmill": 0.0}
GAP = 0.1
RAIL = (0.08, 1.12)
# Distance of the belt's drums in Figure 3 [m].
BELT = 0.6


def printed_theta(
    geometry: BenchGeometry, sliders: NDArray[np.float64], sign: float
) -> NDArray[np.float64]:
    """Angle theta of P T (...) [rad] with the argument of its arc cosine as printed.

    Args:
        geometry: the bench.
        sliders: (..., 3) [m].
        sign: sign of the arc cosine: 1.0 for the plus of the text, T above the line P A_3.

    Returns:
        NaN where the arc cosine has none.
    """
    a_1, a_2, a_3 = np.moveaxis(np.asarray(sliders, dtype=float), -1, 0)
    along = a_3 - 0.5 * (a_1 + a_2)
    z_P = np.sqrt(geometry.link**2 - (0.5 * (a_2 - a_1)) ** 2)
    distance = np.hypot(along, z_P)
    argument = geometry.strut**2 - geometry.lever**2 - along**2 - z_P**2
    with np.errstate(invalid="ignore"):
        angle = np.arccos(argument / (2.0 * geometry.lever * distance))
    theta: NDArray[np.float64] = 0.5 * math.pi - np.arctan2(along, z_P) + sign * angle
    return theta
