"""Disturbances of a simulated platform: pushes, ground that gives way, a payload at the tip."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Multiplexer, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.wiring import add, connect, sum_of
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Variant, quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT

# Time at which trajectories end, after every run [s].
_END = 1e7


@dataclass
class Disturbance(Variant):
    """Root of the disturbances, between which a tag chooses; of simulated machines only.

    Attributes:
        at: beginning, in the time of the simulation [s].
        duration: time that it takes [s].
    """

    at: float = quantity(10.0, 0.0, 1e6)
    duration: float = quantity(0.3, 1e-3, 1e4)

    def step(self, size: Sequence[float]) -> PiecewisePolynomial:
        """Way from zero to a size (n) along a cubic, and rest there."""
        return _smooth([0.0, self.at, self.at + self.duration, _END], [0.0, 0.0, 1.0, 1.0], size)

    def pulse(self, size: Sequence[float]) -> PiecewisePolynomial:
        """Way from zero to a size (n) and back along cubics."""
        half = 0.5 * self.duration
        times = [0.0, self.at, self.at + half, self.at + self.duration, _END]
        return _smooth(times, [0.0, 0.0, 1.0, 0.0, 0.0], size)


def _smooth(
    times: Sequence[float], shares: Sequence[float], size: Sequence[float]
) -> PiecewisePolynomial:
    """Cubics that are at rest at their knots; of knots at one time the last counts."""
    knots = dict(zip(times, shares, strict=True))
    values = [[share * part for share in knots.values()] for part in size]
    return PiecewisePolynomial.CubicHermite(list(knots), values, [[0.0] * len(knots)] * len(size))


@dataclass
class Push(Disturbance):
    """Push against the platform, which rises and falls as a cubic does.

    Attributes:
        force_N: largest force, by the world's axes [N].
        moment_Nm: largest moment besides, by the world's axes [N m].
        place_mm: place at which the force acts, from the platform's centre F [mm].
    """

    force_N: list[float] = quantity([100.0, 0.0, 0.0], -1e6, 1e6, length=3)  # noqa: N815
    moment_Nm: list[float] = quantity([0.0] * 3, -1e6, 1e6, length=3)  # noqa: N815
    place_mm: list[float] = quantity([0.0] * 3, -1e5, 1e5, length=3)


@dataclass
class Subsidence(Disturbance):
    """Ground that gives way under a foot, and stays where it is then.

    Attributes:
        foot: number of the foot, 1 to 4.
        depth_mm: way down along the ground's normal [mm]; below zero it rises.
    """

    foot: int = quantity(1, 1, LEG_COUNT)
    depth_mm: float = quantity(10.0, -50.0, 50.0)


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


@dataclass(frozen=True)
class Disturbances:
    """Courses of the disturbances over time; None for those of which a scenario has none.

    Attributes:
        places: places of the k pushes, from the platform's centre F [m].
        pushes: moment and force of each (6k), by the world's axes [N m, N].
        rising: rise of the ground under each foot, and its rate (8) [m, m/s].
        mass: mass of the payload [kg]; 0: none.
        payload: mass (1) whose weight the tip bears [kg].
    """

    places: tuple[tuple[float, float, float], ...] = ()
    pushes: OutputPort | None = None
    rising: OutputPort | None = None
    mass: float = 0.0
    payload: OutputPort | None = None


def check_disturbances(
    disturbances: Sequence[Disturbance], simulated: bool, has_arm: bool
) -> None:
    """Refuses disturbances of what is not simulated, and payloads that no tip takes.

    Raises:
        ScenarioError: names the key, and what is admissible.
    """
    key = "disturbances"
    if disturbances and not simulated:
        raise ScenarioError(f"{key} must be empty: they act on simulated machines only", key)
    payloads = [i for i, each in enumerate(disturbances) if isinstance(each, Payload)]
    if payloads and not has_arm:
        key = f"{key}.{payloads[0]}"
        raise ScenarioError(f"{key}: a platform without an arm takes no payload", key)
    if len(payloads) > 1:
        key = f"{key}.{payloads[1]}"
        raise ScenarioError(f"{key}: the tip takes one payload, not {len(payloads)}", key)


def payload_in(disturbances: Sequence[Disturbance]) -> float:
    """Mass of the payload among disturbances [kg]; 0: none."""
    return sum(each.mass_kg for each in disturbances if isinstance(each, Payload))


def add_disturbances(builder: DiagramBuilder, disturbances: Sequence[Disturbance]) -> Disturbances:
    """Adds sources of their courses over time.

    Args:
        builder: builder of the station.
        disturbances: disturbances of the scenario.
    """
    pushes = [each for each in disturbances if isinstance(each, Push)]
    sinking = [each for each in disturbances if isinstance(each, Subsidence)]
    payloads = [each for each in disturbances if isinstance(each, Payload)]
    sources = []
    for i, each in enumerate(sinking, start=1):
        rise = [0.0] * LEG_COUNT
        rise[each.foot - 1] = -1e-3 * each.depth_mm
        source = add(builder, TrajectorySource(each.step(rise), 1), f"subsidence_{i}")
        sources.append(source.get_output_port())
    rising = sum_of(builder, sources, "rising_ground") if sources else None
    forces = None
    if pushes:
        joint = add(builder, Multiplexer([6] * len(pushes)), "pushes")
        for i, push in enumerate(pushes):
            way = push.pulse([*push.moment_Nm, *push.force_N])
            source = add(builder, TrajectorySource(way), f"push_{i + 1}")
            connect(builder, source.get_output_port(), joint.get_input_port(i))
        forces = joint.get_output_port()
    payload = None
    for hung in payloads:
        payload = add(builder, TrajectorySource(hung.course), "payload").get_output_port()
    return Disturbances(
        places=tuple((x / 1e3, y / 1e3, z / 1e3) for x, y, z in (p.place_mm for p in pushes)),
        pushes=forces,
        rising=rising,
        mass=payload_in(disturbances),
        payload=payload,
    )
