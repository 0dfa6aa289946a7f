"""Level the platform over LCM: a program of its own, with nothing of parapod's.

parapod serve level --lcm        # in one terminal
python level_lcm.py              # in another
"""

import sys

import lcm
from drake_signal import decode, encode
from leveller import Leveller


def main(address):
    """Answers every instant of the station's with voltages, until Ctrl-C."""
    bus, leveller, newest = lcm.LCM(address), Leveller(), {}

    def take(channel, data):
        newest[channel] = decode(data)

    def answer(channel, data):
        _, stamp = decode(data)
        if len(newest) < 2:
            return  # this program has begun in the middle of an instant
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
