"""Yardsticks of a machine's speed, taken in the same minute as the figure that is judged by them.

The same code is several times as fast on one machine, or in one minute, as on another. So no
figure is judged by itself but beside work that never changes: a Python loop, a numpy kernel, a
bare Drake plant of the levelling platform's size. How long that takes, against how long it took
on a quiet minute of the machine where the bounds were set, is the machine's slowness; the bounds
hold for figures with the slowness taken out.
"""

import functools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PdControllerGains,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
    default_model_instance,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

# Time of the thread that works: what others do on the machine meanwhile is in no figure.
clock = time.thread_time
# Each sample is the best of some passes; samples further apart than this share tell nothing [-].
_PASSES = 3
MOST_SCATTER = 0.15


@dataclass(frozen=True)
class Pace:
    """Speed of the machine while something was measured.

    Attributes:
        yardstick: name of what was taken beside it.
        samples: durations of that [s].
        quiet: its duration on a quiet minute of the machine where the bounds were set [s].
    """

    yardstick: str
    samples: tuple[float, ...]
    quiet: float

    @property
    def slowness(self) -> float:
        """Time that the yardstick takes here and now, by the one that it took there [-]."""
        return min(self.samples) / self.quiet

    @property
    def scatter(self) -> float:
        """Share by which the slowest sample is above the fastest [-]."""
        return max(self.samples) / min(self.samples) - 1.0

    @property
    def is_steady(self) -> bool:
        return self.scatter <= MOST_SCATTER


@dataclass(frozen=True)
class Yardstick:
    """Work that never changes.

    Attributes:
        name: kind of work.
        quiet: duration of a pass on a quiet minute of the machine where the bounds were set [s].
        work: makes, once, what does a pass of it.
    """

    name: str
    quiet: float
    work: Callable[[], Callable[[], object]]

    def sample(self) -> float:
        """Duration of a pass now, the best of some [s]."""
        return min(seconds(self._pass) for _ in range(_PASSES))

    def best_beside(self, measured: Callable[[], float], runs: int) -> tuple[float, Pace]:
        """Smallest result of some runs, and the yardstick before, between and after them.

        Args:
            measured: measures something once and returns its duration [s].
            runs: number of runs.
        """
        self._pass()
        samples, durations = [self.sample()], []
        for _ in range(runs):
            durations.append(measured())
            samples.append(self.sample())
        return min(durations), Pace(self.name, tuple(samples), self.quiet)

    def beside[T](self, work: Callable[[], T]) -> tuple[T, Pace]:
        """The result of some work, and the yardstick before and after it."""
        self._pass()
        before = self.sample()
        result = work()
        return result, Pace(self.name, (before, self.sample()), self.quiet)

    @functools.cached_property
    def _pass(self) -> Callable[[], object]:
        return self.work()


def seconds(work: Callable[[], object]) -> float:
    """Duration of some work [s]."""
    began = clock()
    work()
    return clock() - began


def _python_loop() -> Callable[[], object]:
    """Floats, calls, tuples and attributes, as in the systems of a diagram."""

    class Point:
        def __init__(self) -> None:
            self.x, self.y = 0.3, 0.7

    def turned(x: float, y: float, angle: float) -> tuple[float, float]:
        sine, cosine = math.sin(angle), math.cos(angle)
        return cosine * x - sine * y, sine * x + cosine * y

    def loop() -> None:
        point = Point()
        for k in range(20_000):
            point.x, point.y = turned(point.x, point.y, 1e-3 * k)
            values = [point.x, point.y, 0.5]
            point.x += 1e-9 * sum(values)

    return loop


def _numpy_kernel() -> Callable[[], object]:
    """Products, roots and sines of vectors that fit the second cache."""
    random = np.random.default_rng(0)
    a, b = random.uniform(0.5, 1.5, (2, 4096))

    def kernel() -> None:
        for _ in range(150):
            product = a * b + (a - b)
            root = np.sqrt(product * product + 1.0)
            np.sin(root - product)
            root / (product + 3.0)

    return kernel


# Legs, links of each with their length, and radius of the feet [m].
_LEGS, _LINKS, _LENGTH, _RADIUS = 4, 5, 0.1, 0.025


def _drake_plant() -> Callable[[], object]:
    """Steps of a body on four chains of links that are held by implicit drives.

    28 positions, 4 balls that close loops, 4 round feet on a plane, as the levelling platform.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    friction = CoulombFriction(0.8, 0.8)
    X_WG = RigidTransform(np.array([0.0, 0.0, -0.5]))
    world = plant.world_body()
    plant.RegisterCollisionGeometry(world, X_WG, Box(4.0, 4.0, 1.0), "ground", friction)
    base = plant.AddRigidBody("base", _inertia(30.0, 0.4))
    for leg in range(_LEGS):
        _add_leg(plant, base, leg, friction)
    last = plant.AddRigidBody("arm", _inertia(1.0, 0.5))
    _add_link(plant, base, last, "arm", np.array([0.0, 0.0, 0.2]))
    plant.Finalize()
    X_WB = RigidTransform(np.array([0.0, 0.0, _LINKS * _LENGTH + _RADIUS]))
    plant.SetDefaultFloatingBaseBodyPose(base, X_WB)
    sources = builder.AddSystem(ConstantVectorSource(np.zeros(2 * plant.num_actuators())))
    drives = plant.get_desired_state_input_port(default_model_instance())
    builder.Connect(sources.get_output_port(), drives)
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(0.2)  # until it stands

    def steps() -> None:
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.1)

    return steps


def _add_leg(plant: MultibodyPlant, base: RigidBody, leg: int, friction: CoulombFriction) -> None:
    sign_x, sign_y = (1.0, 1.0, -1.0, -1.0)[leg], (1.0, -1.0, 1.0, -1.0)[leg]
    hip = np.array([0.5 * sign_x, 0.4 * sign_y, 0.0])
    tip = np.array([0.0, 0.0, -_LENGTH])
    parent, at = base, hip
    for link in range(_LINKS):
        name = f"leg_{leg}_{link}"
        body = plant.AddRigidBody(name, _inertia(0.5, _LENGTH))
        _add_link(plant, parent, body, name, at)
        if link == 2:
            plant.AddBallConstraint(base, hip + (link + 1) * tip, body, tip)
        parent, at = body, tip
    foot = RigidTransform(tip)
    plant.RegisterCollisionGeometry(parent, foot, Sphere(_RADIUS), f"foot_{leg}", friction)


def _add_link(
    plant: MultibodyPlant, parent: RigidBody, body: RigidBody, name: str, at: NDArray[np.float64]
) -> None:
    X_PJ = RigidTransform(np.array(at))
    mount: Any = plant.AddFrame(FixedOffsetFrame(f"{name}_at", parent.body_frame(), X_PJ))
    axis = np.array([0.0, 1.0, 0.0])
    joint = plant.AddJoint(RevoluteJoint(name, mount, body.body_frame(), axis))
    plant.AddJointActuator(name, joint).set_controller_gains(PdControllerGains(p=1e5, d=1e3))


def _inertia(mass: float, size: float) -> SpatialInertia:
    return SpatialInertia(mass, np.zeros(3), UnitInertia.SolidBox(size, size, size))


# Quiet durations: those with which the loops of the levelling platform, as they then were, came to
# their known factors (kinematic 60, full legs at 1 ms 4.8, reduced ones at 10 ms 33).
PYTHON = Yardstick("Python", 7.0e-3, _python_loop)
NUMPY = Yardstick("numpy", 4.7e-3, _numpy_kernel)
DRAKE = Yardstick("Drake", 9.4e-3, _drake_plant)
