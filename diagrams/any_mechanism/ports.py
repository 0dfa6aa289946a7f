"""Signals of a machine made of a model file: the ports of its station, its controller, its way."""

from parapod.diagrams.any_mechanism.design import BuiltMechanism
from parapod.diagrams.ports import In, Inner, Out, Port, Truth
from parapod.systems.mechanism.coordinates import PARTS

PART = "motors"
# Parts whose devices `status.*` reports.
PARTS_OF_STATION = (PART,)
_POSE = "m, m, m, rad, rad, rad"


def ports_of(built: BuiltMechanism) -> tuple[Port, ...]:
    """The table of a mechanism.

    Args:
        built: its motors and coordinates are taken.
    """
    motors = built.motors
    n, units = len(motors.names), motors.units
    places = ", ".join(units)
    speeds = ", ".join(f"{unit}/s" for unit in units)
    forces = ", ".join("N" if unit == "m" else "N m" for unit in units)
    coordinates = tuple(PARTS[part] for part in built.parts)
    pose = ", ".join("m" if part < 3 else "rad" for part in built.parts)
    rates = ", ".join("m/s" if part < 3 else "rad/s" for part in built.parts)
    return (
        In(
            *(f"{PART}.position_command", n, places),
            "positions that the motors are to have a period later",
            is_sampled=True,
        ),
        In(
            *(f"{PART}.brake", 1, "-", "above 0.5: the motors stop and hold"),
            idle=1.0,
            is_sampled=True,
        ),
        Out(f"{PART}.position", n, places, "encoders: positions of the motors"),
        Out(f"{PART}.velocity", n, speeds, "encoders: their rates"),
        Out(f"{PART}.current", n, "A", "currents of the motors, positive where they push forward"),
        Out(
            *(f"{PART}.emergency_stop", 1, "0/1", "1 while the emergency stop is pressed"),
            default=0.0,
        ),
        Truth("pose", 6, _POSE, "pose of the frame that is led", elements=PARTS),
        Truth("base", 6, _POSE, "pose of the base", elements=PARTS),
        Truth("motor_force", n, forces, "forces of the motors"),
        Truth("loop_error", 2, "m, rad", "largest gap of a loop", elements=("way", "angle")),
        Inner(
            *("pose_desired_state", f"{pose}, {rates}"),
            "coordinates of the frame a period later, and their rates",
            size=2 * len(coordinates),
            elements=coordinates,
        ),
        Inner("motor_desired_state", f"{places}, {speeds}", "motors for them", size=2 * n),
        Inner(
            *("pose_estimated", _POSE, "pose that the motors' encoders measure"),
            size=6,
            elements=PARTS,
        ),
    )
