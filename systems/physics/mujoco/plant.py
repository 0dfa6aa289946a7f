"""Rigid bodies stepped by MuJoCo as a discrete system of a diagram."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import FramePoseVector
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem, RowsContext
from parapod.systems.core.ports import has_value, read_batch
from parapod.systems.physics.mujoco.batch import MujocoRows
from parapod.systems.physics.mujoco.drives import Drives
from parapod.systems.physics.mujoco.model import MujocoModel
from parapod.systems.physics.mujoco.pushes import Place, Pushes

_PHYSICS, _FORCES = 0, 1  # groups of the discrete state


class Commands(NamedTuple):
    """Numbers (..., n) at the inputs of a `MujocoPlant`; None where nothing is connected."""

    desired_state: NDArray[np.float64]
    applied_force: NDArray[np.float64] | None
    pushes: NDArray[np.float64] | None


class MujocoPlant(LeafSystem):
    """A translated `MultibodyPlant`, stepped by MuJoCo: for results of two engines.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `desired_state` | 2k | m, rad, and their rates | what the drives are led to |
    | in `applied_force` | v | N m, N | along the plant's velocities; unconnected: 0 |
    | in `pushes` | 6p | N m, N | moment and force at each place, in the world; unconnected: 0 |
    | out `holding_force` | k | N, N m | with which the drives held in the last step |
    | out `state` | m | m, rad, and their rates | positions and velocities of the plant |
    | out `contact_force` | f | N | normal contact forces on the feet in the last step |
    | out `body_poses` | abstract | - | poses of its bodies in the world, by their indices |
    | out `geometry_pose` | abstract | - | the same for the scene graph of its geometry |

    Drives come in groups; `desired_state` has positions and then velocities of each group, one
    step ahead. Like those of Drake's discrete plant they are springs and dampers that act
    implicitly over a step. In a default context the last step is a first one at rest. A push that
    is the weight of a mass gives the body that mass, with its inertia, in place of a force.

    State: discrete, MuJoCo's own with the solver's warm start, and the forces of the last step,
    updated every step. MuJoCo's memory is scratch: nothing in it outlives a call.

    Parameters (Context): inertias and places of the model's loads, see `MujocoModel.loads_of`.

    Bad input: a drive whose command is not finite, or absurd, is led to where it is; an applied
    force, a push or a mass of that kind counts as zero, as does one that a body has not got to
    lose.
    """

    def __init__(
        self,
        model: MujocoModel,
        groups: Sequence[Sequence[ModelInstanceIndex]] = (),
        begins: Context | None = None,
        pushed: Sequence[Place] = (),
    ):
        """Creates the plant.

        Args:
            model: the translated plant.
            groups: model instances whose drives make a group of commands; all that have some.
            begins: context of the translated plant that is the beginning in a default context;
                None for its default.
            pushed: places of bodies that are pushed, or bear a mass.
        """
        super().__init__()
        self.set_name("mujoco_plant")
        self.model = model
        self.drives = Drives.of(model, groups)
        count = self.drives.count
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * count)
        size = model.plant.num_velocities()
        self._applied = self.DeclareVectorInputPort("applied_force", size)
        self.pushes = Pushes.of(model, pushed)
        self._pushes = self.DeclareVectorInputPort("pushes", 6 * len(pushed))
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
        self.declare_memory(MujocoRows)

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
        self.pushes.weigh(np.zeros(6 * len(self.pushes.bodies)), self.model.model)
        physics = self.model.begin(plant_context)
        return loads, physics, self._step(self.drives.hold(self.model.data.qpos))

    def _step(self, control: NDArray[np.float64]) -> NDArray[np.float64]:
        """Steps what is in the scratch memory; returns the forces (k + f) during the step."""
        data = self.model.data
        data.ctrl[self.drives.order] = control
        self.model.step()
        holding = self.drives.holding_force(control, data.qpos, data.qvel)
        return np.concatenate((holding, data.sensordata))

    def layout(self) -> list[list[int]]:
        """Places of joints, drives and bodies in MuJoCo's: the same for plants that are alike."""
        drives = self.drives
        joints = [*drives.joints.tolist(), *self.model.maps.layout()]
        return [drives.order.tolist(), *joints, self.model.bodies]

    def loads_in(self, context: Any) -> NDArray[np.float64]:
        """The loads in a context of this system, as `MujocoModel.set_loads` takes them."""
        loads: NDArray[np.float64] = context.get_numeric_parameter(self._loads).value()
        return loads

    def _restore(self, context: Context) -> None:
        """Puts the scratch memory where a context is."""
        self.model.set_loads(self.loads_in(context))
        self.model.write_state(context.get_discrete_state(_PHYSICS).value())

    def commands_in(self, context: Context | RowsContext) -> Commands:
        """Numbers at the inputs."""
        applied, pushes = (
            read_batch(port, context) if port.size() and has_value(port, context) else None
            for port in (self._applied, self._pushes)
        )
        return Commands(read_batch(self._desired, context), applied, pushes)

    def _update_state(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._restore(context)
        data = self.model.data
        commands = self.commands_in(context)
        data.qfrc_applied[:] = 0.0
        data.xfrc_applied[:] = 0.0
        if commands.applied_force is not None:
            data.qfrc_applied[:] = self.model.applied(data.qpos, commands.applied_force)
        pushes = np.zeros(self._pushes.size()) if commands.pushes is None else commands.pushes
        self.pushes.weigh(pushes, self.model.model)
        if commands.pushes is not None:
            self.model.locate()
            wrenches = self.pushes.wrenches(commands.pushes, data.xpos, data.xmat, data.xipos)
            data.xfrc_applied[:] = wrenches
        forces = self._step(self.drives.control(commands.desired_state, data.qpos))
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
        output.SetFromVector(forces[: self.drives.count])

    def _calc_contact_force(self, context: Context, output: BasicVector) -> None:
        forces = context.get_discrete_state(_FORCES).value()
        output.SetFromVector(forces[self.drives.count :])
