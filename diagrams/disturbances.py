"""Disturbances of simulated machines: their courses over time, and pushes on any body."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Multiplexer, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.wiring import add, connect
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Variant, quantity

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
    """Push against a body, which rises and falls as a cubic does.

    Attributes:
        body: name of the body, of the backends "multibody" and "mujoco"; of several with one name
            that of the model as well, as in "leg_1_thigh". Empty: the machine's platform or body.
        force_N: largest force, by the world's axes [N].
        moment_Nm: largest moment besides, by the world's axes [N m].
        place_mm: place at which the force acts, from the body's origin by the body's axes [mm];
            that of a levelling platform is its centre F.
    """

    body: str = ""
    force_N: list[float] = quantity([100.0, 0.0, 0.0], -1e6, 1e6, length=3)  # noqa: N815
    moment_Nm: list[float] = quantity([0.0] * 3, -1e6, 1e6, length=3)  # noqa: N815
    place_mm: list[float] = quantity([0.0] * 3, -1e5, 1e5, length=3)

    @property
    def place(self) -> tuple[float, float, float]:
        """Place at which the force acts, by the body's axes [m]."""
        x, y, z = self.place_mm
        return x / 1e3, y / 1e3, z / 1e3


# Kinds of disturbances that act on a machine, by the backends whose plants give way to them.
type Acting = Mapping[str, tuple[type[Disturbance], ...]]
ON_BODIES: Acting = {"multibody": (Push,), "mujoco": (Push,)}


def check_disturbances(disturbances: Sequence[Disturbance], backend: str, acting: Acting) -> None:
    """Refuses disturbances that do not act on what is behind the ports.

    Args:
        disturbances: disturbances of the scenario.
        backend: its backend.
        acting: those that act on the machine.

    Raises:
        ScenarioError: names the key, and what is admissible.
    """
    if not disturbances:
        return
    key, kinds = "disturbances", acting.get(backend, ())
    if not kinds:
        *first, last = acting
        backends = f"{', '.join(first)} or {last}"
        raise ScenarioError(
            f"{key} must be empty with the backend '{backend}': they act with {backends}", key
        )
    for i, each in enumerate(disturbances):
        if not isinstance(each, kinds):
            tags = ", ".join(f"!{kind.tag()}" for kind in kinds)
            key = f"{key}.{i}"
            raise ScenarioError(
                f"{key}: !{each.tag()} does not act on this machine; admissible: {tags}", key
            )


def add_pushes(builder: DiagramBuilder, pushes: Sequence[Push], name: str) -> OutputPort:
    """Adds courses of pushes: moment and force of each (6k), by the world's axes [N m, N].

    Args:
        builder: builder of the station.
        pushes: the pushes, one or more.
        name: name of the system that gives them.
    """
    joint = add(builder, Multiplexer([6] * len(pushes)), name)
    for i, push in enumerate(pushes):
        way = push.pulse([*push.moment_Nm, *push.force_N])
        source = add(builder, TrajectorySource(way), f"{name}_{i + 1}")
        connect(builder, source.get_output_port(), joint.get_input_port(i))
    return joint.get_output_port()
