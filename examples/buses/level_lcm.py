"""Level the platform over LCM: a program of its own, with nothing of parapod's.

    parapod serve level --lcm        # in one terminal
    python level_lcm.py              # in another

The accelerometer tells how the platform is inclined, and two integrators lean it the other way;
each leg's voltage follows the error of its extension.
"""

import math
import sys

import lcm
from drake_signal import decode, encode

# Lengths of the platform [m]: between its left and right feet, between its rear and front ones;
# height of a foot below it by the extension of its leg [-].
WIDTH, LENGTH, RATIO = 1.125, 1.482, -5.89
# Of legs 1 to 4, from the rear left against the clock: 1 is left, 1 is in front.
LEFT, FRONT = (1, -1, -1, 1), (-1, -1, 1, 1)
PERIOD = 0.01  # [s]
SMOOTHING, LEANING, GAIN = 0.3, 0.8, 2000.0  # [s], [1/s], [V/m]
SUPPLY = 12.0  # [V]


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
            self.lean[i] -= PERIOD * LEANING * self.inclination[i]
        roll, pitch = self.lean
        voltages = []
        for i in range(4):
            height = 0.5 * (roll * WIDTH * LEFT[i] - pitch * LENGTH * FRONT[i])
            error = self.begins[i] + height / RATIO - extensions[i]
            voltages.append(max(-SUPPLY, min(SUPPLY, GAIN * error)))
        return voltages


def main(address):
    """Answers every instant of the station's with voltages, until Ctrl-C."""
    bus, leveller, newest = lcm.LCM(address), Leveller(), {}

    def take(channel, data):
        newest[channel] = decode(data)

    def answer(channel, data):
        _, stamp = decode(data)
        legs, imu = newest["LEGS_STATUS"][0], newest["IMU_STATUS"][0]
        extensions = [legs[f"extension[{i}]"] for i in range(4)]
        voltages = leveller.voltages(extensions, [imu[f"accel[{i}]"] for i in range(3)])
        names = [*(f"voltage[{i}]" for i in range(4)), "stop", "active"]
        bus.publish("LEGS_COMMAND", encode(names, [*voltages, 0.0, 1.0], stamp))

    bus.subscribe("LEGS_STATUS", take)
    bus.subscribe("IMU_STATUS", take)
    bus.subscribe("STATION_STATUS", answer)  # the last one of an instant
    while True:
        bus.handle()


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "udpm://239.255.76.67:7667?ttl=0")
