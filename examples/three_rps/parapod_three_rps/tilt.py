"""Tilt the 3-RPS platform in a circle and see how well its legs follow."""

import numpy as np
from parapod import Figure, LoopExperiment, Metric, ScenarioError

from parapod_three_rps.kinematics import inverse
from parapod_three_rps.machine import GEOMETRY, HOME, STROKE, THREE_RPS


class Tilt(LoopExperiment):
    """Runs four periods of the motion."""

    machine = THREE_RPS
    signals = ("pose_desired_state", "truth.pose")
    takes = "2 s"

    def check(self, scenario):
        """Refuses a tilt for which the legs are too short."""
        angles, size = np.linspace(0.0, 2.0 * np.pi, 73), np.radians(scenario.motion.tilt_deg)
        poses = np.column_stack([size * np.cos(angles), size * np.sin(angles), 0.0 * angles])
        excess = np.abs(inverse(GEOMETRY, poses + HOME) - inverse(GEOMETRY, HOME)).max() - STROKE
        if excess > 0.0:
            text = f"motion.tilt_deg = {scenario.motion.tilt_deg:g} exceeds the legs' stroke"
            raise ScenarioError(f"{text} by {1e3 * excess:.1f} mm", "motion.tilt_deg")

    def duration(self, scenario):
        """Four periods [s]."""
        return 4.0 * scenario.motion.period

    def measure(self, scenario, run):
        """Errors once the tilt is reached."""
        turning = run.after(2.0 * scenario.motion.period)
        error = turning["truth.pose"] - turning["pose_desired_state"][:, :3]
        tilt = np.degrees(np.hypot(*error[:, :2].T).max())
        yield Metric("tilt_error_deg", tilt, "deg", 0.1, meaning="largest tilt error")
        height = 1e3 * np.abs(error[:, 2]).max()
        yield Metric("height_error_mm", height, "mm", 1.0, meaning="largest height error")

    def draw(self, scenario, run):
        """The normal's path."""

        def path(canvas):
            axes = canvas.subplots()
            for name in ("pose_desired_state", "truth.pose"):
                axes.plot(*np.degrees(run[name][:, :2].T), label=name)
            axes.set(xlabel="about x [deg]", ylabel="about y [deg]", aspect="equal")
            axes.legend()

        yield Figure("tilt", "The tilt", "Desired and true rotation vector.", path, (4.5, 4.2))
