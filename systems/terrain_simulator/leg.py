"""A leg under test: its hip is fixed, its foot moves in the bench's plane.

Only its own joints are in the plant: the hip's frame is at the world's origin, x to the front and
z up. So it serves any leg that a URDF describes, whatever the number of its joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import Context

from parapod.systems.core.elementwise import sumprod
from parapod.systems.core.errors import ParapodError, UnreachablePosture

# Newton steps with which a posture is sought, and the error that ends them [m].
_STEPS, _CLOSE = 60, 1e-10
# Largest change of a joint in one of them [rad or m], and what damps them near singularities.
_LARGEST, _DAMPING = 0.3, 1e-6
_ORIGIN = np.zeros(3)


class UnreachableFoot(UnreachablePosture):
    """A place of the foot that no admissible joint positions lead to.

    Attributes:
        place: (2) x, z of the foot from the hip [m].
        missing: distance by which it is missed [m].
    """

    def __init__(self, place: NDArray[np.float64], missing: float):
        self.place, self.missing = place, missing
        where = ", ".join(f"{1e3 * number:.0f}" for number in place)
        ParapodError.__init__(
            self,
            f"the foot cannot come to x, z = {where} mm from the hip: {1e3 * missing:.1f} mm are "
            "missing",
        )


class FootState(NamedTuple):
    """State of the foot in the hip's frame, and what moves it.

    Attributes:
        place: (2) x, z of its middle [m].
        velocity: (2) their rates [m/s].
        jacobian: (2, n) derivative of the place by the joints.
        inertia: (2, 2) mass that the foot shows to a force on it [kg].
        bias: (2) its acceleration while no joint is accelerated [m/s^2].
        holding: (n) torques for the joints' own motion and the leg's weight [N m or N].
        inverse: (n, 2) accelerations of the joints by that of the foot, the rest being left to
            the leg's inertia: the dynamically consistent inverse of the Jacobian (Khatib 1987).
    """

    place: Sequence[float]
    velocity: Sequence[float]
    jacobian: Sequence[Sequence[float]]
    inertia: Sequence[Sequence[float]]
    bias: Sequence[float]
    holding: Sequence[float]
    inverse: Sequence[Sequence[float]]


@dataclass(frozen=True)
class LegModel:
    """A finalized plant that holds a leg alone, the hip fixed.

    Attributes:
        plant: the plant; all its positions are those of actuated joints.
        foot: frame whose origin is the middle of the round foot.
        order: (n) index of each actuated joint among the plant's positions.
        posture: (n) joint angles from which postures are sought: about those in which it stands.
        names: names of the actuated joints.
        max_torque: (n) largest torques of the drives [N m or N].
        mass: mass of the leg [kg].
    """

    plant: MultibodyPlant
    foot: Frame
    order: tuple[int, ...]
    posture: tuple[float, ...]
    names: tuple[str, ...]
    max_torque: tuple[float, ...]
    mass: float

    @property
    def joints(self) -> int:
        """Number of actuated joints n."""
        return len(self.names)

    @cached_property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper limits (n), (n) of the joints [rad or m]."""
        plant, order = self.plant, list(self.order)
        return plant.GetPositionLowerLimits()[order], plant.GetPositionUpperLimits()[order]

    @cached_property
    def least_mass(self) -> float:
        """Least mass that the foot shows to a force, of all directions, in `posture` [kg]."""
        at_rest = self.foot_state(self.make_context(), self.posture, [0.0] * self.joints)
        return float(np.linalg.eigvalsh(at_rest.inertia)[0])

    def make_context(self) -> Context:
        """A context to work in; the methods below change it."""
        context: Context = self.plant.CreateDefaultContext()
        return context

    def foot_state(
        self, context: Context, position: Sequence[float], velocity: Sequence[float]
    ) -> FootState:
        """State of the foot at joint positions (n) and velocities (n).

        Args:
            context: context from `make_context`.
            position: [rad or m].
            velocity: [rad/s or m/s].
        """
        plant, world, order = self.plant, self.plant.world_frame(), self.order
        v = [float(rate) for rate in velocity]
        state = np.empty(2 * len(order))
        for i, k in enumerate(order):
            state[k], state[len(order) + k] = position[i], v[i]
        plant.SetPositionsAndVelocities(context, state)
        x_row, z_row = J = self._jacobian(context)
        bias = plant.CalcBiasTranslationalAcceleration(
            context, JacobianWrtVariable.kV, self.foot, _ORIGIN, world, world
        )
        mass = plant.CalcMassMatrix(context).tolist()
        forces = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        # In plain numbers from here: of so few, numpy takes five times as long inside a tick.
        x_column, z_column = _solved([[mass[i][k] for k in order] for i in order], J)
        # A leg that is stretched shows no end of mass along itself.
        a, d = sumprod(x_row, x_column) + _DAMPING, sumprod(z_row, z_column) + _DAMPING
        b = sumprod(x_row, z_column)
        scale = 1.0 / (a * d - b * b)
        (a, b), (_, d) = inertia = ((scale * d, -scale * b), (-scale * b, scale * a))
        return FootState(
            place=self._place(context).tolist(),
            velocity=(sumprod(x_row, v), sumprod(z_row, v)),
            jacobian=J,
            inertia=inertia,
            bias=bias[::2, 0].tolist(),
            holding=[forces.item(k) for k in order],
            inverse=[
                (a * x + b * z, b * x + d * z) for x, z in zip(x_column, z_column, strict=True)
            ],
        )

    def place(self, context: Context, position: ArrayLike) -> NDArray[np.float64]:
        """x, z of the foot (2) at joint positions (n) [m]."""
        self._set(context, position)
        return self._place(context)

    def reach(self, foot: ArrayLike, near: ArrayLike | None = None) -> NDArray[np.float64]:
        """Joint positions (n) that put the foot at a place.

        Args:
            foot: (2) x, z from the hip [m].
            near: (n) positions from which they are sought; None: `posture` [rad or m].

        Raises:
            UnreachableFoot: there are none within the joints' limits; has the missing distance.
        """
        context, goal = self.make_context(), np.asarray(foot, dtype=float)
        low, high = self.limits
        q = np.clip(np.asarray(self.posture if near is None else near, dtype=float), low, high)
        missing = nearest = goal - self.place(context, q)
        for _ in range(_STEPS):
            if np.abs(missing).max() < _CLOSE:
                break
            J = np.array(self._jacobian(context))
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(2), missing)
            step *= min(1.0, _LARGEST / max(float(np.abs(step).max()), 1e-12))
            q = np.clip(q + step, low, high)
            missing = goal - self.place(context, q)
            nearest = min(missing, nearest, key=np.linalg.norm)
        if np.abs(missing).max() > 1e3 * _CLOSE:
            raise UnreachableFoot(goal, float(np.linalg.norm(nearest)))
        return q

    def follow(self, feet: ArrayLike) -> NDArray[np.float64]:
        """Joint positions (k, n) on a way of the foot (k, 2), each near those before.

        Raises:
            UnreachableFoot: the first place that cannot be reached.
        """
        configurations: list[NDArray[np.float64]] = []
        for foot in np.asarray(feet, dtype=float):
            configurations.append(self.reach(foot, configurations[-1] if configurations else None))
        return np.array(configurations)

    def _set(self, context: Context, position: ArrayLike) -> None:
        positions = np.empty(self.joints)
        positions[list(self.order)] = position
        self.plant.SetPositions(context, positions)

    def _place(self, context: Context) -> NDArray[np.float64]:
        return np.asarray(self.foot.CalcPoseInWorld(context).translation()[::2])

    def _jacobian(self, context: Context) -> tuple[list[float], list[float]]:
        world = self.plant.world_frame()
        J = self.plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, self.foot, _ORIGIN, world, world
        )
        x_row, _, z_row = J.tolist()
        return [x_row[k] for k in self.order], [z_row[k] for k in self.order]


def _solved(
    matrix: list[list[float]], columns: Sequence[Sequence[float]]
) -> list[tuple[float, ...]]:
    """Columns x with matrix x = column, by elimination; the matrix is positive definite."""
    rows = [[*row, *right] for row, *right in zip(matrix, *columns, strict=True)]
    for i in range(len(rows)):
        pivot = [value / rows[i][i] for value in rows[i]]
        rows = [
            pivot if k == i else [a - other[i] * b for a, b in zip(other, pivot, strict=True)]
            for k, other in enumerate(rows)
        ]
    return list(zip(*rows, strict=True))[len(matrix) :]
