"""The actuators' gain K from logs of voltage steps, alone and apart from friction."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from parapod.sims.identify_actuators_recording import Recording
from parapod.sims.identify_actuators_scenario import NOMINAL


@dataclass(frozen=True)
class Steps:
    """What the steps of a recording show.

    Attributes:
        voltage: (steps) [V].
        speed: (steps, 4) slope of each ramp [m/s].
    """

    voltage: NDArray[np.float64]
    speed: NDArray[np.float64]

    @property
    def gain(self) -> NDArray[np.float64]:
        """(steps, 4) K of each step and leg, the paper's: friction counts as gain [(m/s)/V]."""
        return self.speed / self.voltage[:, None]

    @property
    def deviation_percent(self) -> float:
        """Largest deviation of a step's K from the nominal one, of any leg [%]."""
        return 100.0 * float(np.abs(self.gain / NOMINAL - 1.0).max())

    @property
    def spread_percent(self) -> float:
        """Between the largest and the smallest mean K of a leg, in % of their mean."""
        means = self.gain.mean(axis=0)
        return 100.0 * float(np.ptp(means) / means.mean())


@dataclass(frozen=True)
class Separated:
    """Gain and friction of each leg.

    Attributes:
        gain: (4) K [(m/s)/V].
        extending: (4) voltage that friction and load take when the actuator extends [V].
        retracting: (4) likewise when it retracts, which lifts the platform [V].
    """

    gain: NDArray[np.float64]
    extending: NDArray[np.float64]
    retracting: NDArray[np.float64]


def find_steps(recording: Recording, transient: float) -> Steps:
    """Slope of each voltage step's ramp by least squares, from voltages and encoders alone.

    Args:
        recording: of ten steps or of any number of them.
        transient: beginning of each step that does not count [s].
    """
    time, voltage = recording.time, recording.voltage[:, 0]
    edges = np.flatnonzero(np.diff(voltage)) + 1
    voltages, speeds = [], []
    for begin, end in pairwise([0, *edges.tolist(), time.size]):
        if voltage[begin] == 0.0:
            continue
        ramp = slice(begin + int(np.searchsorted(time[begin:end], time[begin] + transient)), end)
        voltages.append(voltage[begin])
        speeds.append(np.polyfit(time[ramp], recording.extension[ramp], 1)[0])
    return Steps(np.array(voltages), np.array(speeds))


def separate_friction(steps: Steps) -> Separated:
    """Fits speed = K (V - V_c sign V) to each leg, with a V_c of its own for each direction.

    A load takes more from the steps that lift it than a self-locking screw gives back to those
    that lower it. A direction without steps has V_c = 0.
    """
    columns = [steps.voltage, -1.0 * (steps.voltage > 0.0), 1.0 * (steps.voltage < 0.0)]
    gain, extending, retracting = np.linalg.lstsq(np.column_stack(columns), steps.speed)[0]
    return Separated(gain, extending / gain, retracting / gain)
