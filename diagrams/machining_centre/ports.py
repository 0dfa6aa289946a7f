"""Signals of the machining centres: the ports of their station, their controller, their job."""

from parapod.diagrams.ports import In, Inner, Out, Port, Truth
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB
from parapod.systems.machining_centre.sequence import Phase

# Parts whose devices `status.*` reports.
PARTS = ("legs",)


_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_UNITS = "m, m, m, rad, rad, rad"


def ports_of_limbs(limbs: int) -> tuple[Port, ...]:
    """The table of a centre.

    Elements of ports of the legs: left and right of limb 1, of limb 2, ...; of the locks: q_1,
    q_2, q_3, q_6 of limb 1, of limb 2, ...

    Args:
        limbs: number of limbs.
    """
    legs, locks, feet = 2 * limbs, LOCKS_OF_LIMB * limbs, 6 * limbs
    return (
        In(
            *("legs.position_command", legs, "m"),
            "lengths that the legs are to have a period later",
            is_sampled=True,
        ),
        In(
            *("legs.brake", 1, "-", "above 0.5: the legs stop and hold"),
            idle=1.0,
            is_sampled=True,
        ),
        In("locks.command", locks, "0/1", "1: the lock is to be closed", is_sampled=True),
        In(
            "clamps.command",
            limbs,
            "0/1",
            "1: the foot is to be clamped",
            idle=1.0,
            is_sampled=True,
        ),
        Out("legs.position", legs, "m", "encoders: lengths from foot to pivot"),
        Out("legs.velocity", legs, "m/s", "encoders: their rates"),
        Out("legs.current", legs, "A", "currents of the motors, positive where they push"),
        Out("legs.emergency_stop", 1, "0/1", "1 while the emergency stop is pressed", default=0.0),
        Out("locks.closed", locks, "0/1", "switches of the locks"),
        Out("clamps.closed", limbs, "0/1", "switches of the clamps"),
        Out("tool.force", 2, "N, N m", "thrust and torque of the drill", default=0.0),
        Truth("pose", 6, _UNITS, "x, y, z, roll, pitch, yaw of the platform", elements=_POSE),
        Truth("feet", feet, _UNITS, "the same of each foot"),
        Truth("joints", locks, "rad", "joints that carry locks"),
        Truth("leg_force", legs, "N", "forces of the legs, positive where they push"),
        Truth("clamp_gap", limbs, "m", "distances of the feet from their clamps"),
        Truth("loop_error", limbs, "m", "gaps in the limbs' closed loops"),
        Truth("tip_height", 1, "m", "height of the drill's tip above the panel"),
        Inner(
            "pose_desired",
            "m, m, m, rad, rad, rad",
            "pose that the platform is to have",
            elements=_POSE,
        ),
        Inner(
            "foot_desired",
            "m, m, m, rad, rad, rad",
            "pose that the loose foot is to have",
            elements=_POSE,
        ),
        Inner(
            "pose_estimated",
            "m, m, m, rad, rad, rad",
            "pose that the lengths give",
            elements=_POSE,
        ),
        Inner("feet_estimated", _UNITS, "feet that the lengths give"),
        Inner("length_error", "m", "lengths of the legs less those that they were led to"),
        Inner("phase", "-", "phase of the job", names=[p.name.lower() for p in Phase]),
        Inner("operation", "-", "operations that are done"),
        Inner("fault", "-", "fault that has ended the job, see `Fault`, and where"),
        Inner("loose_limb", "-", "limb whose foot is loose; 0: none"),
        Inner("done", "0/1", "1 once the job has ended"),
        Inner("wrench_index", "-", "w_minmax of the posture"),
        Inner("wrench_margin", "N", "force resisted in every direction, less what is needed"),
        Inner("pose_asked", _UNITS, "pose that a person asks for", elements=_POSE),
        Inner("limb_asked", "-", "limb whose foot a person has lifted; 0: none"),
        Inner("stop", "0/1", "1 to end the job"),
    )
