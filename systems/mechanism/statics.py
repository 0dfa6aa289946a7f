"""Forces of a mechanism's motors, by the principle of virtual power.

Of all forces, those with which loops hold do no work in any motion that the loops let. What is
left of Drake's inverse dynamics of the tree, as far as the motors' velocities move it, is the
motors' task.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.mobility import null_space

type Floats = NDArray[np.float64]

# Time by which velocities are followed to see how Jacobians change [s by speed of one size/s].
_DIFFERENCE = 1e-5


@dataclass(frozen=True)
class MotorForces:
    """Forces of the motors.

    Attributes:
        forces: (motors) forces and torques [N, N m].
        unheld: largest force that acts along a freedom which no motor governs [N, N m], which
            moves it; 0 where all is held.
        velocities: (v) velocities of the plant.
        accelerations: (v) its accelerations; those along freedoms that no motor governs are the
            smallest that loops let.
    """

    forces: Floats
    unheld: float
    velocities: Floats
    accelerations: Floats


def motor_forces(
    mechanism: Mechanism,
    q: ArrayLike,
    rates: ArrayLike | None = None,
    accelerations: ArrayLike | None = None,
    wrenches: Mapping[str, ArrayLike] | None = None,
) -> MotorForces:
    """Forces with which the motors hold or move a mechanism, against weight, springs, damping.

    Args:
        mechanism: the mechanism.
        q: (q) positions, all loops closed.
        rates: (motors) velocities of the motors [m/s, rad/s]; None: none.
        accelerations: (motors) their accelerations; None: none.
        wrenches: torque and force (6) [N m, N] on frames at their origins, along the world's
            axes, by the names of the frames.
    """
    plant, positions = mechanism.plant, np.asarray(q, dtype=float)
    count = len(mechanism.motors)
    speeds = np.zeros(count) if rates is None else np.asarray(rates, dtype=float)
    changes = np.zeros(count) if accelerations is None else np.asarray(accelerations, dtype=float)
    by_motors = mechanism.velocity_map(positions)
    v = by_motors @ speeds
    v_dot = by_motors @ changes + _turning(mechanism, positions, v)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, positions)
    plant.SetVelocities(context, v)
    loads = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, loads)
    needed = np.asarray(plant.CalcInverseDynamics(context, v_dot, loads))
    world = plant.world_frame()
    for name, wrench in (wrenches or {}).items():
        frame = mechanism.frame(name)
        spatial = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world
        )
        needed = needed - spatial.T @ np.asarray(wrench, dtype=float)
    motors = np.eye(plant.num_velocities())[mechanism.motor_columns]
    idle = null_space(np.vstack((mechanism.loop_jacobian(positions), motors)), mechanism.nothing)
    unheld = float(np.abs(idle.T @ needed).max(initial=0.0))
    return MotorForces(by_motors.T @ needed, unheld, v, v_dot)


def _turning(mechanism: Mechanism, q: Floats, v: Floats) -> Floats:
    """Accelerations (v) that loops ask for while the motors keep their speeds."""
    speed = float(np.abs(v / np.where(mechanism.is_length, mechanism.size, 1.0)).max(initial=0.0))
    if speed == 0.0:
        return np.zeros_like(v)
    h = _DIFFERENCE / speed
    ends = [mechanism.loop_jacobian(mechanism.moved(q, sign * h * v)) @ v for sign in (1.0, -1.0)]
    drift = (ends[0] - ends[1]) / (2.0 * h)
    matrix = mechanism.loop_jacobian(q)
    motors = np.eye(len(v))[mechanism.motor_columns]
    goal = np.concatenate((-drift, np.zeros(len(motors))))
    whole = np.vstack((matrix, motors))
    return np.asarray(np.linalg.lstsq(whole, goal, rcond=mechanism.nothing)[0])
