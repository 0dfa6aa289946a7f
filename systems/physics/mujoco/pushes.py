"""Pushes on bodies of a model of MuJoCo, and masses that are put on them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import RigidBody

from parapod.systems.physics.description import parts_of
from parapod.systems.physics.mujoco.model import LARGEST, MujocoModel
from parapod.systems.physics.point_masses import Points


class Place(NamedTuple):
    """Place at which a body is pushed.

    Attributes:
        body: the body, of Drake's plant.
        place: (3) from its origin, by its axes [m].
        is_weight: true if the push is the weight of a mass that the body has there.
    """

    body: RigidBody
    place: tuple[float, float, float]
    is_weight: bool = False


@dataclass(frozen=True)
class Pushes:
    """Places of bodies at which moments and forces act.

    Attributes:
        bodies: (p) MuJoCo's bodies.
        places: (p, 3) places from their origins, by their axes [m].
        is_force: (p, 1) false of weights of masses that bodies have.
        points: these masses.
        count: number of MuJoCo's bodies.
        model: the translated plant.
    """

    bodies: NDArray[np.intp]
    places: NDArray[np.float64]
    is_force: NDArray[np.bool_]
    points: Points
    count: int
    model: MujocoModel

    @classmethod
    def of(cls, model: MujocoModel, pushed: Sequence[Place]) -> "Pushes":
        """Places on bodies of a translated plant."""
        bodies = np.array([model.bodies[int(p.body.index())] for p in pushed], dtype=np.intp)
        places = np.array([p.place for p in pushed], dtype=float).reshape(-1, 3)
        is_force = np.array([not p.is_weight for p in pushed], dtype=bool)[:, np.newaxis]
        points = Points([(i, p.body, p.place) for i, p in enumerate(pushed) if p.is_weight])
        return cls(bodies, places, is_force, points, int(model.model.nbody), model)

    @property
    def has_weights(self) -> bool:
        """True if some are weights of masses that bodies have."""
        return not self.is_force.all()

    def weigh(self, pushes: NDArray[np.float64], model: Any) -> bool:
        """Gives bodies of a model the masses that are on them; returns whether these are new.

        Args:
            pushes: (6p) moment and force at each place, by the world's axes [N m, N].
            model: MuJoCo's, as translated.
        """
        is_new = False
        for body, inertia in self.points.inertias(self.points.masses(pushes)):
            i = self.model.bodies[int(body.index())]
            mass, centre, about_centre = parts_of(inertia)
            if model.body_mass[i] != mass or (model.body_ipos[i] != centre).any():
                is_new = True
                self.model.set_inertia(model, i, mass, centre, about_centre)
        if is_new:
            self.model.complete(model)
        return is_new

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
        is_push = self.is_force & (np.abs(each).sum(axis=-1, keepdims=True) < LARGEST)
        moment, force = np.split(np.where(is_push, each, 0.0), 2, axis=-1)
        axes = xmat[..., self.bodies, :].reshape(*each.shape[:-1], 3, 3)
        place = xpos[..., self.bodies, :] + (axes * self.places[:, np.newaxis, :]).sum(axis=-1)
        about = moment + np.cross(place - xipos[..., self.bodies, :], force)
        wrenches = np.zeros((*pushes.shape[:-1], self.count, 6))
        for i, body in enumerate(self.bodies):
            wrenches[..., body, :3] += force[..., i, :]
            wrenches[..., body, 3:] += about[..., i, :]
        return wrenches
