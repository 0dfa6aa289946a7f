"""Age and faults of simulated devices, in the vocabulary that hardware reports them in."""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem

# Two instants closer than this are the same one: sample times are sums and products of periods.
_SAME_INSTANT = 1e-9


class DeviceStatus(LeafSystem):
    """Age of each device's last sample, and whether the device has failed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `age` | n | s | time since the device's last sample, one entry a device |
    | out `fault` | n | - | fault codes; all 0: simulated devices do not fail by themselves |

    No state: a device samples at the multiples of its period, so its age follows from the time.
    At a sample's instant the age is zero.

    Bad input: at a time that is not finite the age is zero.

    Args:
        devices: names of the devices, in the ports' order.
        periods: their sampling periods [s]; 0 for one that is always up to date.
        delays: age of a sample when it is shown [s]; empty for fresh ones.
    """

    def __init__(
        self,
        devices: Sequence[str] = ("device",),
        periods: Sequence[float] = (0.0,),
        delays: Sequence[float] = (),
    ) -> None:
        super().__init__()
        if len(devices) != len(periods):
            raise ValueError(f"{len(devices)} devices, but {len(periods)} periods")
        if not all(period >= 0.0 for period in periods):
            raise ValueError(f"periods must be 0 or more, not {tuple(periods)}")
        self.set_name("device_status")
        self.devices, self.periods = tuple(devices), tuple(periods)
        self.delays = tuple(delays) or (0.0,) * len(devices)
        self.DeclareVectorOutputPort(
            "age",
            len(devices),
            self._calc_age,
            # Without a sampled device the age is constant.
            prerequisites_of_calc={
                self.time_ticket() if any(self.periods) else self.nothing_ticket()
            },
        )
        self.DeclareVectorOutputPort(
            "fault",
            len(devices),
            self._calc_fault,
            prerequisites_of_calc={self.nothing_ticket()},
        )

    def _calc_age(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        ages = [
            delay + _age(time, period)
            for period, delay in zip(self.periods, self.delays, strict=True)
        ]
        output.SetFromVector(np.array(ages))

    def _calc_fault(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.zeros(len(self.devices)))


def _age(time: float, period: float) -> float:
    """Time since the last multiple of the period; zero for a period of zero."""
    if period == 0.0:
        return 0.0
    age = (time + _SAME_INSTANT) % period - _SAME_INSTANT
    return age if age > 0.0 else 0.0
