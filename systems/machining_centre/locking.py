"""Locks and clamps of rigid bodies, switched between two steps: here, and nowhere else."""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from parapod.systems.machining_centre.model import CentreModel, pose_of
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.swing import LOCKABLE
from parapod.systems.machining_centre.switches import Switches, is_on_panel

# A joint that is slower stands, and so does a foot [rad/s, m/s].
_AT_REST, _FOOT_AT_REST = 2e-3, 1e-3


class Locking:
    """Carries out what is due: closes and opens locks and clamps of a plant's context.

    They are parameters, and a closed lock takes the velocity of its joint at once. So it waits
    until the joint stands, and a clamp until its foot stands on the panel.
    """

    def __init__(self, model: CentreModel, switches: Switches, panel: Panel):
        """Takes what belongs together.

        Args:
            model: the bodies.
            switches: knows what is due, and takes what is closed.
            panel: panel to which the clamps hold.
        """
        self._model, self._switches, self._panel = model, switches, panel

    def obey(self, root_context: Context) -> None:
        """Switches what is due and stands; to be called between two steps."""
        switches = self._switches.GetMyMutableContextFromRoot(root_context)
        due = self._switches.due(switches)
        if due is None:
            return
        context = self._model.plant.GetMyMutableContextFromRoot(root_context)
        (locks, clamps), (locked, clamped) = due, self._switches.closed(switches)
        for i, k in np.argwhere(locks != locked).tolist():
            joint = self._model.lock_joint(i + 1, LOCKABLE[k])
            if not locks[i, k]:
                joint.Unlock(context)
            elif abs(joint.get_angular_rate(context)) <= _AT_REST:
                joint.Lock(context)
            else:
                continue
            locked[i, k] = locks[i, k]
        for i in np.flatnonzero(clamps != clamped).tolist():
            if not clamps[i]:
                self._model.unclamp(context, i + 1)
            elif self._stands(context, i + 1):
                self._model.clamp(context, i + 1)
            else:
                continue
            clamped[i] = clamps[i]
        self._switches.set_closed(switches, locked, clamped)

    def _stands(self, context: Context, limb: int) -> bool:
        """Whether a foot stands where a clamp holds it."""
        foot = self._model.feet[limb - 1]
        plant = self._model.plant
        velocity: NDArray[np.float64] = plant.EvalBodySpatialVelocityInWorld(
            context, foot
        ).translational()
        on_panel = is_on_panel(self._panel, pose_of(self._model.foot_pose(context, limb)))
        return on_panel and float(np.linalg.norm(velocity)) <= _FOOT_AT_REST
