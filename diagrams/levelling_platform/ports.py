"""Signals of the levelling platform: the ports of its station, its controllers, its commands."""

import math

from parapod.diagrams.ports import In, Inner, Out, Port, Span, Truth
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.levelling_platform.statics import PAPER_ARM
from parapod.systems.levelling_platform.supervisor import Phase
from parapod.systems.levelling_platform.wheels import WheelGeometry
from parapod.systems.sensors.imu import ImuParams

# Parts whose devices `status.*` reports.
PARTS = ("legs", "imu", "wheels", "arm")

_IMU = ImuParams()
_POSTURE = ("roll", "pitch", "height")
_LENGTHS = "m, m, m, m, m/s, m/s, m/s, m/s"
# Distance of false commands of the height from what the legs reach [m].
_BEYOND = 0.01


def make_ports(
    actuator: LinearActuatorParams,
    heights: tuple[float, float],
    arm: SerialArm,
    wheels: WheelGeometry,
) -> tuple[Port, ...]:
    """Signals of a platform.

    Args:
        actuator: its actuators, by which faults are sized.
        heights: its lowest and highest level posture [m].
        arm: its arm; one without joints has no ports.
        wheels: its wheels, which turn as skid steering has them.
    """
    steering = [(forward, yaw) for forward, yaw in wheels.skid_steering().tolist()]
    supply = actuator.supply_voltage
    low, high = round(heights[0] - _BEYOND, 2), round(heights[1] + _BEYOND, 2)
    # NaN is not a command: the reference keeps to the last one.
    postures = Span(
        target="posture_command",
        low=(math.radians(-10.0), math.radians(-10.0), low),
        high=(math.radians(10.0), math.radians(10.0), high),
        off_value=math.nan,
        wrong=(1.0, 0.02),
    )
    return (
        Out(
            "legs.extension",
            4,
            "m",
            "encoders: extensions in whole counts",
            # A wrong counter has lost 5 mm.
            faults=[Span(actuator.stop_min, actuator.stop_max, wrong=(1.0, 5e-3), ages=True)],
        ),
        Out("legs.velocity", 4, "m/s", "encoders: their rates in counts per period"),
        # A wrong sensor turns by 5.7 deg/s and is off by a tenth of gravity: too much for a bias,
        # too little to be absurd.
        Out(
            "imu.gyro",
            3,
            "rad/s",
            "ADIS16448: angular velocity",
            faults=[Span(-_IMU.gyro_range, _IMU.gyro_range, wrong=(1.0, 0.1), ages=True)],
        ),
        Out(
            "imu.accel",
            3,
            "m/s^2",
            "ADIS16448: specific force",
            faults=[Span(-_IMU.accel_range, _IMU.accel_range, wrong=(1.0, 1.0), ages=True)],
        ),
        Out("imu.mag", 3, "T", "ADIS16448: magnetic field"),
        Out(
            "legs.limits",
            12,
            "0/1",
            "switches: extended x4, retracted x4, ground contact x4",
            faults=[Span(0.0, 1.0, is_binary=True)],
        ),
        Out(
            "legs.emergency_stop",
            1,
            "0/1",
            "1 while the emergency stop is pressed",
            default=0.0,
            faults=[Span(0.0, 1.0, is_binary=True)],
        ),
        Out("wheels.position", 4, "rad", "encoders: wheel angles in whole counts"),
        Out(
            *("wheels.velocity", 4, "rad/s", "encoders: their rates in counts per period"),
            twist=steering,
        ),
        In(
            "legs.voltage",
            4,
            "V",
            "motor voltages, saturated at the supply",
            # Swapped wires; a wrong supply, of all four drives at once, has half its voltage.
            faults=[
                Span(-supply, supply, wrong=(-1.0, 0.0)),
                Span(-supply, supply, wrong=(0.5, 0.0), target="supply", only_whole=True),
            ],
        ),
        In("legs.stop", 1, "-", "above 0.5: the drives' supply is cut"),
        In("wheels.velocity_command", 4, "rad/s", "wheel velocities", twist=steering),
        In("wheels.brake", 1, "-", "above 0.5: wheels stop and hold", idle=1.0),
        *(_arm_ports(arm) if arm.count else ()),
        Truth(
            *("posture", 3, "rad, rad, m", "roll, pitch, height above the ground's plane"),
            elements=_POSTURE,
        ),
        Truth("extension", 4, "m", "positions of the actuators"),
        Truth("contact_force", 4, "N", "force of the ground on the feet, normal to the ground"),
        Truth("foot_height", 4, "m", "heights of the feet above the ground"),
        Truth("load_force", 4, "N", "holding forces of the actuators, positive to extend"),
        Truth("loop_error", 4, "m", "gap in the legs' closed loops"),
        # Commands.
        Inner(
            *("posture_command", "rad, rad, m", "commanded posture"),
            size=3,
            faults=[postures],
            elements=_POSTURE,
        ),
        Inner("posture_scale", "-", "share of the waypoints' size that fits the stroke"),
        Inner("estimate_ground", "-", "rises when the ground is to be estimated"),
        Inner("operator", "-", "command to the supervisor"),
        Inner("drive_request", "m/s, rad/s", "forward speed and yaw rate"),
        Inner(
            "posture_request",
            "rad, rad, m",
            "posture that the operator asks for",
            size=3,
            faults=[postures],
            elements=_POSTURE,
        ),
        Inner("jog_request", "m/s", "rates of single legs that the operator asks for"),
        Inner("operator_age", "s", "time since the operator was heard"),
        Inner("steps_done", "-", "number of the operator's steps that have been done"),
        Inner("extension_request", _LENGTHS, "extensions and rates that an experiment asks for"),
        Inner("legs_enable", "-", "above 0.5: the legs are led to what is asked for"),
        Inner("voltage_request", "V", "voltages that an experiment applies"),
        # Controllers.
        Inner(
            "posture_desired_state",
            "rad, rad, m, rad/s, rad/s, m/s",
            "smooth reference and its rates",
            elements=_POSTURE,
        ),
        Inner(
            "extension_desired_state", _LENGTHS, "extensions that the legs are led to, and rates"
        ),
        Inner("legs_arrived", "0/1", "1 while the legs follow their references"),
        Inner("feet_standing", "0/1", "feet that stand, or have lifted a moment ago only"),
        Inner(
            *("ground_estimated", "rad", "roll and pitch of the ground"),
            elements=("roll of the ground", "pitch of the ground"),
        ),
        Inner("ground_valid", "0/1", "1 once the ground is known"),
        Inner("foot_offsets_estimated", "m", "heights under the feet above the ground's plane"),
        Inner("attitude_estimated", "rad", "roll and pitch", elements=("roll", "pitch")),
        # Supervision.
        Inner("phase", "-", "phase of the operation", names=[p.name.lower() for p in Phase]),
        Inner("findings", "0/1", "findings of the fault detector"),
        Inner("severity", "-", "gravest finding"),
        Inner("refusal", "-", "reason for which the last request is refused, and its detail"),
        Inner("stability_margin", "m", "stability margin now"),
    )


def _arm_ports(arm: SerialArm) -> tuple[Port, ...]:
    """Signals of an arm's joints, from the platform to its tip."""
    names = [joint.name for joint in arm.joints]
    unit = ", ".join(joint.unit for joint in arm.joints)
    rates = ", ".join(f"{joint.unit}/s" for joint in arm.joints)
    return (
        In("arm.position_command", arm.count, unit, "positions of its joints", elements=names),
        Out(
            *("arm.position", arm.count, unit, "encoders: positions of the joints' drives"),
            default=0.0,
            elements=names,
        ),
        Out(
            *("arm.velocity", arm.count, rates, "encoders: their rates per period"),
            default=0.0,
            elements=names,
        ),
        Inner(
            *("arm_request", unit, "positions of the arm's joints that the operator asks for"),
            size=arm.count,
            elements=names,
        ),
        Truth("tip_pose", 7, "-, -, -, -, m, m, m", "quaternion and place of its tip"),
        Truth("tip_deflection", 3, "m", "tip from where a rigid arm has it, by the last link"),
        Inner(
            *("tip_command", "m", "point at which the tip is wanted, or point and view"),
            elements=("x", "y", "z"),
        ),
        Inner("tip_goal", "m", "point that is aimed at", elements=("x", "y", "z")),
        Inner("tip_estimated", "m", "tip as the machine measures it", elements=("x", "y", "z")),
        Inner(
            "posture_measured", "rad, rad, m", "posture by attitude and legs", elements=_POSTURE
        ),
        Inner("rod_observed", "-", "modal coordinates of its rod as observed, and their rates"),
        Inner(
            *("tip_deflection_observed", "m", "tip_deflection as observed, by no sensor"),
            elements=("x", "y", "z"),
        ),
        Inner("tip_arrived", "0/1", "1 once the tip is at its point, or comes no nearer"),
        Inner("tip_refused", "0/1", "1 while the tip cannot be where it is wanted"),
        Inner("points_done", "-", "number of points at which the tip has stayed"),
        Inner("payload", "kg", "mass that the tip is said to bear besides"),
        Inner("arm_refused", "0/1", "1 while the requested move of the arm is refused"),
        Inner("arm_margin", "m", "least stability margin along the requested move"),
    )


PORTS = make_ports(LinearActuatorParams(), (0.39, 0.57), PAPER_ARM, WheelGeometry())
