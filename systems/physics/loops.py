"""Loops and couplings of a plant, which Drake's Python bindings take but do not return."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import AddMultibodyPlantConstraints
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Joint,
    JointIndex,
    RigidBody,
    SpatialInertia,
    default_model_instance,
)
from pydrake.solvers import MathematicalProgram

from parapod.systems.core.errors import WiringError

# Bodies and joints in Drake's descriptions of constraints.
_BETWEEN = re.compile(r"between body (\d+) and body (\d+)")
_COUPLED = re.compile(r"joint (\d+) and joint (\d+)")
# Stiffness from which a distance constraint is a rod and not a spring [N/m]: Drake reads none from
# a file that is infinite.
_STIFF = 1e6
# Name of the body that stands for the world in constraints.
_ANCHOR = "anchor_of_loops"
# Poses from which the nine numbers of a rotation are found; its error where they do [-].
_POSES, _TURNED = 24, 1e-9


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball joint that closes a loop: a point of one body is a point of another.

    Attributes:
        body: one body.
        point: the point (3) in its frame [m].
        other: the other body.
        other_point: the point (3) in the other's frame [m].
        name: name for people; "" for that of the bodies.
    """

    body: RigidBody
    point: ArrayLike
    other: RigidBody
    other_point: ArrayLike
    name: str = ""


@dataclass(frozen=True)
class Coupling:
    """A joint whose position is a multiple of another's.

    Attributes:
        joint: the joint.
        leader: the other joint.
        ratio: position of the joint by the leader's.
        offset: position of the joint while the leader is at zero [m, rad].
        name: name for people; "" for that of the joints.
    """

    joint: Joint
    leader: Joint
    ratio: float
    offset: float = 0.0
    name: str = ""


@dataclass(frozen=True, eq=False)
class Weld:
    """A weld that closes a loop: a frame of one body is a frame of another.

    Attributes:
        body: one body.
        frame: pose of the frame in that of the body.
        other: the other body.
        other_frame: pose of the frame in that of the other body.
        name: name for people; "" for that of the bodies.
    """

    body: RigidBody
    frame: RigidTransform
    other: RigidBody
    other_frame: RigidTransform
    name: str = ""


@dataclass(frozen=True, eq=False)
class Distance:
    """A rod that closes a loop: a point of one body is in a distance from a point of another.

    Attributes:
        body: one body.
        point: its point (3) in its frame [m].
        other: the other body.
        other_point: its point (3) in its frame [m].
        distance: length of the rod [m].
        name: name for people; "" for that of the bodies.
    """

    body: RigidBody
    point: ArrayLike
    other: RigidBody
    other_point: ArrayLike
    distance: float
    name: str = ""


type Loop = Ball | Weld | Distance | Coupling


def loop_name(loop: Loop) -> str:
    """Name of a loop for people."""
    if loop.name:
        return loop.name
    if isinstance(loop, Coupling):
        return f"{loop.joint.name()} by {loop.leader.name()}"
    return f"{loop.body.name()} - {loop.other.name()}"


def add_loop(plant: MultibodyPlant, loop: Loop) -> None:
    """Closes a loop of a plant.

    Drake's solver cannot simulate a constraint of the world itself: a body that is welded to the
    world stands in its place.

    Args:
        plant: not finalized.
        loop: bodies and joints of the plant, and how they are held together.
    """
    if isinstance(loop, Coupling):
        plant.AddCouplerConstraint(loop.joint, loop.leader, loop.ratio, loop.offset)
        return
    one, other = (_movable(plant, body) for body in (loop.body, loop.other))
    if isinstance(loop, Weld):
        plant.AddWeldConstraint(one, loop.frame, other, loop.other_frame)
        return
    points = np.asarray(loop.point, dtype=float), np.asarray(loop.other_point, dtype=float)
    if isinstance(loop, Ball):
        plant.AddBallConstraint(one, points[0], other, points[1])
    else:
        plant.AddDistanceConstraint(one, points[0], other, points[1], loop.distance)


def held_body(plant: MultibodyPlant, body: RigidBody) -> RigidBody:
    """The body that `add_loop` has put into a constraint in place of another one."""
    is_world = body.index() == plant.world_body().index()
    return plant.GetBodyByName(_ANCHOR) if is_world and plant.HasBodyNamed(_ANCHOR) else body


def _movable(plant: MultibodyPlant, body: RigidBody) -> RigidBody:
    """The body; in place of the world, one that is welded to it."""
    if body.index() != plant.world_body().index():
        return body
    if not plant.HasBodyNamed(_ANCHOR):
        inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
        anchor = plant.AddRigidBody(_ANCHOR, default_model_instance(), inertia)
        plant.WeldFrames(plant.world_frame(), anchor.body_frame())
    return plant.GetBodyByName(_ANCHOR)


@dataclass(frozen=True)
class Constraints:
    """Constraints of a plant.

    Attributes:
        loops: those that close loops.
        others: number of its other constraints: tendons, and distances softer than 1e6 N/m.
    """

    loops: tuple[Loop, ...]
    others: int

    def of[L: (Ball, Weld, Coupling, Distance)](self, kind: type[L]) -> tuple[L, ...]:
        """Loops of a kind."""
        return tuple(loop for loop in self.loops if isinstance(loop, kind))

    @property
    def balls(self) -> tuple[Ball, ...]:
        """Its ball joints."""
        return self.of(Ball)

    @property
    def welds(self) -> tuple[Weld, ...]:
        """Its welds."""
        return self.of(Weld)

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """Its coupled joints."""
        return self.of(Coupling)


def find_constraints(plant: MultibodyPlant, added: Sequence[Loop] = ()) -> Constraints:
    """Constraints of a plant, found from how they depend on its positions.

    Drake gives each as a function of the positions: a ball joint as the place of a point of one
    body in the frame of the other, a weld as such a point and an angle between both bodies.

    Args:
        plant: finalized.
        added: those that were added after all others, by `add_loop`; they are not searched for.

    Raises:
        WiringError: a weld between bodies that do not turn enough to find it.
    """
    program, context = MathematicalProgram(), plant.CreateDefaultContext()
    q = plant.GetPositions(context)
    variables = program.NewContinuousVariables(len(q))
    index = {variable.get_id(): i for i, variable in enumerate(variables)}
    loops: list[Loop] = []
    place: Ball | None = None
    bindings = AddMultibodyPlantConstraints(plant, variables, program, context)
    for binding in _before(bindings, added):
        constraint: Any = binding.evaluator()
        kind = constraint.get_description()
        coupled, between = _COUPLED.search(kind), _BETWEEN.search(kind)
        if coupled:
            joint, leader = (plant.get_joint(JointIndex(int(i))) for i in coupled.groups())
            shares = np.zeros(len(q))
            shares[[index[v.get_id()] for v in binding.variables()]] = constraint.GetDenseA()[0]
            own, others = (shares[one.position_start()] for one in (joint, leader))
            offset = constraint.lower_bound()[0] / own
            loops.append(Coupling(joint, leader, -others / own, offset))
        elif between and "orientation" in kind:
            assert place is not None
            R_AB = _closed_rotation(plant, constraint, place)
            X_AP = RigidTransform(np.asarray(place.point))
            X_BQ = RigidTransform(R_AB.inverse(), np.asarray(place.other_point))
            loops.append(Weld(place.body, X_AP, place.other, X_BQ))
        elif between and not kind.startswith("Distance"):
            body, far = (plant.get_body(BodyIndex(int(number))) for number in between.groups())
            p_AQ = constraint.Eval(q)
            plant.SetPositions(context, q)  # which that may have changed
            frames = body.body_frame(), far.body_frame()
            X_AB = plant.CalcRelativeTransform(context, *frames)
            place = Ball(body, constraint.lower_bound(), far, X_AB.inverse().multiply(p_AQ))
            if kind.startswith("Ball"):
                loops.append(place)
    rods = [
        Distance(
            *(plant.get_body(rod.bodyA()), rod.p_AP(), plant.get_body(rod.bodyB()), rod.p_BQ()),
            rod.distance(),
        )
        for rod in plant.GetDefaultDistanceConstraintParams().values()
        if rod.stiffness() >= _STIFF
    ]
    rods_added = sum(isinstance(loop, Distance) for loop in added)
    loops += rods[: len(rods) - rods_added]
    return Constraints((*loops, *added), plant.num_constraints() - len(loops) - len(added))


def _before(bindings: Sequence[Any], added: Sequence[Loop]) -> list[Any]:
    """Bindings without those of loops that were added after all others."""
    surplus = {
        "Ball constraint": sum(isinstance(loop, Ball) for loop in added),
        "Weld position": sum(isinstance(loop, Weld) for loop in added),
        "Weld orientation": sum(isinstance(loop, Weld) for loop in added),
        "Coupler": sum(isinstance(loop, Coupling) for loop in added),
    }
    kept = []
    for binding in reversed(bindings):
        description = binding.evaluator().get_description()
        kind = next((kind for kind in surplus if description.startswith(kind)), "")
        if surplus.get(kind, 0) > 0:
            surplus[kind] -= 1
        else:
            kept.append(binding)
    return kept[::-1]


def _closed_rotation(plant: MultibodyPlant, constraint: Any, ends: Ball) -> RotationMatrix:
    """Rotation between two bodies that a constraint asks for.

    Drake's constraint is the trace of what turns the one rotation into the other, which is linear
    in either.

    Raises:
        WiringError: the bodies do not turn enough to find it.
    """
    generator, context = np.random.default_rng(0), plant.CreateDefaultContext()
    rows: list[NDArray[np.float64]] = []
    traces = []
    for _ in range(_POSES):
        q = generator.uniform(-1.5, 1.5, plant.num_positions())
        plant.SetPositions(context, q)
        traces.append(constraint.Eval(q)[0])
        frames = ends.body.body_frame(), ends.other.body_frame()
        X_AB = plant.CalcRelativeTransform(context, *frames)
        rows.append(X_AB.rotation().matrix().ravel())
    matrix = np.linalg.lstsq(np.array(rows), np.array(traces))[0].reshape(3, 3)
    if np.abs(matrix.T @ matrix - np.eye(3)).max() > _TURNED:
        names = f"{ends.body.scoped_name()} and {ends.other.scoped_name()}"
        raise WiringError(f"{names} are welded, but do not turn enough to find how")
    return RotationMatrix.ProjectToRotationMatrix(matrix)
