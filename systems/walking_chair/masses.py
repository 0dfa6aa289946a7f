"""Masses of the walking chair and its passenger, and their places."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.walking_chair.geometry import LEG_COUNT


@dataclass(frozen=True)
class ChairMasses:
    """Masses of the chair: 49.2 kg in all, as weighed; how they are spread is an assumption.

    Attributes:
        body: connection plate, seat, control box [kg].
        body_height: height of the body's centre of mass above S [m].
        upper_platform: mass of a leg's upper platform [kg].
        yoke: mass of each yoke of a leg's three universal joints [kg].
        cylinder: mass of each cylinder of a leg's three actuators [kg].
        rod: mass of each rod of a leg's two UPS branches [kg].
        foot: mass of the foot with the rod of the UP branch [kg].
    """

    body: float = 17.6
    body_height: float = 0.12
    upper_platform: float = 0.8
    yoke: float = 0.1
    cylinder: float = 1.6
    rod: float = 0.5
    foot: float = 1.0

    @property
    def foot_end(self) -> float:
        """Mass of a leg's foot end, below the actuators [kg]."""
        return self.foot + 2.0 * self.rod

    @property
    def leg(self) -> float:
        """A whole leg [kg]."""
        return self.upper_platform + 3.0 * (self.yoke + self.cylinder) + self.foot_end

    @cached_property
    def total(self) -> float:
        """The chair without a passenger [kg]."""
        return self.body + LEG_COUNT * self.leg


@dataclass(frozen=True)
class Passenger:
    """A payload on the seat, as a mass.

    Attributes:
        mass: [kg]; the paper's largest is 57 kg.
        x: x of its centre of mass, to the right of S [m].
        y: ahead of S [m].
        height: above S [m] (assumption: the belly of a sitting person).
        gyration: radius of gyration about any axis through it [m] (assumption).
    """

    mass: float = 57.0
    x: float = 0.0
    y: float = 0.0
    height: float = 0.35
    gyration: float = 0.26

    @property
    def place(self) -> NDArray[np.float64]:
        """(..., 3) centre of mass from S in {S} [m]."""
        return np.stack((self.x, self.y, self.height), axis=-1)


def centre_of_mass(
    masses: ChairMasses, passenger: Passenger, feet: ArrayLike
) -> tuple[float, NDArray[np.float64]]:
    """Mass and centre of mass of the chair with its passenger.

    Upper platforms, joints and cylinders are taken to be around S, in its plane; only the feet
    move.

    Args:
        masses: masses of the chair.
        passenger: on it; of batches, its numbers are arrays (...).
        feet: (..., 4, 3) centroids of the feet from S in {S} [m].

    Returns:
        Mass [kg] and (..., 3) place from S in {S} [m].
    """
    places = of_width(feet, 3, "feet")
    moment = masses.foot_end * places.sum(axis=-2)
    moment = moment + np.asarray(passenger.mass)[..., np.newaxis] * passenger.place
    moment[..., 2] += masses.body * masses.body_height
    total = masses.total + passenger.mass
    return total, moment / np.asarray(total)[..., np.newaxis]
