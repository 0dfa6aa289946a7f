"""The controller of both examples: two integrators lean a platform until it is level.

The accelerometer tells how the platform is inclined, and each leg's voltage follows the error of
its extension.
"""

import math

# Lengths of the platform [m]: between its left and right feet, between its rear and front ones;
# height of a foot below it by the extension of its leg [-].
WIDTH, LENGTH, RATIO = 1.125, 1.482, -5.89
# Of legs 1 to 4, from the rear left against the clock: 1 is left, 1 is in front.
LEFT, FRONT = (1, -1, -1, 1), (-1, -1, 1, 1)
PERIOD = 0.01  # [s]
SMOOTHING, LEANING, GAIN = 0.3, 0.8, 2000.0  # [s], [1/s], [V/m]
SUPPLY = 12.0  # [V]
# A guard takes the platform's turning faster than .06 rad/s for a fault.
FASTEST = 0.04  # [rad/s]


class Leveller:
    """Voltages of the legs from their extensions and the platform's acceleration."""

    def __init__(self):
        self.begins = self.inclination = None
        self.lean = [0.0, 0.0]

    def voltages(self, extensions, acceleration):
        """Voltages (4) [V] for extensions (4) [m] and the specific force (3) [m/s^2]."""
        x, y, z = acceleration
        inclination = math.atan2(y, z), math.atan2(-x, math.hypot(y, z))
        if self.begins is None:
            self.begins, self.inclination = extensions, list(inclination)
        share = PERIOD / SMOOTHING
        for i in range(2):
            self.inclination[i] += share * (inclination[i] - self.inclination[i])
            rate = LEANING * self.inclination[i]
            self.lean[i] -= PERIOD * max(-FASTEST, min(FASTEST, rate))
        roll, pitch = self.lean
        voltages = []
        for i in range(4):
            height = 0.5 * (roll * WIDTH * LEFT[i] - pitch * LENGTH * FRONT[i])
            error = self.begins[i] + height / RATIO - extensions[i]
            voltages.append(max(-SUPPLY, min(SUPPLY, GAIN * error)))
        return voltages
