"""Disturbances of simulated machines: forces on any body and ground that gives, over time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, MatrixGain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.ports import Port, Truth
from parapod.diagrams.wiring import add, connect, joined
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.schema import Variant, quantity
from parapod.systems.physics.wind import AIR_DENSITY, gusts

# Time at which trajectories end, after every run [s].
_END = 1e7
# Time between two values of the wind [s].
_GUST = 0.05


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
class _BodyForce(Disturbance):
    """Force on a body, at a place that moves with it.

    Attributes:
        body: name of the body, of the backends "multibody" and "mujoco"; of several with one name
            that of the model as well, as in "leg_1_foot". Empty: the machine's platform or body.
        place_mm: place at which the force acts, from the body's origin by the body's axes [mm];
            that of a levelling platform is its centre F.
    """

    body: str = ""
    place_mm: list[float] = quantity([0.0] * 3, -1e5, 1e5, length=3)

    @property
    def place(self) -> tuple[float, float, float]:
        """Place at which the force acts, by the body's axes [m]."""
        x, y, z = self.place_mm
        return x / 1e3, y / 1e3, z / 1e3

    def course(self) -> PiecewisePolynomial:
        """Moment and force (6) over time, by the world's axes [N m, N]."""
        raise NotImplementedError

    @property
    def largest(self) -> float:
        """Largest force, or about so much [N]."""
        raise NotImplementedError


@dataclass
class Push(_BodyForce):
    """Push against a body, which rises and falls as a cubic does.

    Attributes:
        force_N: largest force, by the world's axes [N].
        moment_Nm: largest moment besides, by the world's axes [N m].
    """

    force_N: list[float] = quantity([100.0, 0.0, 0.0], -1e6, 1e6, length=3)  # noqa: N815
    moment_Nm: list[float] = quantity([0.0] * 3, -1e6, 1e6, length=3)  # noqa: N815

    def course(self) -> PiecewisePolynomial:
        """Moment and force (6) over time, by the world's axes [N m, N]."""
        return self.pulse([*self.moment_Nm, *self.force_N])

    @property
    def largest(self) -> float:
        """Largest force [N]."""
        return math.hypot(*self.force_N)


@dataclass
class Weight(_BodyForce):
    """Mass that is put on a body, and taken off again.

    Rigid bodies have it as a point mass, with its inertia; statics bear its weight.

    Attributes:
        duration: time in which the body takes it over, and in which it is taken off [s].
        mass_kg: mass [kg]; below zero one that the body loses.
        until: time at which it is taken off [s]; null: it stays.
    """

    duration: float = quantity(1.0, 1e-3, 1e4)
    mass_kg: float = quantity(5.0, -1e5, 1e5)
    until: float | None = quantity(None, 0.0, 1e6)

    def course(self) -> PiecewisePolynomial:
        """Moment and force (6) over time, by the world's axes [N m, N]."""
        weight = [0.0] * 5 + [-GRAVITY * self.mass_kg]
        if self.until is None:
            return self.step(weight)
        times = [0.0, self.at, self.at + self.duration, self.until, self.until + self.duration]
        return _smooth([*times, _END], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0], weight)

    @property
    def largest(self) -> float:
        """Largest force [N]."""
        return GRAVITY * abs(self.mass_kg)


@dataclass
class Cable(_BodyForce):
    """Cable that pulls a body, and breaks.

    Attributes:
        at: time at which it breaks [s].
        duration: time in which it goes slack then [s].
        pull_N: pull, by the world's axes, of which a cubic rises in the first second [N].
    """

    duration: float = quantity(0.01, 1e-3, 1e4)
    pull_N: list[float] = quantity([100.0, 0.0, 0.0], -1e6, 1e6, length=3)  # noqa: N815

    def course(self) -> PiecewisePolynomial:
        """Moment and force (6) over time, by the world's axes [N m, N]."""
        tight = min(1.0, 0.5 * self.at)
        times = [0.0, tight, self.at, self.at + self.duration, _END]
        return _smooth(times, [0.0, 1.0, 1.0, 0.0, 0.0], [0.0] * 3 + self.pull_N)

    @property
    def largest(self) -> float:
        """Largest force [N]."""
        return math.hypot(*self.pull_N)


@dataclass
class Wind(_BodyForce):
    """Wind on a body, with gusts of Kaimal's spectrum; see `gusts`.

    The force is that of the air at a surface, along the wind; speeds of the body are small
    against it.

    Attributes:
        at: beginning of the wind, which takes a second to rise [s].
        duration: time for which it blows [s].
        speed_m_s: mean speed [m/s].
        turbulence: standard deviation of the speed by the mean [-].
        length_m: length of the gusts [m].
        direction_deg: direction in which it blows, from the world's x axis towards y [deg].
        area_m2: surface, as seen along the wind, times its drag coefficient [m^2].
        seed: seed of the gusts.
    """

    at: float = quantity(1.0, 0.0, 1e6)
    duration: float = quantity(60.0, 2.0, 3600.0)
    speed_m_s: float = quantity(10.0, 0.1, 100.0)
    turbulence: float = quantity(0.18, 0.0, 1.0)
    length_m: float = quantity(8.5, 0.1, 1e3)
    direction_deg: float = quantity(0.0, -360.0, 360.0)
    area_m2: float = quantity(0.1, 0.0, 100.0)
    seed: int = quantity(0, 0, 2**31 - 1)

    def course(self) -> PiecewisePolynomial:
        """Moment and force (6) over time, by the world's axes [N m, N]."""
        count = round(self.duration / _GUST) + 1
        deviation = self.turbulence * self.speed_m_s
        speed = self.speed_m_s + gusts(
            count, _GUST, self.speed_m_s, deviation, self.length_m, self.seed
        )
        times = np.linspace(0.0, self.duration, count)
        share = np.clip(np.minimum(times, self.duration - times), 0.0, 1.0)
        force = 0.5 * AIR_DENSITY * self.area_m2 * share * speed * np.abs(speed)
        angle = math.radians(self.direction_deg)
        along = (0.0, 0.0, 0.0, math.cos(angle), math.sin(angle), 0.0)
        knots = dict(zip((self.at + times).tolist(), force, strict=True))
        knots = {0.0: 0.0} | knots | {_END: 0.0}
        values = [[part * value for value in knots.values()] for part in along]
        return PiecewisePolynomial.FirstOrderHold(list(knots), values)

    @property
    def largest(self) -> float:
        """Largest force, but for one gust of a thousand [N]."""
        gust = self.speed_m_s * (1.0 + 3.0 * self.turbulence)
        return 0.5 * AIR_DENSITY * self.area_m2 * gust**2


# Forces on bodies.
type BodyForce = Push | Weight | Cable | Wind
FORCES = (Push, Weight, Cable, Wind)


@dataclass
class Subsidence(Disturbance):
    """Ground that gives way under a foot, and stays where it is then.

    Attributes:
        foot: number of the foot, from 1 on.
        depth_mm: way down along the ground's normal [mm]; below zero it rises.
    """

    foot: int = quantity(1, 1, 100)
    depth_mm: float = quantity(10.0, -50.0, 50.0)


# Kinds of disturbances that act on a machine, by the backends whose plants give way to them.
type Acting = Mapping[str, tuple[type[Disturbance], ...]]
ON_BODIES: Acting = {"multibody": FORCES, "mujoco": FORCES}
ON_BODIES_AND_GROUND: Acting = dict.fromkeys(ON_BODIES, (*FORCES, Subsidence))


def check_disturbances(
    disturbances: Sequence[Disturbance], backend: str, acting: Acting, feet: int = 0
) -> None:
    """Refuses disturbances that do not act on what is behind the ports.

    Args:
        disturbances: disturbances of the scenario.
        backend: its backend.
        acting: those that act on the machine.
        feet: number of its feet.

    Raises:
        ScenarioError: names the key, and what is admissible.
    """
    if not disturbances:
        return
    key, kinds = "disturbances", acting.get(backend, ())
    if not kinds:
        *first, last = acting
        backends = " or ".join(part for part in (", ".join(first), last) if part)
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
        if isinstance(each, Weight) and each.until is not None:
            least = each.at + each.duration
            if each.until < least:
                key = f"{key}.{i}.until"
                raise ScenarioError(f"{key} = {each.until:g} s must be {least:g} s or later", key)
        if isinstance(each, Subsidence) and each.foot > feet:
            key = f"{key}.{i}.foot"
            has = f"has feet 1 to {feet}" if feet else "stands on no feet of its own"
            raise ScenarioError(f"{key} = {each.foot}: the machine {has}", key)


# Signals of disturbances that are plotted.
SHOWN = ("truth.push_force", "truth.ground_rise")


def ports_of(disturbances: Sequence[Disturbance], feet: int) -> tuple[Port, ...]:
    """Ports of a simulated station that show its disturbances; see `add_truth`.

    Args:
        disturbances: disturbances of the scenario.
        feet: number of the machine's feet.
    """
    forces = [
        f"{each.tag().lower()} {i}"
        for i, each in enumerate(disturbances, start=1)
        if isinstance(each, FORCES)
    ]
    names = tuple(f"{force} {axis}" for force in forces for axis in "xyz")
    ports = []
    if names:
        size = len(names)
        force, moment = "disturbing forces, by the world's axes", "moments besides"
        ports.append(Truth("push_force", size, "N", force, elements=names))
        ports.append(Truth("push_moment", size, "N m", moment, elements=names))
    if any(isinstance(each, Subsidence) for each in disturbances):
        rise, each_foot = (
            "rise of the ground under each foot",
            [f"foot {i + 1}" for i in range(feet)],
        )
        ports.append(Truth("ground_rise", feet, "m", rise, elements=each_foot))
    return tuple(ports)


def add_truth(
    builder: DiagramBuilder, disturbances: Sequence[Disturbance]
) -> dict[str, OutputPort]:
    """Adds outputs for `ports_of`, by name, of disturbances whose courses have been added."""
    outputs: dict[str, OutputPort] = {}
    courses = [port for _, port in courses_of(builder, disturbances)]
    if courses:
        both = joined(builder, courses, "pushes_shown")
        parts = (("push_moment", (1.0, 0.0)), ("push_force", (0.0, 1.0)))
        for name, part in parts:
            select = np.kron(np.eye(len(courses)), np.kron(np.array([part]), np.eye(3)))
            outputs[f"truth.{name}"] = _times(builder, select, both, name)
    rising = rising_ground(builder, disturbances)
    if rising is not None:
        half = rising.size() // 2
        outputs["truth.ground_rise"] = _times(
            builder, np.eye(half, 2 * half), rising, "ground_rise"
        )
    return outputs


def _times(builder: DiagramBuilder, matrix: Any, port: OutputPort, name: str) -> OutputPort:
    gain = add(builder, MatrixGain(matrix), name)
    connect(builder, port, gain.get_input_port())
    return gain.get_output_port()


def courses_of(
    builder: DiagramBuilder, disturbances: Sequence[Disturbance]
) -> list[tuple[BodyForce, OutputPort]]:
    """Forces among disturbances with their courses: moment and force (6), by the world's axes.

    Sources of these are added once.

    Args:
        builder: builder of the station.
        disturbances: disturbances of the scenario.
    """
    courses = []
    for i, each in enumerate(disturbances, start=1):
        if isinstance(each, FORCES):
            name = f"disturbance_{i}"
            if not builder.HasSubsystemNamed(name):
                add(builder, TrajectorySource(each.course()), name)
            courses.append((each, builder.GetSubsystemByName(name).get_output_port()))
    return courses


def rising_ground(
    builder: DiagramBuilder, disturbances: Sequence[Disturbance], feet: int = 0
) -> OutputPort | None:
    """Rise of the ground under each foot, and its rate (2n) [m, m/s]; None: it does not move.

    Args:
        builder: builder of the station; sources are added once.
        disturbances: disturbances of the scenario.
        feet: number of the machine's feet n; 0: the sources are there.
    """
    name, sources = "rising_ground", []
    if builder.HasSubsystemNamed(name):
        return builder.GetSubsystemByName(name).get_output_port()
    for i, each in enumerate(disturbances, start=1):
        if isinstance(each, Subsidence):
            rise = [0.0] * feet
            rise[each.foot - 1] = -1e-3 * each.depth_mm
            sources.append(add(builder, TrajectorySource(each.step(rise), 1), f"disturbance_{i}"))
    if not sources:
        return None
    total = add(builder, Adder(len(sources), 2 * feet), name)
    for i, source in enumerate(sources):
        connect(builder, source.get_output_port(), total.get_input_port(i))
    return total.get_output_port()
