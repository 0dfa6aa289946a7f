"""Machines of many rows that MuJoCo steps in threads of its own."""

import copy
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.extras import need
from parapod.systems.core.leaf_system import RowsContext, RowsMemory
from parapod.systems.core.rows import numbers_of
from parapod.systems.physics.poses import PosesOfRows


class MujocoRows(RowsMemory):
    """Rows of a `MujocoPlant`: simulations of a `mujoco.batch.Batch`.

    Each row has the model of its own plant, with its loads; rows that share both share a model.
    Every row is what MuJoCo makes of it alone, to the last bit, whatever the number of threads:
    `OMP_NUM_THREADS`, as in other libraries, or one for each core.
    """

    def __init__(self) -> None:
        self._systems: list[Any] = []
        self._beginnings: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        self._models: list[Any] = []
        self._copies: dict[tuple[int, bytes, int], Any] = {}

    def add(self, system: Any, context: Any) -> None:
        """Takes a row's model and state.

        Raises:
            ParapodError: a plant that is laid out otherwise than the first row's.
        """
        if self._systems and system.layout() != self._systems[0].layout():
            raise ParapodError("MuJoCo steps rows of plants together that have the same joints")
        loads = system.loads_in(context)
        # Masses that are put on bodies make each row's model its own.
        row = len(self._systems) if system.pushes.has_weights else 0
        key = id(system), loads.tobytes(), row
        if key not in self._copies:
            system.model.set_loads(loads)
            system.pushes.weigh(np.zeros(6 * len(system.pushes.bodies)), system.model.model)
            self._copies[key] = copy.copy(system.model.model)
        self._models.append(self._copies[key])
        self._systems.append(system)
        groups = (context.get_discrete_state(k).value().copy() for k in range(2))
        self._beginnings.append(tuple(groups))

    def begin(self) -> None:
        """Makes the batch."""
        batches: Any = need("mujoco.batch")
        systems, models = self._systems, self._models
        self._plant: Any = systems[0]
        threads = int(os.environ.get("OMP_NUM_THREADS") or 0)
        self._batch: Any = batches.Batch(models[0], len(models), threads)
        if len(self._copies) > 1:
            try:
                self._batch.set_models(models)
            except ValueError as error:
                raise ParapodError(
                    f"MuJoCo does not step these plants together: {error}"
                ) from error
        physics, forces = zip(*self._beginnings, strict=True)
        self._batch.state[:], self._forces = physics, np.array(forces)
        self._drives = replace(
            self._plant.drives,
            stiffness=np.array([system.drives.stiffness for system in systems]),
            damping=np.array([system.drives.damping for system in systems]),
        )
        # Simulations that go on; those that have ended stay as they are.
        self._ids = np.arange(len(models))
        self._names = [
            self._plant.get_output_port(i).get_name()
            for i in range(self._plant.num_output_ports())
        ]
        self._weighed = self._models if self._plant.pushes.has_weights else []
        self._pushes = [system.pushes for system in systems]
        del self._systems, self._beginnings, self._models

    def output(self, index: int) -> Any:
        """Numbers, or poses, of all rows at an output."""
        name, batch, count = self._names[index], self._batch, self._drives.count
        if name == "holding_force":
            return numbers_of(self._forces[:, :count])
        if name == "contact_force":
            return numbers_of(self._forces[:, count:])
        if name == "state":
            maps = self._plant.model.maps
            return numbers_of(maps.to_plant(batch.qpos[self._ids], batch.qvel[self._ids]))
        if name == "body_poses":
            places = self._places("xpos", "xmat")
            return PosesOfRows(*(field[:, self._plant.model.bodies] for field in places))
        raise TypeError(f"rows are not drawn: {name}")

    def _places(self, *names: str) -> list[NDArray[np.float64]]:
        """Fields (rows, bodies, n) that tell where MuJoCo's bodies are."""
        # They are copied out after a call, if they have been bound before it.
        fields = [self._batch.bind(name) for name in names]
        self._batch.forward(self._ids, need("mujoco").mjtStage.mjSTAGE_POS)
        return [field[self._ids] for field in fields]

    def update(self, context: RowsContext) -> Callable[[], Mapping[int, Exception]]:
        """Reads the commands, and gives the step."""
        commands = self._plant.commands_in(context)
        return lambda: self._step(commands)

    def _step(self, commands: Any) -> Mapping[int, Exception]:
        batch, ids = self._batch, self._ids
        qpos = batch.qpos[ids]
        control = self._drives.control(commands.desired_state, qpos)
        batch.ctrl[ids[:, np.newaxis], self._drives.order] = control
        if commands.applied_force is not None:
            batch.qfrc_applied[ids] = self._plant.model.applied(qpos, commands.applied_force)
        if commands.pushes is not None:
            self._weigh(commands.pushes)
            places = self._places("xpos", "xmat", "xipos")
            batch.xfrc_applied[ids] = self._plant.pushes.wrenches(commands.pushes, *places)
        sensors = batch.bind("sensordata")
        errors: dict[int, Exception] = {}
        try:
            batch.step(ids)
        except need("mujoco.batch").SimulationError as error:
            kind = need("mujoco").FatalError
            for i in error.ids:
                errors[int(np.searchsorted(ids, i))] = kind(batch.error(int(i)))
        holding = self._drives.holding_force(control, batch.qpos[ids], batch.qvel[ids])
        self._forces = np.concatenate((holding, sensors[ids]), axis=1)
        return errors

    def _weigh(self, pushes: NDArray[np.float64]) -> None:
        """Gives bodies of each row's model the masses that are on them."""
        if not self._weighed:
            return
        rows = zip(self._ids.tolist(), pushes, strict=True)
        changes = [self._pushes[i].weigh(row, self._weighed[i]) for i, row in rows]
        if any(changes):
            self._batch.set_models(self._weighed)

    def keep(self, positions: NDArray[np.intp]) -> None:
        """Goes on with some of the rows."""
        self._ids, self._forces = self._ids[positions], self._forces[positions]
        drives = self._drives
        self._drives = replace(
            drives, stiffness=drives.stiffness[positions], damping=drives.damping[positions]
        )

    def state(self, position: int) -> list[list[float]]:
        """MuJoCo's state, and the forces of a row's last step."""
        physics = self._batch.state[self._ids[position]]
        return [physics.tolist(), self._forces[position].tolist()]
