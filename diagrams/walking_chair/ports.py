"""The ports of the walking chair's station, the same for every backend."""

from parapod.diagrams.ports import PortSpec

# Elements of all ports of size 12: branches 11, 12, 13, 21, ... 43.
INPUTS = (
    PortSpec("legs.velocity_command", 12, "m/s", "velocities of the branches' lengths"),
    PortSpec("legs.brake", 1, "-", "above 0.5: the drives stop and hold"),
)

# What an idle machine is told: it holds.
IDLE = {"legs.brake": 1.0}

# What the elements of `status` are about.
STATUS_PARTS = ("legs",)

OUTPUTS = (
    PortSpec("legs.position", 12, "m", "encoders: lengths of the branches, joint to joint"),
    PortSpec("legs.velocity", 12, "m/s", "encoders: their rates"),
    PortSpec("legs.current", 12, "A", "of the motors, positive where they push"),
    PortSpec("status.age", len(STATUS_PARTS), "s", "age of the data of legs"),
    PortSpec("status.fault", len(STATUS_PARTS), "code", "a `DeviceFault`; 0 none"),
)

# What only a simulation can tell; controllers never read it.
TRUTH_OUTPUTS = (
    PortSpec("truth.body_position", 3, "m", "of the body's centre S in the world"),
    PortSpec("truth.body_attitude", 3, "rad", "roll, pitch, yaw of the body"),
    PortSpec("truth.position", 12, "m", "lengths of the branches"),
    PortSpec("truth.force", 12, "N", "with which the actuators hold, positive to extend"),
    PortSpec("truth.contact_force", 4, "N", "of the ground on the feet, upwards"),
    PortSpec("truth.foot_height", 12, "m", "corners of the feet above the ground"),
    PortSpec("truth.loop_error", 8, "m", "gap in the legs' closed loops"),
)
