"""A slender rod as a chain of rigid bodies, and as a beam of Euler and Bernoulli.

Both are independent of any model of the rod in `parapod`, and of each other. The rod goes along
the z axis of its clamp's frame C; when it is upright, so does gravity, backwards. Its planes are
bending along x (about y), with the first stiffness, and along y (about x), with the second.
"""

import math
import time
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.polynomial import polynomial as poly
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    LinearBushingRollPitchYaw,
    MultibodyForces,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    SpatialInertia,
    UnitInertia,
    WeldJoint,
)
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.linalg import eigh
from scipy.optimize import brentq, fsolve

GRAVITY = 9.81
UPRIGHT, HORIZONTAL = 0.0, math.radians(90.0)
# The base that is driven turns as its torque says, whatever the rod does to it [kg m2].
_FLYWHEEL = 1e7
# Drake's CENIC takes no body without mass between two hinges [kg, m].
_CROSS_MASS, _CROSS_RADIUS = 1e-6, 1e-3
# A longer first step of a free base can end with numbers that error control does not reject [s].
_LONGEST_STEP = 2e-3
# Drake's integration schemes. The explicit one is converged to 1e-4 at accuracy 1e-5. CENIC is as
# fast and keeps the energy of a rod that nothing damps, but its damping ratios are off by 6e-4
# where damping lets it take steps of 2 ms, at any accuracy down to 1e-6.
EXPLICIT, CENIC = "bogacki_shampine3", "cenic"


@dataclass(frozen=True)
class Rod:
    """A clamped slender rod with a point mass at its end.

    Attributes:
        length: length [m].
        mass: mass without that at the tip [kg].
        stiffness: bending stiffness E I for bending along x and y of the clamp [N m2].
        tip_mass: point mass at the tip [kg].
    """

    length: float = 2.02
    mass: float = 0.27
    stiffness: tuple[float, float] = (430.0, 430.0)
    tip_mass: float = 0.73

    @property
    def density(self):
        """Mass by length [kg/m]."""
        return self.mass / self.length


# --- The beam


def beam_frequencies(rod, count=2, plane=0):
    """Natural frequencies [rad/s] of the beam without gravity, from its transcendental equation.

    1 + cos b cosh b + (m_tip / m) b (cos b sinh b - sin b cosh b) = 0 for b = beta L.
    """

    def error(b):
        mixed = math.cos(b) * math.tanh(b) - math.sin(b)
        return 1.0 / math.cosh(b) + math.cos(b) + rod.tip_mass / rod.mass * b * mixed

    grid = np.linspace(1e-3, math.pi * (count + 1), 1000 * (count + 1))
    signs = np.sign([error(b) for b in grid])
    crossings = np.flatnonzero(signs[1:] != signs[:-1])[:count]
    b = np.array([brentq(error, grid[i], grid[i + 1], xtol=1e-14) for i in crossings])
    return b**2 * math.sqrt(rod.stiffness[plane] / (rod.density * rod.length**4))


def loaded_beam_frequencies(rod, up, count=2, plane=0, order=12):
    """Natural frequencies [rad/s] of the beam with gravity along its axis.

    Ritz's method with polynomials, which converges to all digits: the potential is that of
    bending and of the axial force (geometric stiffness), which all masses above contribute to.

    Args:
        rod: the rod.
        up: share of gravity that presses on the clamp: 1 upright, -1 hanging, 0 horizontal.
        count: number of frequencies.
        plane: plane of bending.
        order: number of polynomials.
    """
    x, w = legendre.leggauss(2 * order)
    s, w = 0.5 * (x + 1.0), 0.5 * w * rod.length
    # Deflections s^2 P_k(2 s - 1), which are clamped at s = 0.
    shapes = [
        poly.polymul((0, 0, 1), _substituted(legendre.leg2poly([0] * k + [1])))
        for k in range(order)
    ]
    value, slope, curvature = (
        np.array([poly.polyval(s, poly.polyder(p, d) if d else p) for p in shapes]) / rod.length**d
        for d in range(3)
    )
    tip = np.array([poly.polyval(1.0, p) for p in shapes])
    load = up * GRAVITY * (rod.tip_mass + rod.mass * (1.0 - s))
    stiffness = (curvature * (rod.stiffness[plane] * w)) @ curvature.T - (
        slope * load * w
    ) @ slope.T
    mass = (value * (rod.density * w)) @ value.T + rod.tip_mass * np.outer(tip, tip)
    return np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:count])


def _substituted(p):
    """Coefficients of p(2 s - 1)."""
    total = np.zeros(1)
    for coefficient in p[::-1]:
        total = poly.polyadd(poly.polymul(total, (-1.0, 2.0)), (coefficient,))
    return total


def beam_sag(rod, plane=0):
    """Static sag [m] of the tip of a horizontal beam, first order."""
    stiffness = rod.stiffness[plane]
    of_tip = rod.tip_mass * GRAVITY * rod.length**3 / (3.0 * stiffness)
    return of_tip + rod.mass * GRAVITY * rod.length**3 / (8.0 * stiffness)


# --- The chain


class Chain:
    """Drake's plant of a rod on a base, in a diagram that can be simulated.

    Hinges with springs stand at the two Gauss points of each of `hinges / 2` equal elements. Each
    has the compliance of half of an element: so the compliances of the beam are integrated to
    fourth order, the sag is exact, and the error of frequencies falls by 16 when hinges double
    (hinges in the middles of equal segments give second order, and 1 % in the second frequency).
    Each hinge is two revolute joints, about x and then y, with a `RevoluteSpring` each.

    Attributes:
        rod: the rod.
        plant: continuous plant.
        base: body that the rod is clamped on, its frame the clamp's one.
        instance: model instance of all bodies of the rod.
        tip: body of the tip mass.
        diagram: the plant with the source of its torque.
        context: context of the simulator's diagram.
        simulator: simulator.
    """

    def __init__(
        self,
        rod=Rod(),
        attitude=UPRIGHT,
        swing=None,
        springs=None,
        base_mass=50.0,
        hinges=8,
        damping=0.0,
        gravity=GRAVITY,
        scheme=EXPLICIT,
        accuracy=1e-5,
    ):
        """Makes the diagram and its simulator.

        Args:
            rod: the rod.
            attitude: turn of the base about y, from upright, at the beginning [rad].
            swing: a `PiecewisePolynomial` of the base's turn about y [rad], which it follows.
            springs: stiffnesses of a bushing on which the base is free, as (torsion [N m/rad],
                translation [N/m]); zeros: a free body. None: the base is welded to the world.
            base_mass: mass of a base on springs, with the inertia of a cube of 0.3 m [kg].
            hinges: number of hinges, even.
            damping: damping of each joint [N m s/rad].
            gravity: acceleration of gravity [m/s2].
            scheme: Drake's integration scheme.
            accuracy: accuracy of its error control.
        """
        self.rod, self._hinges = rod, hinges
        builder = DiagramBuilder()
        plant = self.plant = builder.AddSystem(MultibodyPlant(0.0))
        plant.mutable_gravity_field().set_gravity_vector((0.0, 0.0, -gravity))
        self.base = self._add_base(attitude, swing, springs, base_mass)
        self.instance = plant.AddModelInstance("rod")
        self._add_rod(damping)
        plant.Finalize()
        if swing is not None:
            acceleration = builder.AddSystem(TrajectorySource(swing.derivative(2)))
            torque = builder.AddSystem(Gain(_FLYWHEEL, 1))
            builder.Connect(acceleration.get_output_port(), torque.get_input_port())
            builder.Connect(torque.get_output_port(), plant.get_actuation_input_port())
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        settings = SimulatorConfig(
            integration_scheme=scheme,
            accuracy=accuracy,
            max_step_size=_LONGEST_STEP,
            use_error_control=True,
        )
        ApplySimulatorConfig(settings, self.simulator)
        self.context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        if swing is not None:
            plant.GetJointByName("swing").set_angle(self.context, swing.value(0.0).item())
        if springs is not None:
            pose = RigidTransform(RotationMatrix.MakeYRotation(attitude), np.zeros(3))
            plant.SetFreeBodyPose(self.context, self.base, pose)

    def _add_base(self, attitude, swing, springs, base_mass) -> RigidBody:
        plant = self.plant
        inertia = SpatialInertia.SolidBoxWithMass(base_mass, 0.3, 0.3, 0.3)
        if swing is not None:
            turning = _FLYWHEEL / base_mass
            inertia = SpatialInertia(base_mass, np.zeros(3), UnitInertia(*[turning] * 3))
        base = plant.AddRigidBody("base", inertia)
        if swing is not None:
            joint = RevoluteJoint("swing", plant.world_frame(), base.body_frame(), (0, 1, 0))
            plant.AddJointActuator("swing", plant.AddJoint(joint))
        elif springs is None:
            pose = RigidTransform(RotationMatrix.MakeYRotation(attitude), np.zeros(3))
            plant.WeldFrames(plant.world_frame(), base.body_frame(), pose)
        elif any(springs):
            pose = RigidTransform(RotationMatrix.MakeYRotation(attitude), np.zeros(3))
            stand = FixedOffsetFrame("stand", plant.world_frame(), pose)
            torsion, translation = ([stiffness] * 3 for stiffness in springs)
            bushing = LinearBushingRollPitchYaw(
                plant.AddFrame(stand), base.body_frame(), torsion, (0,) * 3, translation, (0,) * 3
            )
            plant.AddForceElement(bushing)
        return base

    def _add_rod(self, damping):
        plant, rod, step = self.plant, self.rod, self.rod.length / self._hinges
        offset = 0.5 / math.sqrt(3.0)
        middles = 2.0 * step * (np.arange(self._hinges // 2) + 0.5)
        places = np.ravel([(z - 2.0 * step * offset, z + 2.0 * step * offset) for z in middles])
        begin, parent, length = 0.0, self.base, 0.0
        for i, end in enumerate((*places, rod.length)):
            joint_name, at = f"hinge_{i}", RigidTransform((0.0, 0.0, length))
            length = end - begin
            segment = self._add_body(
                f"segment_{i}",
                SpatialInertia.ThinRodWithMassAboutEnd(rod.density * length, length, (0, 0, 1)),
            )
            if i == 0:
                clamp = WeldJoint("clamp", parent.body_frame(), segment.body_frame(), at)
                self._clamp = plant.AddJoint(clamp)
            else:
                cross = self._add_body(
                    f"cross_{i}", SpatialInertia.SolidSphereWithMass(_CROSS_MASS, _CROSS_RADIUS)
                )
                place = plant.AddFrame(FixedOffsetFrame(joint_name, parent.body_frame(), at))
                along_x, along_y = rod.stiffness
                for axis, frame, body, stiffness in (
                    ((1, 0, 0), place, cross, along_y),
                    ((0, 1, 0), cross.body_frame(), segment, along_x),
                ):
                    joint = RevoluteJoint(
                        f"{joint_name}_{axis}", frame, body.body_frame(), axis, damping
                    )
                    spring = RevoluteSpring(plant.AddJoint(joint), 0.0, stiffness / step)
                    plant.AddForceElement(spring)
            begin, parent = end, segment
        self.tip = self._add_body(
            "tip", SpatialInertia.SolidSphereWithMass(rod.tip_mass, _CROSS_RADIUS)
        )
        at = RigidTransform((0.0, 0.0, length))
        plant.WeldFrames(parent.body_frame(), self.tip.body_frame(), at)

    def _add_body(self, name, inertia):
        return self.plant.AddRigidBody(name, self.instance, inertia)

    # --- Statics and small vibrations

    @cached_property
    def _rest(self):
        """Positions at rest."""
        errors = self._efforts
        return fsolve(errors, np.zeros(self.plant.num_positions()), xtol=1e-13)

    def _efforts(self, positions):
        """Generalised forces that hold the rod there."""
        context, plant = self.plant.CreateDefaultContext(), self.plant
        plant.SetPositions(context, positions)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        return plant.CalcInverseDynamics(context, np.zeros(plant.num_velocities()), forces)

    def set_rest(self):
        """Puts the rod where it rests on a welded base."""
        self.plant.SetPositions(self.context, self._rest)

    def frequencies(self, count=4):
        """Natural frequencies [rad/s] of small vibrations about rest, on a welded base."""
        steps = 1e-5 * np.eye(self._rest.size)
        columns = [
            self._efforts(self._rest + step) - self._efforts(self._rest - step) for step in steps
        ]
        stiffness = np.array(columns).T / 2e-5
        self.set_rest()
        mass = self.plant.CalcMassMatrix(self.context)
        squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
        return np.sqrt(np.sort(squares)[:count])

    # --- What is measured

    def deflection(self):
        """Place (3) of the tip by where a rigid rod would have it, in the clamp's frame [m]."""
        place = self.plant.CalcPointsPositions(
            self.context, self.tip.body_frame(), np.zeros(3), self.base.body_frame()
        )
        return place.ravel() - (0.0, 0.0, self.rod.length)

    def base_wrench(self):
        """Moment (3) [N m] and force (3) [N] of the rod on its base, about and along the clamp."""
        reactions = self.plant.get_reaction_forces_output_port().Eval(self.context)
        reaction = reactions[self._clamp.index()]
        return -reaction.rotational(), -reaction.translational()

    def energy(self):
        """Kinetic and potential energy [J]."""
        kinetic = self.plant.CalcKineticEnergy(self.context)
        return kinetic + self.plant.CalcPotentialEnergy(self.context)

    def advance(self, times):
        """Goes to each of some times; a generator of them."""
        for each in times:
            self.simulator.AdvanceTo(each)
            yield each


class Swung(NamedTuple):
    """A swing of the base, sampled (n).

    Attributes:
        time: times [s].
        tip: (n, 3) places of the tip by a rigid rod's, in the clamp's frame [m].
        moment: (n, 3) moments of the rod on its base about the clamp, in its frame [N m].
        force: (n, 3) forces of the rod on its base, in the clamp's frame [N].
        angle: angles of the base [rad].
        real_time_factor: simulated time by the time that it took [-].
    """

    time: np.ndarray
    tip: np.ndarray
    moment: np.ndarray
    force: np.ndarray
    angle: np.ndarray
    real_time_factor: float


def swing_of(angle=math.radians(45.0), duration=1.0, end=2.0):
    """Turn of the base about y, a cubic from rest to rest; then rest until `end`."""
    return PiecewisePolynomial.CubicHermite(
        [0.0, duration, end], [[0.0, angle, angle]], [[0.0, 0.0, 0.0]]
    )


def base_wrench_and_tip(swing=None, end=2.0, spacing=0.01, **settings):
    """Tip and base wrench of a rod, upright at rest, whose base then turns about y.

    That is not for CENIC: beside the inertia of a base that nothing disturbs, CENIC
    loses the rod, and with a drive that holds the base it takes the drive's reference a step late.

    Args:
        swing: turn of the base, from upright at rest; None: `swing_of()`.
        end: end of the motion [s].
        spacing: spacing of samples [s].
        settings: further arguments of `Chain`.
    """
    swing = swing_of(end=end) if swing is None else swing
    chain = Chain(swing=swing, **settings)
    times = spacing * np.arange(round(end / spacing) + 1)
    rows, began = [], time.perf_counter()
    for _ in chain.advance(times):
        angle = chain.plant.GetJointByName("swing").get_angle(chain.context)
        rows.append((*chain.deflection(), *np.ravel(chain.base_wrench()), angle))
    took = time.perf_counter() - began
    rows = np.array(rows)
    return Swung(times, rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9], end / took)
