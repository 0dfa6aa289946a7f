"""A model of MuJoCo translated from a plant, its scratch memory, and maps between both states."""

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, QuaternionFloatingJoint, RigidBody
from pydrake.systems.framework import Context

from parapod.systems.core.errors import WiringError
from parapod.systems.core.extras import need
from parapod.systems.physics.description import bodies_of, inertia_of, joints_of
from parapod.systems.physics.loops import Ball, Coupling
from parapod.systems.physics.mujoco.translation import (
    WEIGHT,
    Translation,
    body_name,
    joint_name,
    principal,
    weld_of,
)

# Force that no command and no load means, and that MuJoCo refuses [N, N m].
LARGEST = 1e10
_LOG = logging.getLogger(__name__)


class MujocoModel:
    """A model of MuJoCo translated from a plant, and the maps between the states of both.

    Attributes:
        model: the compiled model.
        data: scratch memory for calculations; nothing in it outlives a call.
        plant: the plant that was translated.
        feet: bodies whose contact forces `model`'s sensors measure, in their order.
        loads: bodies whose inertia and place the model takes from `set_loads`.
        maps: maps between the states of both.
        bodies: indices of the plant's bodies in the model, in their order.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        balls: Sequence[Ball] = (),
        couplings: Sequence[Coupling] = (),
        feet: Sequence[RigidBody] = (),
        loads: Sequence[RigidBody] = (),
    ):
        """Translates a plant.

        Args:
            plant: finalized, with a time step above zero and registered with `scene_graph`.
            scene_graph: holds the geometry of the plant.
            balls: ball joints that close the plant's loops.
            couplings: its coupled joints.
            feet: bodies whose contact forces are wanted.
            loads: bodies, welded to others, whose inertia and place may be exchanged.

        Raises:
            MissingExtra: MuJoCo is not installed.
            WiringError: a part of the plant that cannot be translated.
        """
        constraint_count = len(balls) + len(couplings)
        if plant.num_constraints() != constraint_count:
            raise WiringError(
                f"the plant has {plant.num_constraints()} constraints, but only "
                f"{constraint_count} are given"
            )
        self.plant, self.feet, self.loads = plant, tuple(feet), tuple(loads)
        self._mujoco: Any = need("mujoco")
        # It would write a file into the folder in which the program runs.
        self._mujoco.set_mju_user_warning(_LOG.warning)
        self._defaults = plant.CreateDefaultContext()
        translation = Translation(self._mujoco, plant, self._defaults)
        translation.add_bodies()
        translation.add_drives()
        translation.add_balls(balls)
        translation.add_couplings(couplings)
        translation.add_contacts(scene_graph)
        translation.add_sensors(scene_graph, self.feet)
        self.model: Any = translation.spec.compile()
        self.data: Any = self._mujoco.MjData(self.model)
        self.maps = StateMaps(self.model, plant)
        self.bodies = [int(self.model.body(body_name(b)).id) for b in bodies_of(plant)]
        self._anchored = {
            index: self.model.body_mocapid[self.bodies[index]]
            for index in range(plant.num_bodies())
            if self.model.body_mocapid[self.bodies[index]] >= 0
        }
        self._load_ids = [self.model.body(body_name(body)).id for body in self.loads]
        self._set: NDArray[np.float64] | None = None
        self.set_loads(self.loads_of(self._defaults))

    @property
    def state_size(self) -> int:
        """Size of MuJoCo's state."""
        return int(self._mujoco.mj_stateSize(self.model, self._state))

    @property
    def _state(self) -> int:
        """Everything that a step depends on, the solver's warm start included."""
        return int(self._mujoco.mjtState.mjSTATE_INTEGRATION)

    def read_state(self) -> NDArray[np.float64]:
        """The state in the scratch memory."""
        state = np.empty(self.state_size)
        self._mujoco.mj_getState(self.model, self.data, state, self._state)
        return state

    def write_state(self, state: NDArray[np.float64]) -> None:
        """Puts a state into the scratch memory."""
        self._mujoco.mj_setState(self.model, self.data, state, self._state)

    def begin(self, plant_context: Context) -> NDArray[np.float64]:
        """State of MuJoCo that begins where a context of the plant is.

        Args:
            plant_context: its positions, velocities and poses of what is anchored are taken.
        """
        self._mujoco.mj_resetData(self.model, self.data)
        q = self.plant.GetPositions(plant_context)
        v = self.plant.GetVelocities(plant_context)
        self.data.qpos[:], self.data.qvel[:] = self.maps.to_mujoco(q, v)
        for index, mocap in self._anchored.items():
            body = self.plant.get_body(BodyIndex(index))
            X_WB = self.plant.EvalBodyPoseInWorld(plant_context, body)
            self.data.mocap_pos[mocap] = X_WB.translation()
            self.data.mocap_quat[mocap] = X_WB.rotation().ToQuaternion().wxyz()
        return self.read_state()

    def applied(
        self, qpos: NDArray[np.float64], force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Generalized force that acts in MuJoCo's next step.

        Args:
            qpos: (..., q) MuJoCo's positions.
            force: (..., v) along the plant's velocities [N m, N]; one that is not finite, or
                absurd, is none.
        """
        is_force = np.abs(force).sum(axis=-1, keepdims=True) < LARGEST
        # Forces turn as the velocities do along which they act.
        return self.maps.along_velocities(qpos, np.where(is_force, force, 0.0))

    def step(self) -> None:
        """Steps what is in the scratch memory."""
        self._mujoco.mj_step(self.model, self.data)

    def plant_state(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """State of the plant, positions and velocities, in a state of MuJoCo."""
        # Which begins with the time, positions and velocities.
        end = 1 + self.model.nq
        return self.maps.to_plant(state[1:end], state[end : end + self.model.nv])

    def locate(self) -> None:
        """Has the scratch memory know where bodies are, by its state."""
        self._mujoco.mj_kinematics(self.model, self.data)

    def poses(self) -> list[RigidTransform]:
        """Poses of the plant's bodies in the world, by their indices."""
        self.locate()
        places, turns = self.data.xpos, self.data.xmat
        return [
            RigidTransform(RotationMatrix(turns[i].reshape(3, 3)), places[i]) for i in self.bodies
        ]

    def loads_of(self, plant_context: Context) -> NDArray[np.float64]:
        """Inertias and poses of the loads in a context of the plant (17 each)."""
        rows: list[ArrayLike] = [np.zeros(0)]
        for body in self.loads:
            mass, centre, inertia = inertia_of(body, plant_context)
            X_PB = weld_of(self.plant, body, plant_context)
            quaternion = X_PB.rotation().ToQuaternion().wxyz()
            rows += [[mass], centre, inertia[np.triu_indices(3)], X_PB.translation(), quaternion]
        return np.concatenate(rows)

    def set_loads(self, loads: NDArray[np.float64]) -> None:
        """Gives the loads inertias and places, from `loads_of`.

        Cheap where they are those that the model has.
        """
        if self._set is not None and np.array_equal(loads, self._set):
            return
        model = self.model
        for i, row in zip(self._load_ids, loads.reshape(-1, _LOAD), strict=True):
            inertia = np.zeros((3, 3))
            inertia[np.triu_indices(3)] = row[4:10]
            self.set_inertia(model, i, row[0], row[1:4], inertia)
            model.body_pos[i], model.body_quat[i] = row[10:13], row[13:]
        self.complete(model)
        self._set = loads.copy()

    def set_inertia(
        self,
        model: Any,
        body: int,
        mass: float,
        centre: NDArray[np.float64],
        inertia: NDArray[np.float64],
    ) -> None:
        """Gives a body of a model its inertia; `complete` follows from it.

        Args:
            model: MuJoCo's, as translated.
            body: MuJoCo's body.
            mass: mass [kg].
            centre: (3) centre of mass, from the origin by the body's axes [m].
            inertia: (3, 3) inertia about it, of which the upper triangle is read [kg m^2].
        """
        model.body_mass[body], model.body_ipos[body] = mass, centre
        model.body_inertia[body], model.body_iquat[body] = principal(inertia)

    def complete(self, model: Any) -> None:
        """Calculates what follows from the inertias of a model, as translated."""
        self._mujoco.mj_setConst(model, self._mujoco.MjData(model))
        model.body_invweight0[:] = WEIGHT
        model.dof_invweight0[:] = WEIGHT

    def index_of(self, joint: Joint) -> tuple[int, int]:
        """Indices of a joint's position and velocity in MuJoCo's."""
        mujoco_joint = self.model.joint(joint_name(joint))
        return int(mujoco_joint.qposadr[0]), int(mujoco_joint.dofadr[0])


_LOAD = 17  # mass, centre of mass (3), inertia about it (6), position (3) and quaternion (4)


class StateMaps:
    """Positions and velocities of plant and MuJoCo, which order them differently.

    A floating body has its quaternion first in Drake and its position first in MuJoCo; its angular
    velocity is along the world's axes there and along its own here. All arrays may have rows.
    """

    def __init__(self, model: Any, plant: MultibodyPlant):
        self._positions = np.zeros(plant.num_positions(), dtype=int)
        self._velocities = np.zeros(plant.num_velocities(), dtype=int)
        self._floating: list[tuple[int, int]] = []  # where quaternion and angular velocity begin
        for joint in joints_of(plant):
            if joint.num_velocities() == 0:
                continue
            mujoco_joint = model.joint(joint_name(joint))
            q, v = int(mujoco_joint.qposadr[0]), int(mujoco_joint.dofadr[0])
            start, rate = joint.position_start(), joint.velocity_start()
            if isinstance(joint, QuaternionFloatingJoint):
                self._positions[start : start + 7] = (q + 3, q + 4, q + 5, q + 6, q, q + 1, q + 2)
                self._velocities[rate : rate + 6] = (v + 3, v + 4, v + 5, v, v + 1, v + 2)
                self._floating.append((start, rate))
            else:
                self._positions[start], self._velocities[rate] = q, v
        self._size = plant.num_positions()

    def layout(self) -> list[list[int]]:
        """Places of the plant's positions and velocities in MuJoCo's."""
        return [self._positions.tolist(), self._velocities.tolist()]

    def to_plant(
        self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """State of the plant for MuJoCo's positions and velocities."""
        state = np.concatenate((qpos[..., self._positions], qvel[..., self._velocities]), axis=-1)
        for start, rate in self._floating:
            w = slice(self._size + rate, self._size + rate + 3)
            state[..., w] = _turned(state[..., w], state[..., start : start + 4])
        return state

    def to_mujoco(
        self, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """MuJoCo's positions and velocities for those of the plant."""
        qpos = np.empty_like(q)
        qpos[..., self._positions] = q
        return qpos, self.along_velocities(qpos, v)

    def along_velocities(
        self, qpos: NDArray[np.float64], numbers: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Velocities or forces along those of the plant, in MuJoCo's order and axes."""
        reordered = np.empty_like(numbers)
        reordered[..., self._velocities] = numbers
        for start, rate in self._floating:
            quaternion = qpos[..., self._positions[start : start + 4]]
            back = _turned(numbers[..., rate : rate + 3], quaternion * _BACK)
            reordered[..., self._velocities[rate : rate + 3]] = back
        return reordered


# Factors of a quaternion that turn it back.
_BACK = np.array([1.0, -1.0, -1.0, -1.0])


def _turned(vector: NDArray[np.float64], quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (..., 3) turned by unit quaternions (..., 4), to the last bit as MuJoCo does."""
    (a, b, c), (w, x, y, z) = vector.T, quaternion.T
    p, q, r = w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a
    turned = a + 2 * (y * r - z * q), b + 2 * (z * p - x * r), c + 2 * (x * q - y * p)
    return np.stack(turned, axis=-1)
