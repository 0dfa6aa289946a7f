"""Typed scenario of the experiment `chair-circle`."""

from dataclasses import dataclass, field

import numpy as np

from parapod.diagrams.walking_chair.leg_loop import LegLoopParams
from parapod.systems.actuators.compound_position_controller import (
    CompoundPositionControllerParams,
)
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.trajectories import FootCircle

BACKENDS = ("kinematic",)


@dataclass
class CircleScenario(Schema):
    """The circle of the foot's corner E1, Eq. (49).

    Attributes:
        radius_mm: radius of the circle [mm].
        centre_y_mm: centre of the circle, ahead of the leg's UP hinge [mm].
        z_mm: plane of the circle, above that hinge [mm].
        lap_duration: duration of one lap at full speed [s].
        laps: number of laps; the second one shows whether errors accumulate.
        ramp: duration of the sines that lead up to full speed and down from it [s]; 0 for the
            paper's steps.
    """

    radius_mm: float = quantity(100.0, 1.0, 300.0)
    centre_y_mm: float = quantity(100.0, -300.0, 300.0)
    z_mm: float = quantity(-675.4, -1000.0, -600.0)
    lap_duration: float = quantity(5.0, 2.0, 120.0)
    laps: int = quantity(3, 1, 100)
    ramp: float = quantity(0.0, 0.0, 60.0)

    @property
    def circle(self) -> FootCircle:
        """Circle in SI units.

        Raises:
            ScenarioError: the ramps leave no time at full speed.
        """
        longest = self.laps * self.lap_duration
        if self.ramp > longest:
            raise ScenarioError(
                f"circle.ramp = {self.ramp:g} s is longer than all laps, {longest:g} s",
                "circle.ramp",
            )
        return FootCircle(
            radius=1e-3 * self.radius_mm,
            centre_y=1e-3 * self.centre_y_mm,
            z=1e-3 * self.z_mm,
            period=self.lap_duration,
            laps=self.laps,
            ramp=self.ramp,
        )


@dataclass
class CircleControlScenario(Schema):
    """The position controllers; all gains are assumptions.

    Attributes:
        period: time between two nodes [s].
        proportional: P of Eq. (47) [1/s].
        k_p: proportional gain of the velocity PI, Eq. (48) [-].
        k_i: integral gain of the velocity PI per sample, Eq. (48) [-].
    """

    period: float = quantity(0.01, 0.001, 0.1)
    proportional: float = quantity(10.0, 0.0, 100.0)
    k_p: float = quantity(0.6, 0.0, 10.0)
    k_i: float = quantity(0.25, 0.0, 10.0)


@dataclass
class CircleDriveScenario(Schema):
    """The three drives; all values but the largest velocity are assumptions.

    Attributes:
        time_constant_ms: time constant of a drive's velocity loop [ms].
        max_velocity_mm_s: largest command that a drive follows, as in the paper [mm/s].
        encoder_resolution_mm: one count of the encoders [mm]; 0 for perfect ones.
        gain: velocity of each drive by its command [-].
        offset_mm_s: velocity of each drive at a command of zero [mm/s].
        gain_error: largest deviation of each gain from `gain`, drawn from the seed [-].
        offset_error_mm_s: largest deviation of each offset from `offset_mm_s`, drawn from the seed
            [mm/s].
    """

    time_constant_ms: float = quantity(40.0, 1.0, 500.0)
    max_velocity_mm_s: float = quantity(80.0, 1.0, 1000.0)
    encoder_resolution_mm: float = quantity(0.005, 0.0, 1.0)
    gain: list[float] = quantity([1.02, 0.985, 1.01], 0.5, 1.5, length=3)
    offset_mm_s: list[float] = quantity([-1.0, -1.0, -1.0], -20.0, 20.0, length=3)
    gain_error: float = quantity(0.0, 0.0, 0.5)
    offset_error_mm_s: float = quantity(0.0, 0.0, 20.0)


@dataclass
class ChairCircleScenario(Schema):
    """One foot on its circle, in every mode of its drives' control.

    Leg 1 leads its foot round the circle in each of the control modes that the paper compares:
    section "Experiment research of PLM 1", Figs. 10, 11 and 14. The paper prints no gains and
    nothing of the drives.

    Attributes:
        backend: plant: "kinematic", the leg in closed form and its drives as lags.
        seed: seed of the drives' errors, where any are drawn.
        circle: see `CircleScenario`.
        rest: time for which the foot is watched after the circle [s].
        control: see `CircleControlScenario`.
        drives: see `CircleDriveScenario`.
    """

    backend: str = choice("kinematic", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    circle: CircleScenario = field(default_factory=CircleScenario)
    rest: float = quantity(0.5, 0.0, 60.0)
    control: CircleControlScenario = field(default_factory=CircleControlScenario)
    drives: CircleDriveScenario = field(default_factory=CircleDriveScenario)

    def loop(self, mode: str) -> LegLoopParams:
        """The leg with its drives controlled in a mode.

        Raises:
            ScenarioError: see `CircleScenario.circle`.
        """
        control, drives = self.control, self.drives
        # One count: a perfect encoder still needs a band in which a drive stands still.
        count = 1e-3 * max(drives.encoder_resolution_mm, 1e-3)
        gain, offset = self._imperfections()
        return LegLoopParams(
            circle=self.circle.circle,
            controller=CompoundPositionControllerParams(
                mode=mode,
                proportional=control.proportional,
                k_p=control.k_p,
                k_i=control.k_i,
                velocity_limit=1e-3 * drives.max_velocity_mm_s,
                dead_band=count,
            ),
            period=control.period,
            drive=VelocityServoParams(
                resolution=1e-3 * drives.encoder_resolution_mm,
                time_constant=1e-3 * drives.time_constant_ms,
                max_velocity=1e-3 * drives.max_velocity_mm_s,
            ),
            gain=gain,
            offset=offset,
        )

    def _imperfections(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Gains [-] and offsets [m/s] of the three drives, the same for every mode."""
        random = np.random.default_rng(self.seed)
        drives = self.drives
        gains = drives.gain + random.uniform(-1.0, 1.0, 3) * drives.gain_error
        offsets = drives.offset_mm_s + random.uniform(-1.0, 1.0, 3) * drives.offset_error_mm_s
        a, b, c = gains.tolist()
        d, e, f = (1e-3 * offsets).tolist()
        return (a, b, c), (d, e, f)
