"""Drives of a model of MuJoCo: springs and dampers that lead its joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import ModelInstanceIndex

from parapod.systems.physics.mujoco.model import LARGEST, MujocoModel


@dataclass(frozen=True)
class Drives:
    """Springs and dampers between where drives are and where they are led.

    All arrays of numbers may have rows (..., n).

    Attributes:
        order: (k) their indices among MuJoCo's, in the order of the port.
        desired: (2, k) where positions and rates are at the port.
        joints: (2, k) where positions and velocities are among MuJoCo's.
        stiffness: (..., k) [N/m, N m/rad].
        damping: (..., k) [N s/m, N m s/rad].
    """

    order: NDArray[np.intp]
    desired: NDArray[np.intp]
    joints: NDArray[np.intp]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]

    @classmethod
    def of(cls, model: MujocoModel, groups: Sequence[Sequence[ModelInstanceIndex]]) -> "Drives":
        """Drives of a model, group by group."""
        plant = model.plant
        drives: list[Any] = []
        desired: list[tuple[int, int]] = []
        for group in groups:
            indices = [i for part in group for i in plant.GetJointActuatorIndices(part)]
            first, size = 2 * len(drives), len(indices)
            desired += [(first + k, first + k + size) for k in range(size)]
            drives += map(plant.get_joint_actuator, indices)
        joints = [model.index_of(drive.joint()) for drive in drives]
        gains = [drive.get_controller_gains() for drive in drives]
        return cls(
            np.array([int(drive.index()) for drive in drives], dtype=int),
            np.array(desired, dtype=int).reshape(-1, 2).T,
            np.array(joints, dtype=int).reshape(-1, 2).T,
            np.array([gain.p for gain in gains]),
            np.array([gain.d for gain in gains]),
        )

    @property
    def count(self) -> int:
        """Number k of the drives."""
        return len(self.order)

    def control(
        self, desired: NDArray[np.float64], qpos: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Control (..., k) for what the port has (..., 2k); drives without a command stay."""
        positions, rates = (desired[..., places] for places in self.desired)
        with np.errstate(all="ignore"):
            control: NDArray[np.float64] = self.stiffness * positions + self.damping * rates
            is_command = np.abs(control) < LARGEST
        return control if is_command.all() else np.where(is_command, control, self.hold(qpos))

    def hold(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """Control (..., k) that leads the drives to where they are."""
        at: NDArray[np.float64] = qpos[..., self.joints[0]]
        return self.stiffness * at

    def holding_force(
        self,
        control: NDArray[np.float64],
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Forces (..., k) during the step that led to these positions and velocities.

        MuJoCo returns forces as they were before the step, which is not what acted.
        """
        at, rates = qpos[..., self.joints[0]], qvel[..., self.joints[1]]
        forces: NDArray[np.float64] = control - self.stiffness * at - self.damping * rates
        return forces
