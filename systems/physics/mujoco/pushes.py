"""Pushes on bodies of a model of MuJoCo."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import BodyIndex

from parapod.systems.physics.mujoco.model import LARGEST, MujocoModel


@dataclass(frozen=True)
class Pushes:
    """Places of bodies at which moments and forces act.

    Attributes:
        bodies: (p) MuJoCo's bodies.
        places: (p, 3) places from their origins, by their axes [m].
        count: number of MuJoCo's bodies.
    """

    bodies: NDArray[np.intp]
    places: NDArray[np.float64]
    count: int

    @classmethod
    def of(
        cls, model: MujocoModel, pushed: Sequence[tuple[BodyIndex, Sequence[float]]]
    ) -> "Pushes":
        """Places on bodies of a translated plant."""
        bodies = np.array([model.bodies[int(body)] for body, _ in pushed], dtype=np.intp)
        places = np.array([place for _, place in pushed], dtype=float).reshape(-1, 3)
        return cls(bodies, places, int(model.model.nbody))

    def wrenches(
        self,
        pushes: NDArray[np.float64],
        xpos: NDArray[np.float64],
        xmat: NDArray[np.float64],
        xipos: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Force and moment (..., bodies, 6) on each body, about its centre of mass [N, N m].

        Args:
            pushes: (..., 6p) moment and force at each place, by the world's axes [N m, N]; one
                that is not finite, or absurd, is none.
            xpos: (..., bodies, 3) origins of the bodies in the world [m].
            xmat: (..., bodies, 9) their axes.
            xipos: (..., bodies, 3) their centres of mass [m].
        """
        each = pushes.reshape(*pushes.shape[:-1], -1, 6)
        is_push = np.abs(each).sum(axis=-1, keepdims=True) < LARGEST
        moment, force = np.split(np.where(is_push, each, 0.0), 2, axis=-1)
        axes = xmat[..., self.bodies, :].reshape(*each.shape[:-1], 3, 3)
        place = xpos[..., self.bodies, :] + (axes * self.places[:, np.newaxis, :]).sum(axis=-1)
        about = moment + np.cross(place - xipos[..., self.bodies, :], force)
        wrenches = np.zeros((*pushes.shape[:-1], self.count, 6))
        for i, body in enumerate(self.bodies):
            wrenches[..., body, :3] += force[..., i, :]
            wrenches[..., body, 3:] += about[..., i, :]
        return wrenches
