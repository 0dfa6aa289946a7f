"""Source of what a walk asks of plate, belt, foot and hip."""

from functools import lru_cache, partial
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.path import PlatePath
from parapod.systems.terrain_simulator.terrain import Level
from parapod.systems.terrain_simulator.walk import BenchWalk, WalkMotion

# Instants that are computed at once, of a period or in the middle of periods, and how near a time
# must be to one of them [s]: devices are commanded a microsecond after an instant.
_BLOCK, _KEPT = 1024, 16
_SAME_INSTANT = 2e-6
# Outputs in their order, and their sizes.
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


class TerrainReference(Diagram):
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
        period: lead of the pose [s].
    """

    def __init__(self, walk: Task | None = None, period: float = 0.001):
        super().__init__()
        self.walk = trot() if walk is None else walk
        builder = DiagramBuilder()
        rows = builder.AddSystem(_Rows(self.walk, period))
        parts = builder.AddSystem(Demultiplexer(list(_OUTPUTS.values())))
        builder.Connect(rows.get_output_port(), parts.get_input_port())
        for i, name in enumerate(_OUTPUTS):
            builder.ExportOutput(parts.get_output_port(i), name)
        builder.BuildInto(self)
        self.set_name("terrain_reference")


class _Rows(LeafSystem):
    """All outputs of a walk, one after another: one call of Python for all that a tick needs."""

    def __init__(self, walk: Task, period: float):
        super().__init__()
        self.set_name("rows")
        self._walk, self._period = walk, period
        self._block = lru_cache(maxsize=_KEPT)(partial(_rows_of_block, walk, period))
        size = sum(_OUTPUTS.values())
        self.DeclareVectorOutputPort("row", size, self._calc_row, {self.time_ticket()})

    def _calc_row(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        halves = 2.0 * time / self._period
        number = round(halves)
        if abs(halves - number) * 0.5 * self._period > _SAME_INSTANT:
            (row,) = _rows(self._walk, np.array((time, time + self._period)))
        else:
            index, half = divmod(number, 2)
            block, place = divmod(index, _BLOCK)
            row = self._block(block, half)[place]
        output.SetFromVector(row)


def _rows_of_block(walk: Task, period: float, block: int, half: int) -> Array:
    """Rows of outputs at the instants of a block, or in the middle of the periods after them."""
    first = block * _BLOCK
    instants = np.arange(first, first + _BLOCK + 1, dtype=np.float64)
    return _rows(walk, period * (instants + 0.5 * half))


def _rows(walk: Task, times: Array) -> Array:
    """Rows at all times but the last; each shows the pose of the next."""
    now = walk.at(times)
    columns = (
        np.roll(now.pose[0], -1, axis=0),
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
    return np.concatenate([np.reshape(part, (len(times), -1)) for part in columns], axis=1)[:-1]
