"""Rigid bodies stepped by MuJoCo as a discrete system of a diagram."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import FramePoseVector
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import has_value, read_array
from parapod.systems.physics.mujoco.model import MujocoModel

# Force of a drive with its joint at zero that no command means, and that MuJoCo refuses [N, N m].
_LARGEST = 1e10


_PHYSICS, _FORCES = 0, 1  # groups of the discrete state


class MujocoPlant(LeafSystem):
    """A translated `MultibodyPlant`, stepped by MuJoCo: for results of two engines.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `desired_state` | 2k | m, rad, and their rates | what the drives are led to |
    | in `applied_force` | v | N m, N | along the plant's velocities; unconnected: 0 |
    | out `holding_force` | k | N, N m | with which the drives held in the last step |
    | out `state` | m | m, rad, and their rates | positions and velocities of the plant |
    | out `contact_force` | f | N | normal contact forces on the feet in the last step |
    | out `body_poses` | abstract | - | poses of its bodies in the world, by their indices |
    | out `geometry_pose` | abstract | - | the same for the scene graph of its geometry |

    Drives come in groups; `desired_state` has positions and then velocities of each group, one
    step ahead. Like those of Drake's discrete plant they are springs and dampers that act
    implicitly over a step. In a default context the last step is a first one at rest.

    State: discrete, MuJoCo's own with the solver's warm start, and the forces of the last step,
    updated every step. MuJoCo's memory is scratch: nothing in it outlives a call.

    Parameters (Context): inertias and places of the model's loads, see `MujocoModel.loads_of`.

    Bad input: a drive whose command is not finite, or absurd, is led to where it is; an applied
    force of that kind counts as zero.
    """

    def __init__(
        self,
        model: MujocoModel,
        groups: Sequence[Sequence[ModelInstanceIndex]] = (),
        begins: Context | None = None,
    ):
        """Creates the plant.

        Args:
            model: the translated plant.
            groups: model instances whose drives make a group of commands; all that have some.
            begins: context of the translated plant that is the beginning in a default context;
                None for its default.
        """
        super().__init__()
        self.set_name("mujoco_plant")
        self.model = model
        self._drives = _Drives(model, groups)
        count = self._drives.count
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * count)
        size = model.plant.num_velocities()
        self._applied = self.DeclareVectorInputPort("applied_force", size)
        context = model.plant.CreateDefaultContext() if begins is None else begins
        loads, physics, forces = self._beginning(context)
        self._loads = self.DeclareNumericParameter(BasicVector(loads))
        moves = {self.discrete_state_ticket(self.DeclareDiscreteState(physics))}
        acts = {self.discrete_state_ticket(self.DeclareDiscreteState(forces))}
        plant = model.plant
        for name, size, calc, tickets in (
            ("holding_force", count, self._calc_holding_force, acts),
            ("state", plant.num_multibody_states(), self._calc_state, moves),
            ("contact_force", len(model.feet), self._calc_contact_force, acts),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        for name, kind, show in (
            ("body_poses", Value[list[RigidTransform]], self._calc_body_poses),
            ("geometry_pose", Value[FramePoseVector], self._calc_geometry_pose),
        ):
            tickets = moves | {self.all_parameters_ticket()}
            self.DeclareAbstractOutputPort(name, kind, show, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(plant.time_step(), 0.0, self._update_state)

    def put(self, context: Context, plant_context: Context) -> None:
        """Begins where a context of the translated plant is.

        Args:
            context: context of this system.
            plant_context: its positions, velocities, anchored poses and loads are taken.
        """
        loads, physics, forces = self._beginning(plant_context)
        context.SetDiscreteState(_PHYSICS, physics)
        context.SetDiscreteState(_FORCES, forces)
        self._set_loads(context, loads)

    def load(self, context: Context, plant_context: Context) -> None:
        """Exchanges the loads for those in a context of the translated plant."""
        self._set_loads(context, self.model.loads_of(plant_context))

    def _set_loads(self, context: Context, loads: NDArray[np.float64]) -> None:
        parameter: Any = context.get_mutable_numeric_parameter(self._loads)
        parameter.SetFromVector(loads)

    def _beginning(self, plant_context: Context) -> tuple[NDArray[np.float64], ...]:
        """Loads, MuJoCo's state, and the forces of a first step with the drives at rest."""
        loads = self.model.loads_of(plant_context)
        self.model.set_loads(loads)
        physics = self.model.begin(plant_context)
        return loads, physics, self._step(self._drives.hold(physics))

    def _step(self, control: NDArray[np.float64]) -> NDArray[np.float64]:
        """Steps what is in the scratch memory; returns the forces (k + f) during the step."""
        data = self.model.data
        data.ctrl[self._drives.order] = control
        self.model.step()
        holding = self._drives.holding_force(control, data.qpos, data.qvel)
        return np.concatenate((holding, data.sensordata))

    def _restore(self, context: Context) -> NDArray[np.float64]:
        """Puts the scratch memory where a context is; returns MuJoCo's state."""
        loads: Any = context.get_numeric_parameter(self._loads)
        physics: NDArray[np.float64] = context.get_discrete_state(_PHYSICS).value()
        self.model.set_loads(loads.value())
        self.model.write_state(physics)
        return physics

    def _update_state(self, context: Context, discrete_state: DiscreteValues) -> None:
        physics = self._restore(context)
        control = self._drives.control(read_array(self._desired, context), physics)
        self.model.data.qfrc_applied[:] = 0.0
        if has_value(self._applied, context):
            applied = read_array(self._applied, context)
            if sum(map(abs, applied.tolist())) < _LARGEST:
                self.model.apply(applied)
        forces = self._step(control)
        discrete_state.set_value(_PHYSICS, self.model.read_state())
        discrete_state.set_value(_FORCES, forces)

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        physics = context.get_discrete_state(_PHYSICS).value()
        output.SetFromVector(self.model.plant_state(physics))

    def _calc_body_poses(self, context: Any, output: Any) -> None:
        self._restore(context)
        output.set_value(self.model.poses())

    def _calc_geometry_pose(self, context: Any, output: Any) -> None:
        self._restore(context)
        poses = FramePoseVector()
        for index, pose in enumerate(self.model.poses()):
            frame = self.model.plant.GetBodyFrameIdIfExists(BodyIndex(index))
            if frame is not None and index:
                poses.set_value(frame, pose)
        output.set_value(poses)

    def _calc_holding_force(self, context: Context, output: BasicVector) -> None:
        forces = context.get_discrete_state(_FORCES).value()
        output.SetFromVector(forces[: self._drives.count])

    def _calc_contact_force(self, context: Context, output: BasicVector) -> None:
        forces = context.get_discrete_state(_FORCES).value()
        output.SetFromVector(forces[self._drives.count :])


class _Drives:
    """Springs and dampers between where drives are and where they are led.

    Attributes:
        count: number k of the drives.
        order: their indices among MuJoCo's, in the order of the port.
    """

    def __init__(self, model: MujocoModel, groups: Sequence[Sequence[ModelInstanceIndex]]):
        plant = model.plant
        drives = [
            [
                plant.get_joint_actuator(i)
                for instance in group
                for i in plant.GetJointActuatorIndices(instance)
            ]
            for group in groups
        ]
        self.order = np.array([int(drive.index()) for group in drives for drive in group], int)
        self.count = len(self.order)
        flat = [drive for group in drives for drive in group]
        joints = [model.index_of(drive.joint()) for drive in flat]
        indices = np.array(joints, dtype=int).reshape(-1, 2)
        self._positions, self._rates = indices.T
        self._stiffness = np.array([drive.get_controller_gains().p for drive in flat])
        self._damping = np.array([drive.get_controller_gains().d for drive in flat])
        # (k, 2k): the control for what the port has.
        self._gains = np.zeros((self.count, 2 * self.count))
        first = 0
        for size in map(len, drives):
            rows = np.arange(first, first + size)
            self._gains[rows, first + rows] = self._stiffness[rows]
            self._gains[rows, first + rows + size] = self._damping[rows]
            first += size

    def control(
        self, desired: NDArray[np.float64], physics: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Control (k) for what the port has (2k); drives without a command stay."""
        with np.errstate(all="ignore"):
            control: NDArray[np.float64] = self._gains @ desired
            if np.abs(control).max(initial=0.0) < _LARGEST:
                return control
            # Row by row, as what is not finite is so in all rows of the product.
            own = np.where(self._gains != 0.0, self._gains * desired, 0.0).sum(axis=1)
            return np.where(np.abs(own) < _LARGEST, own, self.hold(physics))

    def hold(self, physics: NDArray[np.float64]) -> NDArray[np.float64]:
        """Control (k) that leads the drives to where they are in a state of MuJoCo."""
        at: NDArray[np.float64] = physics[1 + self._positions]  # the time comes first
        return self._stiffness * at

    def holding_force(
        self,
        control: NDArray[np.float64],
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Forces (k) during the step that led to these positions and velocities.

        MuJoCo returns forces as they were before the step, which is not what acted.
        """
        forces: NDArray[np.float64] = (
            control - self._stiffness * qpos[self._positions] - self._damping * qvel[self._rates]
        )
        return forces
