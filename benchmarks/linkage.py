"""Linkages with closed loops: one declaration, Drake's plant of it, and its exact motion.

The exact motion shares nothing with an engine: it is Newton's and Euler's equations of the open
tree in NumPy, with the accelerations that closed loops admit (Gauss). The loops' Jacobian is
inverted by its singular values, whose number is known, so that redundant constraints need neither
a stiffness nor a stabilisation. A method of order eight integrates with error control, and
positions and rates are projected onto the closed loops between its intervals.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    LinearSpringDamper,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
)
from scipy.integrate import solve_ivp  # type: ignore[import-untyped]

from parapod.systems.physics.loops import Ball

type Floats = NDArray[np.float64]
type Vector = tuple[float, float, float]

# Tolerance of the exact motion, relative and absolute [-, rad, rad/s].
TOLERANCE = 1e-12
# Number of the exact motion's intervals, between which it is projected onto the loops.
_INTERVALS = 20
# Number of Newton's iterations in a projection; two suffice from an error of 1e-8.
_ITERATIONS = 4


@dataclass(frozen=True)
class Link:
    """A rigid body that turns about an axis of the one before it, or slides along it.

    Attributes:
        name: its name.
        parent: name of the link that it moves on; "" is the ground.
        joint: point of the axis in the parent's frame, and the origin of the link's [m].
        axis: direction of the axis in both frames [-].
        mass: mass [kg].
        centre: centre of mass [m].
        inertia: principal moments about the centre of mass, along the frame's axes [kg m2].
        slides: true if it slides along the axis.
        position: position of the joint in the beginning [rad, m].
        rate: rate of the joint in the beginning [rad/s, m/s].
        torque: constant torque of a motor in the joint [N m].
        stiffness: stiffness of a spring in the joint, which is at rest at zero [N m/rad].
    """

    name: str
    parent: str
    joint: Vector
    axis: Vector
    mass: float
    centre: Vector
    inertia: Vector
    slides: bool = False
    position: float = 0.0
    rate: float = 0.0
    torque: float = 0.0
    stiffness: float = 0.0

    @property
    def has_drive(self) -> bool:
        """Whether the plant has a drive in the joint: for a motor, or in place of a spring."""
        return bool(self.torque or self.stiffness)


@dataclass(frozen=True)
class Point:
    """A point of a link.

    Attributes:
        link: name of the link; "" is the ground.
        place: the point in the link's frame [m].
    """

    link: str
    place: Vector


@dataclass(frozen=True)
class Spring:
    """A spring between two points.

    Attributes:
        one: one point.
        other: the other point.
        stiffness: stiffness [N/m].
        length: length without force [m].
    """

    one: Point
    other: Point
    stiffness: float
    length: float


@dataclass(frozen=True)
class Motion:
    """Motion of a linkage.

    Attributes:
        t: (n) times [s].
        q: (n, m) positions of the joints [rad, m].
        v: (n, m) rates of the joints [rad/s, m/s].
    """

    t: Floats
    q: Floats
    v: Floats


@dataclass(frozen=True)
class Linkage:
    """A linkage of rigid links and revolute joints.

    Attributes:
        name: its name.
        links: the links of the open tree, each after its parent.
        closures: pairs of points that coincide, and so close the loops.
        freedoms: number of freedoms that the closed loops leave.
        spring: a spring, or None.
        gravity: acceleration of free fall [m/s2].
    """

    name: str
    links: tuple[Link, ...]
    closures: tuple[tuple[Point, Point], ...]
    freedoms: int = 1
    spring: Spring | None = None
    gravity: Vector = (0.0, 0.0, 0.0)

    def place(self, plant: MultibodyPlant) -> list[Ball]:
        """Puts the linkage into a plant, closed by ball constraints, and finalizes it.

        Returns:
            The ball joints that close the loops.
        """
        bodies: dict[str, RigidBody] = {"": plant.world_body()}
        for link in self.links:
            about_centre = RotationalInertia(*link.inertia)
            centre = np.array(link.centre)
            inertia = SpatialInertia.MakeFromCentralInertia(link.mass, centre, about_centre)
            bodies[link.name] = body = plant.AddRigidBody(link.name, inertia)
            X_PF = RigidTransform(np.array(link.joint))
            parent = FixedOffsetFrame(f"{link.name} joint", bodies[link.parent].body_frame(), X_PF)
            frame = plant.AddFrame(parent)
            kind = PrismaticJoint if link.slides else RevoluteJoint
            joint = plant.AddJoint(kind(link.name, frame, body.body_frame(), np.array(link.axis)))
            joint.set_default_positions(np.array([link.position]))
            if link.has_drive:
                drive = plant.AddJointActuator(link.name, joint)
                if link.stiffness:
                    # Its stiffness is taken implicitly, and that of a spring is not.
                    drive.set_controller_gains(PdControllerGains(p=link.stiffness, d=0.0))
        balls = []
        for one, other in self.closures:
            ends = (bodies[one.link], one.place, bodies[other.link], other.place)
            balls.append(Ball(*ends))
            plant.AddBallConstraint(ends[0], np.array(ends[1]), ends[2], np.array(ends[3]))
        if spring := self.spring:
            pairs = ((bodies[p.link], np.array(p.place)) for p in (spring.one, spring.other))
            (one_body, p_AP), (other_body, p_BQ) = pairs
            spring_force = LinearSpringDamper(
                one_body, p_AP, other_body, p_BQ, spring.length, spring.stiffness, 0.0
            )
            plant.AddForceElement(spring_force)
        plant.mutable_gravity_field().set_gravity_vector(np.array(self.gravity))
        plant.Finalize()
        return balls

    @property
    def torques(self) -> Floats:
        """Torques of the motors, in their order in the plant [N m]."""
        return np.array([link.torque for link in self.links if link.has_drive])


class ExactMotion:
    """Exact motion of a linkage.

    Args:
        linkage: the linkage.
    """

    def __init__(self, linkage: Linkage):
        self._linkage, links = linkage, linkage.links
        self._index = {link.name: i for i, link in enumerate(links)} | {"": -1}
        self._parents = [self._index[link.parent] for link in links]
        self._axes = np.array([link.axis for link in links])
        self._skews = np.array([_skew(link.axis) for link in links])
        self._joints = np.array([link.joint for link in links])
        self._centres = np.array([link.centre for link in links])
        self._masses = np.array([link.mass for link in links])
        self._inertias = np.array([np.diag(link.inertia) for link in links])
        self._torques = np.array([link.torque for link in links])
        self._stiffness = np.array([link.stiffness for link in links])
        self._turns = np.array([not link.slides for link in links], dtype=float)
        self._gravity = np.array(linkage.gravity)

    @cached_property
    def _moves(self) -> NDArray[np.bool_]:
        """(n, n) true where the joint of the column moves the link of the row."""
        moves = np.eye(len(self._parents), dtype=bool)
        for i, parent in enumerate(self._parents):
            if parent >= 0:
                moves[i] |= moves[parent]
        return moves

    @cached_property
    def start(self) -> tuple[Floats, Floats]:
        """Positions and rates in the beginning, with closed loops."""
        links = self._linkage.links
        positions = np.array([link.position for link in links])
        return self.project(positions, np.array([link.rate for link in links]))

    def integrate(self, times: ArrayLike, tolerance: float = TOLERANCE) -> Motion:
        """Motion from the beginning, at increasing times after it [s].

        Raises:
            RuntimeError: the integration did not succeed.
        """
        (q, v), samples = self.start, np.asarray(times, dtype=float)
        knots = np.linspace(0.0, samples[-1], _INTERVALS + 1)
        settings = {"method": "DOP853", "rtol": tolerance, "atol": tolerance}
        states = []
        for begin, end in itertools.pairwise(knots):
            inside = samples[(samples > begin) & (samples < end)]
            wanted_times, state = np.append(inside, end), np.append(q, v)
            solution = solve_ivp(
                self._derivatives, (begin, end), state, t_eval=wanted_times, **settings
            )
            if not solution.success:
                raise RuntimeError(solution.message)
            projected = [self.project(*np.split(state, 2)) for state in solution.y.T]
            q, v = projected[-1]
            states += projected if end in samples else projected[:-1]
        positions, rates = zip(*states, strict=True)
        return Motion(samples, np.array(positions), np.array(rates))

    def project(self, q: Floats, v: Floats) -> tuple[Floats, Floats]:
        """The nearest positions and rates with closed loops."""
        for _ in range(_ITERATIONS):
            tree = _Tree(self, q, np.zeros_like(q))
            q = q - self._inverse(tree.jacobian) @ tree.gap
        jacobian = _Tree(self, q, v).jacobian
        return q, v - self._inverse(jacobian) @ (jacobian @ v)

    def gap(self, q: Floats) -> float:
        """Largest distance of points that coincide in closed loops [m]."""
        gaps = _Tree(self, q, np.zeros_like(q)).gap.reshape(-1, 3)
        return float(np.linalg.norm(gaps, axis=1).max())

    def accelerations(self, q: Floats, v: Floats) -> Floats:
        """Accelerations of the joints [rad/s2]."""
        tree = _Tree(self, q, v)
        mass, force = tree.mass_and_force()
        # Gauss: of the accelerations that the loops admit the nearest to that of the open tree,
        # as near as the masses make it.
        root = np.linalg.cholesky(mass)
        scaled = np.linalg.solve(root, np.column_stack((force, tree.jacobian.T)))
        free, jacobian = scaled[:, 0], scaled[:, 1:].T
        bent = free - self._inverse(jacobian) @ (jacobian @ free + tree.bias)
        accelerations: Floats = np.linalg.solve(root.T, bent)
        return accelerations

    def open_tree(self, q: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Mass matrix of the open tree, and the forces along its joints [N m, N]."""
        return _Tree(self, q, v).mass_and_force()

    def energy(self, q: Floats, v: Floats) -> float:
        """Kinetic and potential energy, that which the motors have spent taken off [J]."""
        tree = _Tree(self, q, v)
        mass, _ = tree.mass_and_force()
        potential = -self._masses @ (tree.centres @ self._gravity)
        if spring := self._linkage.spring:
            stretch = np.linalg.norm(tree.between(spring.one, spring.other)) - spring.length
            potential += 0.5 * spring.stiffness * stretch**2
        potential += 0.5 * self._stiffness @ q**2 - self._torques @ q
        return float(0.5 * v @ mass @ v + potential)

    def position(self, q: Floats, point: Point) -> Floats:
        """A point in the world [m]."""
        return _Tree(self, q, np.zeros_like(q)).place(point)

    def _derivatives(self, _: float, state: Floats) -> Floats:
        q, v = state.reshape(2, -1)
        return np.append(v, self.accelerations(q, v))

    def _inverse(self, jacobian: Floats) -> Floats:
        """Pseudoinverse of a Jacobian whose rank is known."""
        left, values, rows = np.linalg.svd(jacobian)
        rank = jacobian.shape[1] - self._linkage.freedoms
        inverse: Floats = (rows[:rank].T / values[:rank]) @ left[:, :rank].T
        return inverse


class _Tree:
    """The open tree at some positions and rates.

    Attributes:
        centres: (n, 3) centres of mass in the world [m].
    """

    def __init__(self, motion: ExactMotion, q: Floats, v: Floats):
        self._motion, self._q, n = motion, q, len(q)
        rotations = _rotations(motion._skews, q * motion._turns)
        slides = q * (1.0 - motion._turns)
        self._R = R = np.empty((n, 3, 3))
        self._origins, self._axes = np.empty((n, 3)), np.empty((n, 3))
        # Angular velocities, and the accelerations that there are without any of the joints.
        self._w, self._alpha, self._a = np.zeros((3, n, 3))
        for i, parent in enumerate(motion._parents):
            if parent < 0:
                R_WP, p, w, alpha, a = np.eye(3), np.zeros(3), *np.zeros((3, 3))
            else:
                R_WP, p, w = R[parent], self._origins[parent], self._w[parent]
                alpha, a = self._alpha[parent], self._a[parent]
            self._axes[i] = axis = R_WP @ motion._axes[i]
            arm = R_WP @ motion._joints[i] + axis * slides[i]
            R[i], self._origins[i] = R_WP @ rotations[i], p + arm
            turning = axis * (v[i] * motion._turns[i])
            sliding = axis * v[i] - turning
            self._w[i] = w + turning
            self._alpha[i] = alpha + _cross(w, turning)
            self._a[i] = a + _cross(alpha, arm) + _cross(w, _cross(w, arm) + 2.0 * sliding)
        self._arms = np.einsum("nij,nj->ni", R, motion._centres)
        self.centres = self._origins + self._arms

    def place(self, point: Point) -> Floats:
        """A point in the world [m]."""
        i = self._motion._index[point.link]
        place = np.array(point.place)
        return place if i < 0 else self._origins[i] + self._R[i] @ place

    def between(self, one: Point, other: Point) -> Floats:
        """Vector from the other point to the one [m]."""
        return self.place(one) - self.place(other)

    @property
    def gap(self) -> Floats:
        """Distances of the points that coincide in closed loops [m]."""
        return np.concatenate([self.between(*pair) for pair in self._motion._linkage.closures])

    @property
    def jacobian(self) -> Floats:
        """Derivative of the gap by the positions."""
        pairs = self._motion._linkage.closures
        return np.concatenate([self._jacobian(a) - self._jacobian(b) for a, b in pairs])

    @property
    def bias(self) -> Floats:
        """Acceleration of the gap without any of the joints [m/s2]."""
        pairs = self._motion._linkage.closures
        return np.concatenate([self._acceleration(a) - self._acceleration(b) for a, b in pairs])

    def _jacobian(self, point: Point) -> Floats:
        i = self._motion._index[point.link]
        if i < 0:
            return np.zeros((3, len(self._axes)))
        columns = self._moving(self.place(point))
        jacobian: Floats = (columns * self._motion._moves[i][:, None]).T
        return jacobian

    def _moving(self, places: Floats) -> Floats:
        """(..., n, 3) velocities of points (..., 3) by the rates of all joints."""
        turns = self._motion._turns[:, None]
        turning = _cross(self._axes, places[..., None, :] - self._origins)
        moving: Floats = turns * turning + (1.0 - turns) * self._axes
        return moving

    def _acceleration(self, point: Point) -> Floats:
        i = self._motion._index[point.link]
        if i < 0:
            return np.zeros(3)
        arm, w = self._R[i] @ np.array(point.place), self._w[i]
        return self._a[i] + _cross(self._alpha[i], arm) + _cross(w, _cross(w, arm))

    def mass_and_force(self) -> tuple[Floats, Floats]:
        """Mass matrix, and forces of weight, motors, spring and inertia along the joints."""
        motion = self._motion
        moves = motion._moves[:, :, None]
        turning = self._axes * motion._turns[:, None] * moves
        moving = self._moving(self.centres) * moves
        inertias = self._R @ motion._inertias @ self._R.transpose(0, 2, 1)
        m = motion._masses
        weighted = np.einsum("nij,nkj->nki", inertias, turning)
        mass = np.einsum("n,nki,nli->kl", m, moving, moving)
        mass += np.einsum("nki,nli->kl", weighted, turning)
        a = self._a + _cross(self._alpha, self._arms)
        a += _cross(self._w, _cross(self._w, self._arms)) - motion._gravity
        spin = np.einsum("nij,nj->ni", inertias, self._w)
        moment = np.einsum("nij,nj->ni", inertias, self._alpha) + _cross(self._w, spin)
        inert = np.einsum("n,nki,ni->k", m, moving, a) + np.einsum("nki,ni->k", turning, moment)
        force = motion._torques - motion._stiffness * self._q - inert
        if spring := motion._linkage.spring:
            vector = self.between(spring.one, spring.other)
            length = np.linalg.norm(vector)
            pull = -spring.stiffness * (1.0 - spring.length / length) * vector
            force += (self._jacobian(spring.one) - self._jacobian(spring.other)).T @ pull
        return mass, force


def _skew(axis: Sequence[float]) -> Floats:
    x, y, z = axis
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def _rotations(skews: Floats, q: Floats) -> Floats:
    """(n, 3, 3) rotations by angles about axes, from the axes' skew matrices (Rodrigues)."""
    sine, versine = np.sin(q)[:, None, None], 2.0 * np.sin(0.5 * q)[:, None, None] ** 2
    rotations: Floats = np.eye(3) + sine * skews + versine * (skews @ skews)
    return rotations


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross products (..., 3), faster than NumPy's for few of them."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)
