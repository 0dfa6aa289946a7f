"""Data sheet of an Orthoglide: how much faster than its tool its drives are, and their way."""

from functools import cached_property

import numpy as np
from parapod.sims.sheet.sheet import Demonstration, Sheet, entry

from parapod_orthoglide.kinematics import inverse, inverse_jacobian
from parapod_orthoglide.machine import Scenario

_PLACES = 9  # places along each edge of the cube


class OrthoglideSheet(Sheet[Scenario, None, None]):
    """Sheet of an Orthoglide over the cube in which it works."""

    highlights = ("leg_mm", "least_ratio", "most_ratio")

    @cached_property
    def _places(self):
        """Places (n, 3) in the cube, its corners among them [m]."""
        along = np.linspace(*self.scenario.machine.corners, _PLACES)
        return np.stack(np.meshgrid(along, along, along), axis=-1).reshape(-1, 3)

    @cached_property
    def _ratios(self):
        """Velocity of the tool by that of the drives (n, 3), in the principal directions."""
        jacobians = inverse_jacobian(self.scenario.machine.leg, self._places)
        return 1.0 / np.linalg.svd(jacobians, compute_uv=False)

    @entry("dimensions", "mm")
    def leg_mm(self):
        """Length of the legs."""
        return self.scenario.machine.leg_mm

    @entry("dimensions", "mm")
    def travel_mm(self):
        """Way of each drive within the cube."""
        (low, high), leg = self.scenario.machine.corners, self.scenario.machine.leg
        # Farthest where the tool is nearest to the drive's axis.
        near, far = np.clip(0.0, low, high), max(abs(low), abs(high))
        ends = np.array([[low, far, far], [high, near, near]])
        return 1e3 * np.ptp(inverse(leg, ends)[:, 0])

    @entry("velocity")
    def least_ratio(self):
        """Least velocity of the tool by that of the drives, over the cube."""
        return self._ratios.min()

    @entry("velocity")
    def most_ratio(self):
        """Largest velocity of the tool by that of the drives, over the cube."""
        return self._ratios.max()

    def demonstrations(self):
        """The way along the diagonal, at whose ends the ratios are."""
        yield Demonstration("most_ratio", {}, "along the diagonal of the cube")
