"""Incremental encoders and the counter card that reads them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read


class Encoder(LeafSystem):
    """Positions in whole counts, and velocities in counts per gate time.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | n | m or rad | true positions |
    | in `velocity` | n | m/s or rad/s | true velocities |
    | out `position_measured` | n | m or rad | rounded to counts |
    | out `velocity_measured` | n | m/s or rad/s | rounded to counts per gate time |

    No state: the outputs follow the inputs. The counters are taken to be referenced, so that
    zero counts are zero position; the velocity has no delay, as if the gate were centred.

    Bad input: a NaN or infinite value reads zero.

    Args:
        channels: number of encoders n.
        resolution: one count [m or rad]; the default, 10 um, is an assumption. 0 is ideal:
            position and velocity pass unchanged.
        gate_time: time over which counts are counted for the velocity [s]; its resolution is
            resolution / gate_time, 1 mm/s by default.
    """

    def __init__(
        self, channels: int = 4, resolution: float = 1e-5, gate_time: float = 0.01
    ) -> None:
        super().__init__()
        if not (resolution >= 0.0 and gate_time > 0.0):
            raise ValueError(
                f"resolution must be 0 or more and gate_time above 0, "
                f"not {resolution} and {gate_time}"
            )
        self.set_name("encoder")
        self.channels, self.resolution, self.gate_time = channels, resolution, gate_time
        self._position: Any = self.DeclareVectorInputPort("position", channels)
        self._velocity: Any = self.DeclareVectorInputPort("velocity", channels)
        self.DeclareVectorOutputPort(
            "position_measured",
            channels,
            self._calc_position_measured,
            prerequisites_of_calc={self._position.ticket()},
        )
        self.DeclareVectorOutputPort(
            "velocity_measured",
            channels,
            self._calc_velocity_measured,
            prerequisites_of_calc={self._velocity.ticket()},
        )

    def _calc_position_measured(self, context: Context, output: BasicVector) -> None:
        values = read(self._position, context)
        output.SetFromVector(_counted(values, self.resolution))

    def _calc_velocity_measured(self, context: Context, output: BasicVector) -> None:
        values = read(self._velocity, context)
        output.SetFromVector(_counted(values, self.resolution / self.gate_time))


def _counted(values: list[float], count: float) -> NDArray[np.float64]:
    """Values rounded to whole counts, or unchanged for a count of zero."""
    # A value too large to be divided by the count is its own rounding.
    largest = 1e15 * count
    return np.array(
        [
            round(value / count) * count
            if -largest < value < largest
            else (value if math.isfinite(value) else 0.0)
            for value in values
        ]
    )
