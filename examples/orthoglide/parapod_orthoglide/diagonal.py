"""Lead the tool of an Orthoglide along the diagonal of its cube, where its ratios are extreme."""

import numpy as np
from parapod import LoopExperiment, Metric

from parapod_orthoglide.machine import ORTHOGLIDE


class Diagonal(LoopExperiment):
    """Runs there and back."""

    machine = ORTHOGLIDE
    signals = ("place_desired", "truth.place", "drives.position")
    takes = "1 s"

    def duration(self, scenario):
        """Both ways [s]."""
        return 2.0 * scenario.duration

    def measure(self, scenario, run):
        """Errors of the tool, and velocity by that of the drives at the ends."""
        error = run["truth.place"] - run["place_desired"]
        yield Metric("place_error_mm", 1e3 * np.abs(error).max(), "mm", 20.0)
        tool, drives = (np.linalg.norm(np.diff(run[n], axis=0), axis=1) for n in self.signals[1:])
        moving = drives > 0.05 * drives.max()
        ratio = tool[moving] / drives[moving]
        yield Metric("diagonal_most_ratio", ratio.max(), "-", meaning="largest ratio met")
        yield Metric("diagonal_least_ratio", ratio.min(), "-", meaning="least ratio met")
