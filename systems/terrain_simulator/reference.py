"""Source of what a walk asks of plate, belt, foot and hip."""

import weakref
from functools import lru_cache, partial
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.core.ports import declare_cached
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.path import PlatePath
from parapod.systems.terrain_simulator.terrain import Level
from parapod.systems.terrain_simulator.walk import BenchWalk, WalkMotion

# Instants that are computed at once, and how near an instant must be to one of them. They are half
# a period apart: devices are commanded in the middle of a period.
_BLOCK, _KEPT = 512, 64
_SAME_INSTANT = 1e-6  # [half periods]
# Outputs, their sizes, and their places in a row.
_OUTPUTS = {
    "pose_asked": 3,
    "plate_motion": 9,
    "foot_desired": 6,
    "foot_force_desired": 1,
    "hip_force": 1,
    "hip_desired": 2,
    "belt_velocity": 1,
    "stance": 1,
    "distance": 1,
    "rise": 1,
    "done": 1,
}


class Task(Protocol):
    """Motion that is asked for: a walk, a jump.

    Attributes:
        hip: x, z of the hip while it neither bounces nor jumps [m].
        duration: time at which all stands again [s].
    """

    # fmt: off
    @property
    def hip(self) -> tuple[float, float]: ...  # noqa: D102
    @property
    def duration(self) -> float: ...  # noqa: D102
    # fmt: on

    def at(self, time: ArrayLike) -> WalkMotion:
        """Motion at times (...) [s]."""


def trot() -> BenchWalk:
    """The walking trot at 1.5 m/s of a leg of a 120 kg robot, on the pedal."""
    path = PlatePath(Level(), Gait(1.5, ramp=0.28), x_c=0.513, z_c=0.30)
    return BenchWalk(path, mass=30.0, hip_height=0.58)


class TerrainReference(LeafSystem):
    """Source of a walk over a terrain.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `pose_asked` | 3 | m, m, rad | x, z, phi of the plate a period later |
    | out `plate_motion` | 9 | m, rad, s | pose now, its rates, and the rates of these |
    | out `foot_desired` | 6 | m, s | x, z of the foot from the hip, rates, accelerations |
    | out `foot_force_desired` | 1 | N | force of the ground on the foot, upwards |
    | out `hip_force` | 1 | N | on the slide, upwards: what the other legs carry |
    | out `hip_desired` | 2 | m, m/s | height of the hip above the rail, and its rate |
    | out `belt_velocity` | 1 | m/s | of the belt, positive to the rear |
    | out `stance` | 1 | 0/1 | whether the foot stands |
    | out `distance` | 1 | m | way of the body |
    | out `rise` | 1 | m | height of the body above that of the distance zero |
    | out `done` | 1 | 0/1 | whether the leg stands at last |

    Outputs follow from the time alone; see `BenchWalk`.

    State: none.

    Args:
        walk: the walk, or another task; None for `trot`.
        period: by which the pose is ahead [s].
    """

    def __init__(self, walk: Task | None = None, period: float = 0.001):
        super().__init__()
        self.set_name("terrain_reference")
        self.walk = trot() if walk is None else walk
        self._period = period
        self._block = lru_cache(maxsize=_KEPT)(partial(_rows, self.walk, period))
        time = {self.time_ticket()}
        row = declare_cached(self, "row", self._calc_row, time)
        self._row = row
        first = 0
        for name, size in _OUTPUTS.items():
            calc = partial(_copy_row, weakref.ref(self), slice(first, first + size))
            self.DeclareVectorOutputPort(name, size, calc, {row.ticket})
            first += size

    def row(self, context: Context) -> Array:
        """All outputs, one after another; not to be changed."""
        found: Array = self._row.of(self, context)
        return found

    def _calc_row(self, context: Context) -> Array:
        halves = 2.0 * context.get_time() / self._period
        number = round(halves)
        if abs(halves - number) > _SAME_INSTANT:
            between: Array = _rows_at(self.walk, self._period, np.array([context.get_time()]))[0]
            return between
        block, index = divmod(number, _BLOCK)
        rows: Array = self._block(block)
        return rows[index]


def _rows(walk: Task, period: float, block: int) -> Array:
    """Rows of outputs at the instants of a block."""
    first = block * _BLOCK
    halves = np.arange(first, first + _BLOCK, dtype=np.float64)
    return _rows_at(walk, period, 0.5 * period * halves)


def _rows_at(walk: Task, period: float, times: Array) -> Array:
    ahead, now = walk.at(times + period).pose[0], walk.at(times)
    columns = (
        ahead,
        *now.pose,
        *now.foot,
        now.force,
        now.hip_force,
        np.stack((walk.hip[1] + now.bounce[0], now.bounce[1]), axis=-1),
        now.belt,
        now.stance,
        now.distance[0],
        now.rise[0],
        times >= walk.duration,
    )
    return np.concatenate([np.reshape(part, (len(times), -1)) for part in columns], axis=1)


def _copy_row(
    reference: weakref.ref[TerrainReference], part: slice, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = reference()
    assert system is not None
    output.SetFromVector(system.row(context)[part])
