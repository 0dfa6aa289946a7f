"""Signals of the walking chair: the ports of its station, its controller, its gait."""

from parapod.diagrams.ports import In, Inner, Out, Truth

# Parts whose devices `status.*` reports.
PARTS = ("legs",)

# Elements of all ports of size 12: branches 11, 12, 13, 21, ... 43.
PORTS = (
    In("legs.velocity_command", 12, "m/s", "velocities of the branches' lengths", is_sampled=True),
    In("legs.brake", 1, "-", "above 0.5: the drives stop and hold", idle=1.0),
    Out("legs.position", 12, "m", "encoders: lengths of the branches, joint to joint"),
    Out("legs.velocity", 12, "m/s", "encoders: their rates"),
    Out("legs.current", 12, "A", "currents of the motors, positive where they push"),
    Out("legs.emergency_stop", 1, "0/1", "1 while the emergency stop is pressed", default=0.0),
    Truth("body_position", 3, "m", "position of the body's centre S in the world"),
    Truth("body_attitude", 3, "rad", "roll, pitch, yaw of the body"),
    Truth("position", 12, "m", "lengths of the branches"),
    Truth("force", 12, "N", "holding forces of the actuators, positive to extend"),
    Truth("contact_force", 4, "N", "force of the ground on the feet, upwards"),
    Truth("foot_height", 12, "m", "heights of the feet's corners above the ground"),
    Truth("loop_error", 8, "m", "gap in the legs' closed loops"),
    Inner("position_node", "m", "lengths that the branches are to have next"),
    Inner("gait_time", "s", "time of the gait"),
    Inner("support", "0/1", "feet that the gait has on the ground"),
    Inner("done", "0/1", "1 once the gait is over"),
    Inner("payload_estimated", "kg, m, m", "mass and place of the payload"),
    Inner("support_margin", "m", "distance of the centre of mass from the support's edge"),
    Inner("halt", "0/1", "1 while the operator stops the gait"),
    Inner("hold", "0/1", "1 while the gait waits because of the margin"),
)
