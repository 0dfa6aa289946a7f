"""Loops and couplings of a plant, which Drake's Python bindings take but do not return."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import AddMultibodyPlantConstraints
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, JointIndex, RigidBody
from pydrake.solvers import MathematicalProgram

from parapod.systems.core.errors import WiringError

# Bodies and joints in Drake's descriptions of constraints.
_BETWEEN = re.compile(r"between body (\d+) and body (\d+)")
_COUPLED = re.compile(r"joint (\d+) and joint (\d+)")
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
    """

    body: RigidBody
    point: ArrayLike
    other: RigidBody
    other_point: ArrayLike


@dataclass(frozen=True)
class Coupling:
    """A joint whose position is a multiple of another's.

    Attributes:
        joint: the joint.
        leader: the other joint.
        ratio: position of the joint by the leader's.
        offset: position of the joint while the leader is at zero [m, rad].
    """

    joint: Joint
    leader: Joint
    ratio: float
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Weld:
    """A weld that closes a loop: a frame of one body is a frame of another.

    Attributes:
        body: one body.
        frame: pose of the frame in that of the body.
        other: the other body.
        other_frame: pose of the frame in that of the other body.
    """

    body: RigidBody
    frame: RigidTransform
    other: RigidBody
    other_frame: RigidTransform


@dataclass(frozen=True)
class Constraints:
    """Constraints of a plant.

    Attributes:
        balls: its ball joints.
        welds: its welds.
        couplings: its coupled joints.
        others: number of its other constraints, such as distances and tendons.
    """

    balls: tuple[Ball, ...]
    welds: tuple[Weld, ...]
    couplings: tuple[Coupling, ...]
    others: int


def find_constraints(plant: MultibodyPlant) -> Constraints:
    """Constraints of a plant, found from how they depend on its positions.

    Drake gives each as a function of the positions: a ball joint as the place of a point of one
    body in the frame of the other, a weld as such a point and an angle between both bodies.

    Args:
        plant: finalized.

    Raises:
        WiringError: a weld between bodies that do not turn enough to find it.
    """
    program, context = MathematicalProgram(), plant.CreateDefaultContext()
    q = plant.GetPositions(context)
    variables = program.NewContinuousVariables(len(q))
    index = {variable.get_id(): i for i, variable in enumerate(variables)}
    balls: list[Ball] = []
    welds: list[Weld] = []
    couplings: list[Coupling] = []
    place: Ball | None = None
    for binding in AddMultibodyPlantConstraints(plant, variables, program, context):
        constraint: Any = binding.evaluator()
        kind = constraint.get_description()
        coupled, between = _COUPLED.search(kind), _BETWEEN.search(kind)
        if coupled:
            joint, leader = (plant.get_joint(JointIndex(int(i))) for i in coupled.groups())
            shares = np.zeros(len(q))
            shares[[index[v.get_id()] for v in binding.variables()]] = constraint.GetDenseA()[0]
            own, others = (shares[one.position_start()] for one in (joint, leader))
            offset = constraint.lower_bound()[0] / own
            couplings.append(Coupling(joint, leader, -others / own, offset))
        elif between and "orientation" in kind:
            assert place is not None
            R_AB = _closed_rotation(plant, constraint, place)
            X_AP = RigidTransform(np.asarray(place.point))
            X_BQ = RigidTransform(R_AB.inverse(), np.asarray(place.other_point))
            welds.append(Weld(place.body, X_AP, place.other, X_BQ))
        elif between:
            body, far = (plant.get_body(BodyIndex(int(number))) for number in between.groups())
            p_AQ = constraint.Eval(q)
            plant.SetPositions(context, q)  # which that may have changed
            frames = body.body_frame(), far.body_frame()
            X_AB = plant.CalcRelativeTransform(context, *frames)
            place = Ball(body, constraint.lower_bound(), far, X_AB.inverse().multiply(p_AQ))
            if kind.startswith("Ball"):
                balls.append(place)
    count = len(balls) + len(welds) + len(couplings)
    others = plant.num_constraints() - count
    return Constraints(tuple(balls), tuple(welds), tuple(couplings), others)


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
