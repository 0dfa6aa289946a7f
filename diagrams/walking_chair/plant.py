"""What every plant of the walking chair takes and offers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.walking_chair.masses import Passenger

type Stand = Callable[[Context, NDArray[np.float64], NDArray[np.float64], Passenger], None]


@dataclass(frozen=True)
class Plant:
    """What a plant offers to the sensors and to the truth.

    Attributes:
        signals: ports by name: body_position, body_attitude, force, contact_force, foot_height,
            loop_error.
        stand: puts the chair at rest, in a root context, with these lengths (4, 3) of the
            branches [m], its body's centre here (3) [m] and this passenger.
        seat: exchanges the passenger, in a root context.
    """

    signals: dict[str, OutputPort]
    stand: Stand
    seat: Callable[[Context, Passenger], None]


type PlantMaker = Callable[[DiagramBuilder, ChairScenario, VelocityServo, Meshcat | None], Plant]
