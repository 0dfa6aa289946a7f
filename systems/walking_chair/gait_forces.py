"""Whether the chair's actuators can carry a passenger through a walk."""

import numpy as np

from parapod.systems.errors import ParapodError
from parapod.systems.walking_chair.branches import BRANCHES
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import (
    GRAVITY,
    ChairMasses,
    Passenger,
    centre_of_mass,
)
from parapod.systems.walking_chair.payload import FORCE_LIMIT
from parapod.systems.walking_chair.standing import rest
from parapod.systems.walking_chair.statics import force_map
from parapod.systems.walking_chair.walk import Walk

# Instants looked at in each phase.
_TIMES = 5


class ForceExceeded(ParapodError):
    """A branch that would have to push or pull harder than its actuator does.

    Attributes:
        branch: its name, as in "branch 12".
        time: when, in the gait's time [s].
        force: how hard, positive where it pushes [N].
        limit: how hard it can [N].
    """

    def __init__(self, branch: str, time: float, force: float, limit: float):
        self.branch, self.time, self.force, self.limit = branch, time, force, limit
        super().__init__(
            f"{branch} would have to hold {force:.1f} N at {time:.3f} s, "
            f"{abs(force) - limit:.1f} N more than its limit {limit:.1f} N"
        )


def check_forces(
    geometry: ChairGeometry,
    walk: Walk,
    passenger: Passenger,
    masses: ChairMasses = ChairMasses(),
    limit: float = FORCE_LIMIT,
) -> None:
    """Refuses a passenger who is too heavy for the branches, which share the load as springs.

    All cycles are alike, so the first phases of each gait are looked at.

    Args:
        geometry: the chair.
        walk: the gaits.
        passenger: who sits on it.
        masses: of the chair.
        limit: largest force of a branch, either way [N].

    Raises:
        ForceExceeded: names the branch and the time of the largest force.
    """
    times = _instants(walk)
    motion = walk.motions(geometry, times)
    body = np.asarray(motion.body.position)
    lengths = chair_inverse(geometry, body, np.eye(3), motion.feet.position, motion.references)
    corners = foot_corners(geometry, body, np.eye(3), lengths) - body[:, None, None, :]
    forces = []
    for at, places in zip(lengths, corners, strict=True):
        mass, centre = centre_of_mass(masses, passenger, places.mean(axis=-2))
        vertical = force_map(geometry, at)[..., 2]
        own = masses.foot_end * GRAVITY
        at_rest = rest(places.reshape(12, 3), vertical, mass * GRAVITY, centre, own)
        forces.append(at_rest.branch_forces)
    sizes = np.abs(forces)
    if sizes.max() > limit:
        when, branch = np.unravel_index(int(sizes.argmax()), sizes.shape)
        force = float(np.array(forces)[when, branch])
        raise ForceExceeded(BRANCHES[branch], float(times[when]), force, limit)


def _instants(walk: Walk) -> np.ndarray:
    """Times in the lift and the first cycle of each gait, and in its end."""
    found, begin = [], 0.0
    for gait in walk.gaits:
        first = np.linspace(0.0, 4.0 * gait.phase_duration, 4 * _TIMES + 1)
        found.append(begin + first)
        begin += gait.duration
    return np.concatenate(found)
