"""Typed scenario of the machining centres; `parapod scenario centre-walk` explains it."""

import math
import re
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.disturbances import Disturbance
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machine import ControlScenario
from parapod.diagrams.machining_centre.design import CentreDesign
from parapod.diagrams.machining_centre.drivers import Epos2CentreLegs
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import (
    Job,
    Operation,
    Process,
    check_job,
    row_of_holes,
    standing,
)
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.paths import Speeds
from parapod.systems.machining_centre.posture import Posture
from parapod.systems.machining_centre.swing import LOCKABLE, LockSet
from parapod.systems.machining_centre.walk import plan_walk

BODIES = ("multibody",)  # backends of rigid bodies
SIMULATED = (*BODIES, "kinematic")
BACKENDS = (*SIMULATED, "mock", "hardware")
BEST, PRINTED = "best", "paper"
# Height above the pivots' least one, by the drill, from which a swing begins on a centre of the
# paper's size [m].
_ABOVE = 0.04
_LOCK = re.compile(r"\s*q(\d)\s+of\s+(\d)\s*")


@dataclass
class PanelScenario(Schema):
    """The panel that the centre stands on and machines: part of a cylinder.

    Attributes:
        radius_mm: radius of curvature [mm]; 0 for a plane.
    """

    radius_mm: float = quantity(3000.0, 0.0, 1e6)


@dataclass
class HolesScenario(Schema):
    """A row of holes, drilled wherever the centre stands.

    Attributes:
        count: number of holes; 0: none.
        pitch_mm: distance between two of them [mm].
        row_deg: direction of the row, from the way along the panel's circumference [deg].
        tilt_deg: lean of the holes' axes from the panel's normals, towards the row's end [deg].
        depth_mm: depth of the holes [mm].
    """

    count: int = quantity(3, 0, 50)
    pitch_mm: float = quantity(30.0, 1.0, 200.0)
    row_deg: float = quantity(30.0, -180.0, 180.0)
    tilt_deg: float = quantity(8.0, -30.0, 30.0)
    depth_mm: float = quantity(6.0, 0.5, 50.0)


@dataclass
class WalkScenario(Schema):
    """A walk between two rows of holes.

    Attributes:
        advance_mm: way of each foot in one step of the walk [mm]; 0: the centre stays.
        direction_deg: direction, from the way along the panel's circumference [deg].
        steps: swings of each foot.
        lift_mm: height of a swing [mm].
        height_mm: height of the platform above the panel where a swing begins [mm]; null: the
            mean of the shortest and the longest leg, or as much as keeps the drill off the panel
            by as much as the paper's.
        locks: joints of a tripod's standing limbs that are locked while a foot is loose: "best"
            for the set with the largest singular values, "paper" for "q1 of 1, q1 of 2", or two
            others in that way, limbs counted from the loose one on. A quadruped needs none.
        least_sigma: smallest singular value with which a foot is swung [-]: by so much errors of
            the legs are larger at the foot, which its clamp holds within 1.5 mm.
    """

    advance_mm: float = quantity(0.0, 0.0, 20_000.0)
    direction_deg: float = quantity(0.0, -180.0, 180.0)
    steps: int = quantity(2, 1, 20)
    lift_mm: float = quantity(30.0, 1.0, 1000.0)
    height_mm: float | None = quantity(None, 1.0, 20_000.0)
    locks: str = BEST
    least_sigma: float = quantity(0.05, 0.001, 0.5)

    def chosen(self, limbs: int) -> tuple[tuple[int, int], ...] | None:
        """Locked joints (places after the loose limb, joint) each; None: the best ones.

        Raises:
            ScenarioError: a text that names none.
        """
        if self.locks == BEST or limbs > 3:
            return None
        text = "q1 of 1, q1 of 2" if self.locks == PRINTED else self.locks
        messages = []
        for part in text.split(","):
            match = _LOCK.fullmatch(part)
            joint, after = (int(group) for group in match.groups()) if match else (0, 0)
            if joint not in LOCKABLE or not 1 <= after < limbs:
                raise ScenarioError(
                    f"walk.locks = '{self.locks}' is neither {BEST} nor {PRINTED}, nor joints q1, "
                    f"q2, q3 or q6 of the limbs 1 to {limbs - 1} after the loose one, as in "
                    "'q3 of 1, q6 of 2'",
                    "walk.locks",
                )
            messages.append((after, joint))
        try:
            LockSet(1, tuple((1 + after, joint) for after, joint in messages)).check(
                CentreGeometry(limbs)
            )
        except ValueError as error:
            raise ScenarioError(f"walk.locks = '{self.locks}': {error}", "walk.locks") from None
        return tuple(messages)


@dataclass
class MotionScenario(Schema):
    """Limits of speed.

    Attributes:
        rapid_mm_s: largest speed of the platform between operations [mm/s].
        turn_deg_s: largest speed of its rotation [deg/s].
        feed_mm_s: largest speed of the drill in the material [mm/s].
        swing_mm_s: largest speed of a foot [mm/s].
        acceleration_mm_s2: largest acceleration of platform and feet [mm/s^2].
    """

    rapid_mm_s: float = quantity(60.0, 1.0, 500.0)
    turn_deg_s: float = quantity(15.0, 0.5, 90.0)
    feed_mm_s: float = quantity(4.0, 0.1, 50.0)
    swing_mm_s: float = quantity(80.0, 1.0, 500.0)
    acceleration_mm_s2: float = quantity(300.0, 1.0, 5000.0)

    @property
    def speeds(self) -> Speeds:
        """The limits in SI units."""
        return Speeds(
            rapid=1e-3 * self.rapid_mm_s,
            turn=math.radians(self.turn_deg_s),
            feed=1e-3 * self.feed_mm_s,
            swing=1e-3 * self.swing_mm_s,
            acceleration=1e-3 * self.acceleration_mm_s2,
        )


@dataclass
class ProcessScenario(Schema):
    """The drill, and what drilling needs.

    Attributes:
        thrust_N: force of the material on the drill at the feed that is meant [N].
        torque_Nm: torque of the material on it [N m].
        clearance_mm: height of the tip above the panel between holes [mm].
    """

    thrust_N: float = quantity(150.0, 0.0, 10_000.0)  # noqa: N815 (the unit's symbol)
    torque_Nm: float = quantity(0.6, 0.0, 1000.0)  # noqa: N815
    clearance_mm: float = quantity(8.0, 2.0, 100.0)


@dataclass
class CentrePlantScenario(Schema):
    """The simulated machine.

    Attributes:
        time_step: step of the rigid bodies and of the drives [s]; what holds a clamped foot yields
            with its square: at 2 ms a foot that swings is led past what its clamp reaches.
        accuracy: largest error of a position in a step, with which Drake's CENIC integrates the
            rigid bodies [m, rad]; null: they take steps of `time_step`. With a number that is the
            step of the drives, and the longest one of the bodies. Of the multibody backend alone.
        switching_ms: time that locks and clamps take [ms].
    """

    time_step: float = quantity(1e-3, 1e-4, 1e-3)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)
    switching_ms: float = quantity(60.0, 0.0, 1000.0)


@dataclass
class CentreControlScenario(ControlScenario):
    """The controller.

    Attributes:
        period: period of sequencer and feedforward [s].
        knows_stiffness: true if the posture is calculated with legs that yield to their forces, as
            the motors' currents show them.
        settling: for which legs rest before anything is switched, and switches before anything
            moves [s].
    """

    period: float = quantity(0.01, 0.001, 0.05)
    knows_stiffness: bool = True
    settling: float = quantity(0.15, 0.0, 5.0)


def emulated_hardware() -> HardwareScenario:
    """The devices of `parapod emulate centre-walk`."""
    return HardwareScenario([Epos2CentreLegs()])


@dataclass
class CentreScenario(Schema):
    """A job of a machining centre: a row of holes, and, after a walk, the same row once more.

    Limbs are counted from 1, against the clock seen from above; legs are left and right of limb
    1, of limb 2, ... The world's origin is on the panel, in the middle of the feet at the
    beginning, its third axis out of it.

    Attributes:
        backend: plant behind the station's ports: "multibody" (rigid bodies, joints with locks,
            clamps), "kinematic" (no dynamics), "mock" (commands are mirrored) or "hardware".
        seed: seed of everything random: the errors of the legs' lengths.
        begin: time at which the first operation begins [s].
        end: time for which it stands afterwards [s].
        stop_at: time at which the job is stopped [s]; null: never.
        machine: see `CentreDesign`.
        panel: see `PanelScenario`.
        holes: see `HolesScenario`.
        walk: see `WalkScenario`.
        motion: see `MotionScenario`.
        process: see `ProcessScenario`.
        plant: see `CentrePlantScenario`.
        control: see `CentreControlScenario`.
        disturbances: forces on bodies, of simulated ones: `Push`, `Weight`, `Cable`, `Wind`; and
            ground that gives, `Subsidence`.
        hardware: see `HardwareScenario`; the defaults are the emulated devices of a tripod.
    """

    moved: ClassVar = {"limbs": "machine.limbs", "legs": "machine.legs"}

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    begin: float = quantity(0.5, 0.0, 60.0)
    end: float = quantity(0.5, 0.0, 60.0)
    stop_at: float | None = quantity(None, 0.0, 10_000.0)
    machine: CentreDesign = field(default_factory=CentreDesign)
    panel: PanelScenario = field(default_factory=PanelScenario)
    holes: HolesScenario = field(default_factory=HolesScenario)
    walk: WalkScenario = field(default_factory=WalkScenario)
    motion: MotionScenario = field(default_factory=MotionScenario)
    process: ProcessScenario = field(default_factory=ProcessScenario)
    plant: CentrePlantScenario = field(default_factory=CentrePlantScenario)
    control: CentreControlScenario = field(default_factory=CentreControlScenario)
    disturbances: list[Disturbance] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def length_errors(self) -> NDArray[np.float64]:
        """True lengths of the legs (2n) less the encoders', drawn from the seed [m]."""
        largest = 1e-3 * self.machine.legs.length_error_mm
        random = np.random.default_rng(self.seed)
        return random.uniform(-largest, largest, self.machine.geometry.legs)

    @property
    def plan(self) -> "Plan":
        """The job that is to be done, and where it begins and ends.

        Raises:
            ScenarioError: unknown locks.
            Refused: an operation that the centre cannot do.
        """
        radius, design, geometry = 1e-3 * self.panel.radius_mm, self.machine, self.machine.geometry
        walk, holes, process = self.walk, self.holes, self.process
        blank = Job(
            panel=Panel(radius if radius > 0.0 else math.inf, geometry.foot_height),
            process=Process(
                tool_length=geometry.tool_length,
                thrust=process.thrust_N,
                torque=process.torque_Nm,
                clearance=1e-3 * process.clearance_mm,
                largest_leg_force=design.legs.max_force_N,
                masses=design.masses,
            ),
            speeds=replace(self.motion.speeds, leg=1e-3 * design.legs.max_velocity_mm_s),
            lift=1e-3 * walk.lift_mm,
            drift=Job.drift * geometry.size,
            least_sigma=walk.least_sigma,
        )
        advance, heading = 1e-3 * walk.advance_mm, math.radians(walk.direction_deg)
        way = (advance * math.cos(heading), advance * math.sin(heading))
        row = (
            math.radians(holes.row_deg),
            holes.count,
            1e-3 * holes.pitch_mm,
            math.radians(holes.tilt_deg),
            1e-3 * holes.depth_mm,
        )
        middle = 0.5 * (geometry.stroke_min + geometry.stroke_max)
        usual = max(middle, geometry.tool_length + _ABOVE * geometry.size)
        height = usual if walk.height_mm is None else 1e-3 * walk.height_mm
        return _planned(
            geometry,
            _Keyed(blank),
            way,
            walk.steps,
            height,
            walk.chosen(geometry.limbs),
            row,
        )


@dataclass(frozen=True, eq=False)
class Plan:
    """A job, and where it begins and ends.

    Attributes:
        job: the job.
        beginning: platform and feet at its beginning.
        end: and at its end, as planned.
        shift: ways along and across (2) by which the feet have gone on then [m].
    """

    job: Job
    beginning: Posture
    end: Posture
    shift: tuple[float, float]


class _Keyed:
    """A job without operations, as a key by its values."""

    def __init__(self, job: Job):
        self.job = job
        self._key = (job.panel, job.process, job.speeds, job.lift, job.drift, job.least_sigma)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Keyed) and self._key == other._key


@lru_cache(maxsize=16)
def _planned(
    geometry: CentreGeometry,
    blank: _Keyed,
    way: tuple[float, float],
    steps: int,
    height: float,
    locked: tuple[tuple[int, int], ...] | None,
    row: tuple[float, int, float, float, float],
) -> Plan:
    job = blank.job
    beginning = standing(geometry, job.panel, height)
    operations: list[Operation] = [*row_of_holes(job.panel, (0.0, 0.0), *row)]
    if any(way):
        before = check_job(geometry, replace(job, operations=tuple(operations)), beginning)
        operations += plan_walk(geometry, job, before, way, steps, height, locked)
        operations += row_of_holes(job.panel, way, *row)
    job = replace(job, operations=tuple(operations))
    return Plan(job, beginning, check_job(geometry, job, beginning), way)
