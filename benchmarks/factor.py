"""Speed of a simulated closed loop."""

import time
from typing import Any

from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop


def real_time_factor(loop: ClosedLoop[Any], duration: float, runs: int) -> float:
    """Best of some runs of the whole loop from its beginning.

    Args:
        loop: which records nothing.
        duration: simulated time [s].
        runs: how many; what a neighbour on the machine costs is in the slower ones.
    """
    factors = []
    for _ in range(runs):
        simulator = Simulator(loop)
        if loop.monitor is not None:
            simulator.set_monitor(loop.monitor)
        simulator.Initialize()
        started = time.perf_counter()
        simulator.AdvanceTo(duration)
        factors.append(duration / (time.perf_counter() - started))
    return max(factors)
