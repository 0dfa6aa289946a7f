"""How the walking chair stands throughout a step, and the forces that carry it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parapod.sims.chair_payload_scenario import ChairPayloadScenario
from parapod.sims.experiment import RunOptions, progress
from parapod.sims.experiment_log import write_experiment_log
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.checks import check_gait
from parapod.systems.walking_chair.gait import FIRST_SWING, SECOND_SWING, Walk
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import GRAVITY, ChairMasses
from parapod.systems.walking_chair.payload import (
    FORCE_LIMIT,
    Payload,
    Stand,
    elastic_forces,
    largest_payload,
    least_branch_force,
)
from parapod.systems.walking_chair.statics import force_map
from parapod.systems.walking_chair.support import GaitSupport

type Floats = NDArray[np.float64]

GEOMETRY = ChairGeometry()
MASSES = ChairMasses()
# The paper's largest payload [kg].
PAPER_PAYLOAD = 57.0
# Corners this close to the ground touch it [m].
_TOUCHING = 1e-6
_LEVEL = np.eye(3)


class Instant(NamedTuple):
    """An instant of a step.

    Attributes:
        time: [s].
        phase: its name.
        stand: how the chair stands, with the payload where it is.
        frictionless: the largest payload without friction.
        friction: the largest payload with it.
        least_frictionless: the payload with as small a largest force as there can be.
        least_friction: likewise with friction.
        equal: the payload, with friction, on branches that are all as stiff.
        soft: likewise with UPS branches as soft as explains the paper's payload.
    """

    time: float
    phase: str
    stand: Stand
    frictionless: Payload
    friction: Payload
    least_frictionless: Payload
    least_friction: Payload
    equal: Payload
    soft: Payload

    @property
    def swings(self) -> bool:
        """Whether only two feet stand."""
        return self.phase in (FIRST_SWING, SECOND_SWING)


def check_stance(scenario: ChairPayloadScenario) -> None:
    """Refuses a gait that the actuators cannot do, and a payload that would tip the chair over.

    Raises:
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
        SupportLost: names the phase with the smallest margin.
    """
    for gait in scenario.walk.gaits:
        check_gait(GEOMETRY, gait)
    required = 1e-3 * scenario.support_margin_mm
    GaitSupport(GEOMETRY, scenario.walk, MASSES).check(scenario.payload.passenger, required)


def survey(scenario: ChairPayloadScenario, options: RunOptions) -> list[Instant]:
    """Spreads forces throughout the step, at the middles of equal parts of each phase."""
    walk = scenario.walk
    softness = paper_stiffness(walk)
    begins = (0.0, *walk.ends[:-1])
    shares = (np.arange(scenario.instants) + 0.5) / scenario.instants
    found = []
    with progress(options.console, "spreading forces", walk.duration) as report:
        for phase, begin, end in zip(walk.phases, begins, walk.ends, strict=True):
            for time in (begin + shares * (end - begin)).tolist():
                found.append(_spread(scenario, walk, phase, time, softness))
                report(time)
    return found


def _spread(
    scenario: ChairPayloadScenario, walk: Walk, phase: str, time: float, softness: float
) -> Instant:
    mass, friction, limit = scenario.payload.mass_kg, scenario.friction, scenario.force_limit
    stand = stand_at(walk, time)._replace(payload_place=scenario.payload.passenger.place[:2])
    return Instant(
        time,
        phase,
        stand,
        frictionless=largest_payload(stand, 0.0, limit),
        friction=largest_payload(stand, friction, limit),
        least_frictionless=least_branch_force(stand, mass, 0.0),
        least_friction=least_branch_force(stand, mass, friction),
        equal=elastic_forces(stand, mass, friction),
        soft=elastic_forces(stand, mass, friction, softness),
    )


def stand_at(walk: Walk, time: float) -> Stand:
    """How the chair stands at an instant, with a payload in the middle."""
    motion = walk.motion(GEOMETRY, time)
    body = np.asarray(motion.body.position)
    feet = motion.feet.position
    lengths = chair_inverse(GEOMETRY, body, _LEVEL, feet, motion.references)
    corners = foot_corners(GEOMETRY, body, _LEVEL, lengths)
    touching = (corners[..., 2] < _TOUCHING) & motion.support[:, np.newaxis]
    from_body = (corners - body).reshape(-1, 3)
    return Stand(force_map(GEOMETRY, lengths), from_body, touching.ravel(), MASSES.total)


def paper_share() -> float:
    """Share of a leg's load on its UP branch with which the paper's payload takes it to F_N.

    While two legs stand, each carries half of the weight.
    """
    return 2.0 * FORCE_LIMIT / (GRAVITY * (MASSES.total + PAPER_PAYLOAD))


def paper_stiffness(walk: Walk) -> float:
    """Stiffness of a UPS branch, by that of a UP branch, which gives that share.

    The UP branch of a flat foot below its hinge is upright, and a UPS branch has the vertical
    part n_z. A vertical load is shared between them as 1, k n_z^2 and k n_z^2.
    """
    phase = walk.phases.index(FIRST_SWING)
    leg = walk.standing[phase].index(True)
    motion = walk.motion(GEOMETRY, walk.ends[phase], "left")
    lengths = chair_inverse(
        GEOMETRY, motion.body.position, _LEVEL, motion.feet.position, motion.references
    )
    up, ups, _ = lengths[leg].tolist()
    n_z = (up + GEOMETRY.leg.x2 - GEOMETRY.leg.x3) / ups
    return (1.0 / paper_share() - 1.0) / (2.0 * n_z**2)


def write_survey(
    scenario: ChairPayloadScenario, options: RunOptions, instants: list[Instant]
) -> None:
    """Writes the log, if one is asked for.

    Raises:
        OutputError: the file cannot be written.
    """
    if options.log is None:
        return
    signals: dict[str, tuple[Floats, str]] = {}
    for name in ("frictionless", "friction"):
        masses = np.array([getattr(instant, name).mass for instant in instants])
        signals[f"largest_payload_{name}"] = (masses, "kg")
    for name in ("least_frictionless", "least_friction", "equal", "soft"):
        forces = np.array([getattr(instant, name).branch_forces for instant in instants])
        signals[f"branch_force_{name}"] = (forces, "N")
    touching = np.array([instant.stand.touching for instant in instants])
    signals["touching"] = (touching, "0/1")
    time = np.array([instant.time for instant in instants])
    write_experiment_log(options.log, "chair-payload", scenario, time, signals)
