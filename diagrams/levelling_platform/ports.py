"""The ports of the levelling platform's station, the same for every backend."""

from parapod.diagrams.ports import PortSpec

INPUTS = (
    PortSpec("legs.voltage", 4, "V", "motor voltages, saturated at the supply"),
    PortSpec("legs.stop", 1, "-", "above 0.5: the drives' supply is cut"),
    PortSpec("wheels.velocity_command", 4, "rad/s", "wheel velocities"),
    PortSpec("wheels.brake", 1, "-", "above 0.5: wheels stop and hold"),
    PortSpec("arm.position_command", 1, "rad", "arm angle, 0 upright, positive forward"),
    PortSpec("turntable.position_command", 1, "rad", "angle of the arm's base"),
)

# What an idle machine is told: what is braked stays so, and nothing else is asked of it.
IDLE = {"wheels.brake": 1.0}

# What the elements of `status` are about.
STATUS_PARTS = ("legs", "imu", "wheels", "arm")

OUTPUTS = (
    PortSpec("legs.extension", 4, "m", "encoders: extensions in whole counts"),
    PortSpec("legs.velocity", 4, "m/s", "encoders: their rates in counts per period"),
    PortSpec("legs.limits", 12, "0/1", "switches: extended x4, retracted x4, ground contact x4"),
    PortSpec("imu.gyro", 3, "rad/s", "ADIS16448: angular velocity"),
    PortSpec("imu.accel", 3, "m/s^2", "ADIS16448: specific force"),
    PortSpec("imu.mag", 3, "T", "ADIS16448: magnetic field"),
    PortSpec("wheels.position", 4, "rad", "encoders: wheel angles in whole counts"),
    PortSpec("wheels.velocity", 4, "rad/s", "encoders: their rates in counts per period"),
    PortSpec(
        "status.age", len(STATUS_PARTS), "s", f"age of the data of {', '.join(STATUS_PARTS)}"
    ),
    PortSpec("status.fault", len(STATUS_PARTS), "code", "of each: a `DeviceFault`; 0 none"),
)

# What only a simulation can tell; controllers never read it.
TRUTH_OUTPUTS = (
    PortSpec("truth.posture", 3, "rad, rad, m", "roll, pitch, height above the ground's plane"),
    PortSpec("truth.extension", 4, "m", "positions of the actuators"),
    PortSpec("truth.contact_force", 4, "N", "of the ground on the feet, normal to the ground"),
    PortSpec("truth.foot_height", 4, "m", "of the feet above the ground"),
    PortSpec("truth.load_force", 4, "N", "with which the actuators hold, positive to extend"),
    PortSpec("truth.loop_error", 4, "m", "gap in the legs' closed loops"),
)
