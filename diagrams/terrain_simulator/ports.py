"""Signals of the terrain simulator: the ports of its station, its controller, its terrain."""

from parapod.diagrams.ports import In, Inner, Out, Port, Truth

# Parts whose devices `status.*` reports.
PARTS = ("sliders", "hip", "belt", "cells", "leg")


_POSE, _LOAD = ("x", "z", "phi"), ("F_x", "F_z", "M_y")


def ports_of_joints(joints: int) -> tuple[Port, ...]:
    """The table of a bench with a leg.

    Args:
        joints: number of actuated joints of the leg.
    """
    pose = "m, m, rad"
    motion = f"{pose}, m/s, m/s, rad/s, m/s^2, m/s^2, rad/s^2"
    return (
        In(
            *("sliders.position_command", 3, "m"),
            "places along the rail that the sliders are to have a period later",
            is_sampled=True,
        ),
        In(
            *("sliders.brake", 1, "-", "above 0.5: the sliders stop and hold"),
            idle=1.0,
            is_sampled=True,
        ),
        In(
            *("hip.force_command", 1, "N", "force of the drive on the hip's slide, upwards"),
            is_sampled=True,
        ),
        In(
            *("hip.brake", 1, "-", "above 0.5: the slide is held"),
            idle=1.0,
            is_sampled=True,
        ),
        In("belt.velocity_command", 1, "m/s", "speed of a treadmill's belt, positive to the rear"),
        In(
            *("belt.brake", 1, "-", "above 0.5: the belt stops and holds"),
            idle=1.0,
            is_sampled=True,
        ),
        In(
            *(
                "leg.torque_command",
                joints,
                "N m",
                "torques of the leg's joints; N where they slide",
            ),
            is_sampled=True,
        ),
        Out("sliders.position", 3, "m", "encoders: places along the rail"),
        Out("sliders.velocity", 3, "m/s", "encoders: their rates"),
        Out("sliders.current", 3, "A", "currents of the motors, positive where they push forward"),
        Out(
            "sliders.emergency_stop",
            1,
            "0/1",
            "1 while the emergency stop is pressed",
            default=0.0,
        ),
        Out("hip.position", 1, "m", "encoder: height of the hip above the rail"),
        Out("hip.velocity", 1, "m/s", "encoder: its rate"),
        Out("belt.position", 1, "m", "encoder of the belt: its way, positive to the rear"),
        Out("belt.velocity", 1, "m/s", "encoder: its rate"),
        Out("cells.force", 3, "N", "force cells under the plate: rear, front, along"),
        Out("leg.position", joints, "rad", "encoders of the leg's joints; m where they slide"),
        Out("leg.velocity", joints, "rad/s", "their rates"),
        Truth(
            *("pose", 3, pose, "x, z, phi of the plate's middle; phi > 0 is front end down"),
            elements=_POSE,
        ),
        Truth("foot_force", 2, "N", "force of the ground on the foot, along x and upwards"),
        Truth("slider_force", 3, "N", "forces of the sliders' drives, forward"),
        Truth("loop_error", 2, "m", "gaps in the bench's closed loops"),
        Inner("pose_asked", pose, "pose that a terrain asks for a period later", elements=_POSE),
        Inner("pose_desired", pose, "pose of the plate a period later", elements=_POSE),
        Inner("plate_motion", motion, "pose asked for now, its rates, and theirs", size=9),
        Inner("share", "-", "share of the commanded speed; 1: not slowed down"),
        Inner(
            "foot_desired",
            "m, m, m/s, m/s, m/s^2, m/s^2",
            "x, z of the foot from the hip, and their derivatives",
        ),
        Inner("foot_force_desired", "N", "force that the foot is to bear"),
        Inner("hip_force", "N", "force that the other legs are to carry, on the hip, upwards"),
        Inner("hip_desired", "m, m/s", "height of the hip, and its rate"),
        Inner(
            *("foot_load", "N, N, N m", "F_x, F_z, M_y on the plate by the force cells"),
            elements=_LOAD,
        ),
        Inner(
            *("load_estimated", "N, N, N m", "the same by the currents of the sliders"),
            elements=_LOAD,
        ),
        Inner("pose_estimated", pose, "pose that the sliders' encoders measure", elements=_POSE),
        Inner("stance", "0/1", "1 while the foot must stand"),
        Inner("distance", "m", "way of the body over the terrain"),
        Inner("rise", "m", "height of the body above that of the distance zero"),
        Inner("done", "0/1", "1 once the leg stands at the end"),
    )
