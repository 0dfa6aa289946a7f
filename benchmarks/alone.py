"""A real-time loop with work alone: whether this computer lets any loop be punctual.

It is the loop that drives machines, with the same privileges, but its ticks only compute: no
device, no thread, no file. What delays it is the computer itself: its kernel, its firmware, other
programs, or the host of a virtual machine, which also may slow its cores down.
"""

import time
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, LeafSystem

from parapod.sims.real_machine.real_time import RealTimeLoop, undisturbed

# Passes of the work by which its speed is known, and rounds of each [-].
_PASSES, _ROUNDS = 200, 2000


def missed_alone(cost: float, period: float, duration: float) -> float:
    """Share of deadlines that a loop with work alone misses [-].

    Args:
        cost: time that its ticks compute [s].
        period: its period [s].
        duration: [s].
    """
    simulator = Simulator(_Work(cost, period))
    simulator.Initialize()
    loop = RealTimeLoop(simulator, period, is_strict=False)
    with undisturbed():
        loop.run(duration)
    return loop.timing.missed / (loop.timing.ticks + loop.timing.missed)


class _Work(LeafSystem):
    """Computes for a time, once a period."""

    def __init__(self, cost: float, period: float):
        super().__init__()
        durations = []
        for _ in range(_PASSES):
            begin = time.thread_time()
            _compute(_ROUNDS)
            durations.append(time.thread_time() - begin)
        self._rounds = round(_ROUNDS * cost / float(np.median(durations)))
        self.DeclarePeriodicPublishEvent(period, 0.0, self._work)

    def _work(self, context: Context) -> Any:
        _compute(self._rounds)


def _compute(rounds: int) -> float:
    total = 0.0
    for i in range(rounds):
        total += 0.5 * i
    return total
