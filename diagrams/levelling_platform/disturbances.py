"""Disturbances of a simulated platform: those of all machines, and a payload at the tip."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.disturbances import (
    FORCES,
    Disturbance,
    Subsidence,
    Weight,
    courses_of,
    rising_ground,
)
from parapod.diagrams.wiring import add, joined
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT


@dataclass
class Payload(Disturbance):
    """Payload that the tip takes, and keeps: its weight passes over to the tip along a cubic.

    Attributes:
        duration: time in which it does so [s].
        mass_kg: mass [kg].
    """

    duration: float = quantity(1.0, 1e-3, 1e4)
    mass_kg: float = quantity(0.5, 1e-3, 1e4)

    @property
    def course(self) -> PiecewisePolynomial:
        """Mass (1) over time whose weight the tip bears [kg]."""
        return self.step([self.mass_kg])


# Every simulated backend gives way to all of them.
ACTING = dict.fromkeys(("multibody", "kinematic", "mujoco"), (*FORCES, Subsidence, Payload))


@dataclass(frozen=True)
class Disturbances:
    """Courses of the disturbances over time; None for those of which a scenario has none.

    Attributes:
        places: places of the k pushes on the platform, from the platform's centre F [m].
        pushes: moment and force of each (6k), by the world's axes [N m, N].
        largest: size of the largest of these forces [N].
        rising: rise of the ground under each foot, and its rate (8) [m, m/s].
        mass: mass of the payload [kg]; 0: none.
        payload: mass (1) whose weight the tip bears [kg].
    """

    places: tuple[tuple[float, float, float], ...] = ()
    pushes: OutputPort | None = None
    largest: float = 0.0
    rising: OutputPort | None = None
    mass: float = 0.0
    payload: OutputPort | None = None


def check_platform_disturbances(
    disturbances: Sequence[Disturbance], backend: str, has_arm: bool
) -> None:
    """Refuses payloads that no tip takes, and pushes on bodies that a backend does not have.

    Raises:
        ScenarioError: names the key, and what is admissible.
    """
    payloads = [i for i, each in enumerate(disturbances) if isinstance(each, Payload)]
    if payloads and not has_arm:
        key = f"disturbances.{payloads[0]}"
        raise ScenarioError(f"{key}: a platform without an arm takes no payload", key)
    if len(payloads) > 1:
        key = f"disturbances.{payloads[1]}"
        raise ScenarioError(f"{key}: the tip takes one payload, not {len(payloads)}", key)
    for i, each in enumerate(disturbances):
        if backend == "kinematic" and isinstance(each, FORCES) and each.body:
            key = f"disturbances.{i}.body"
            raise ScenarioError(f"{key} must be empty with the backend 'kinematic'", key)


def payload_in(disturbances: Sequence[Disturbance]) -> float:
    """Mass of the payload among disturbances [kg]; 0: none."""
    return sum(each.mass_kg for each in disturbances if isinstance(each, Payload))


def add_disturbances(
    builder: DiagramBuilder, disturbances: Sequence[Disturbance], has_bodies: bool
) -> Disturbances:
    """Adds sources of their courses over time.

    Args:
        builder: builder of the station.
        disturbances: disturbances of the scenario.
        has_bodies: true if rigid bodies take masses that are put on the platform, see
            `pushes_in`.
    """
    pushes = [
        (force, course)
        for force, course in courses_of(builder, disturbances)
        if not (force.body or (has_bodies and isinstance(force, Weight)))
    ]
    payload = None
    for each in disturbances:
        if isinstance(each, Payload):
            payload = add(builder, TrajectorySource(each.course), "payload").get_output_port()
    return Disturbances(
        places=tuple(push.place for push, _ in pushes),
        pushes=joined(builder, [course for _, course in pushes], "pushes") if pushes else None,
        largest=max((push.largest for push, _ in pushes), default=0.0),
        rising=rising_ground(builder, disturbances, LEG_COUNT),
        mass=payload_in(disturbances),
        payload=payload,
    )
