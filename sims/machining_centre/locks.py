"""Compare which joints a tripod may lock while a foot swings: by kinematics and by letting it go.

The paper locks q_1 of both standing limbs and leaves the choice to future work. Of all pairs of
joints there are here how well the locked values determine the platform's pose, how well legs and
locks hold it, and how far the platform of rigid bodies sinks when a foot is let go.

With q_1 of both standing limbs locked, as the paper has it, the platform is held, but where it is
parallel to the ground a foot's pose does not determine it: the smallest singular value is 0. With
q_6 of one and q_2 of the other it is .064. Of 28 pairs one lets the platform fall: q_6 of both, by
477 mm in half a second.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from parapod.diagrams.machining_centre.held_centre import HeldCentre, make_held_centre
from parapod.diagrams.simulators import simulator_of
from parapod.diagrams.style import COLOURS
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.progress import counted
from parapod.sims.output.results import Metric
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import inverse_kinematics
from parapod.systems.machining_centre.swing import LockSet, lock_conditions, lock_sets

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_TRIPOD, _QUADRUPED = CentreGeometry(3), CentreGeometry(4)
# The limb whose foot is let go.
_LIMB = 1
# Below this smallest singular value a pair is taken not to hold the platform [-].
_HOLDS = 1e-3
# A platform that falls goes farther than this within half a second, one that sinks does not [m].
_FALLEN = 0.05
# A locked joint does not move at all [rad].
_DRIFT = 1e-9
# Share of the poses at which a pair is at least as good as is reported.
_PERCENTILE = 10.0


@dataclass
class CentreLocksScenario(Schema):
    """Pairs of locked joints of the tripod's limbs 2 and 3 while the foot of limb 1 is loose.

    Attributes:
        backend: method: "multibody", closed forms, and rigid bodies that are let go.
        seed: seed of the poses.
        height_mm: height of the platform at its pose parallel to the ground [mm].
        poses: number of poses around that one.
        spread_mm: largest distance of these along each axis [mm].
        tilt_deg: largest roll, pitch and yaw of these [deg].
        duration: time after which is looked how far the platform has sunk [s].
        time_step: step of the rigid bodies [s].
        accuracy: accuracy of the rigid bodies, as `plant.accuracy` of centre-walk [m, rad]; null:
            they take steps of `time_step`.
    """

    backend: str = choice("multibody", ("multibody",))
    seed: int = quantity(0, 0, 2**31 - 1)
    height_mm: float = quantity(480.0, 300.0, 700.0)
    poses: int = quantity(400, 10, 100_000)
    spread_mm: float = quantity(40.0, 0.0, 100.0)
    tilt_deg: float = quantity(10.0, 0.0, 20.0)
    duration: float = quantity(0.5, 0.4, 2.0)
    time_step: float = quantity(1e-3, 1e-4, 5e-3)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)

    @property
    def home(self) -> Array:
        """Pose parallel to the ground (6) [m, rad]."""
        return np.array((0.0, 0.0, 1e-3 * self.height_mm, 0.0, 0.0, 0.0))

    @property
    def around(self) -> Array:
        """Poses (k, 6) around it."""
        random = np.random.default_rng(self.seed)
        spread, tilt = 1e-3 * self.spread_mm, math.radians(self.tilt_deg)
        limits = np.repeat((spread, tilt), 3)
        return self.home + random.uniform(-limits, limits, (self.poses, 6))


class Pair(NamedTuple):
    """Result of one pair of locked joints.

    Attributes:
        lock_set: the pair.
        inverse: smallest singular value of the locked joints at the pose parallel to the ground.
        holding: the same of the standing legs and locks.
        around: (k) the smaller of both at the poses around it.
        sunk: way of the platform after the foot was let go [m].
        drift: largest drift of a locked joint [rad].
    """

    lock_set: LockSet
    inverse: float
    holding: float
    around: Array
    sunk: float
    drift: float

    @property
    def name(self) -> str:
        """Both joints, as in "q2 of 2, q3 of 3"."""
        return ", ".join(f"q{joint} of {limb}" for limb, joint in self.lock_set.standing)

    @property
    def sigma(self) -> float:
        """The smaller singular value at the pose parallel to the ground."""
        return min(self.inverse, self.holding)

    @property
    def sigma_around(self) -> float:
        """The smaller singular value that nine tenths of the poses exceed."""
        return float(np.percentile(self.around, _PERCENTILE))

    @property
    def holds(self) -> bool:
        """Whether the kinematics says that the platform is held."""
        return self.holding > _HOLDS

    @property
    def has_fallen(self) -> bool:
        """Whether the platform of rigid bodies fell."""
        return not self.sunk < _FALLEN


@dataclass(frozen=True)
class Comparison:
    """All pairs, and the quadruped, which needs none.

    Attributes:
        pairs: results of all pairs.
        quadruped: smallest singular values of the quadruped with limb 1 loose: of its four locked
            joints, and of the three limbs that stand.
        quadruped_sunk: way of its platform after the foot was let go [m].
        unlocked_sunk: way of the tripod's without any lock [m].
    """

    pairs: tuple[Pair, ...]
    quadruped: tuple[float, float]
    quadruped_sunk: float
    unlocked_sunk: float

    @cached_property
    def printed(self) -> Pair:
        """The paper's pair."""
        printed_set = LockSet.printed(_TRIPOD, _LIMB)
        return next(pair for pair in self.pairs if pair.lock_set == printed_set)

    @cached_property
    def best(self) -> Pair:
        """The pair that nine tenths of the poses like best."""
        return max(self.pairs, key=lambda pair: pair.sigma_around)


class CentreLocks(Experiment[CentreLocksScenario, Comparison]):
    """Compares pairs of locks."""

    schema = CentreLocksScenario
    backends = ("multibody",)
    takes = "5 s"

    def check(self, scenario: CentreLocksScenario) -> None:
        """Refuses a pose outside the stroke.

        Raises:
            UnreachablePosture: names the leg.
        """
        inverse_kinematics(_TRIPOD, scenario.home)

    def run(self, scenario: CentreLocksScenario, runner: Runner) -> Comparison:
        """Tries every pair."""
        sets = lock_sets(_TRIPOD, _LIMB)
        centre = make_held_centre(_TRIPOD, scenario.time_step, scenario.accuracy)
        home, around = scenario.home, scenario.around
        pairs = []
        with counted(runner.console, "pairs of locks", len(sets)) as tell:
            for count, lock_set in enumerate(sets, start=1):
                pairs.append(_tried(centre, home, around, lock_set, scenario.duration))
                tell(count)
        four = make_held_centre(_QUADRUPED, scenario.time_step, scenario.accuracy)
        conditions = lock_conditions(_QUADRUPED, home, LockSet(_LIMB), along="left")
        loose = LockSet(_LIMB).joints
        return Comparison(
            tuple(pairs),
            (float(conditions.inverse), float(conditions.holding)),
            fall(four, home, _LIMB, loose, scenario.duration)[0],
            fall(centre, home, _LIMB, (), scenario.duration)[0],
        )

    def measure(self, scenario: CentreLocksScenario, data: Comparison) -> Iterator[Metric]:
        """Singular values of the best pair and the paper's, and what falls."""
        best, printed = data.best, data.printed
        for key, pair in (("best", best), ("paper", printed)):
            where = f"smallest singular value with {pair.name} locked"
            meaning = f"{where}, platform parallel to the ground"
            yield Metric(f"{key}_sigma", pair.sigma, meaning=meaning)
            meaning = f"{where}, exceeded in {100.0 - _PERCENTILE:.0f} % of the poses"
            yield Metric(f"{key}_sigma_around", pair.sigma_around, meaning=meaning)
        yield Metric(
            "paper_sunk_mm",
            1e3 * printed.sunk,
            "mm",
            1e3 * _FALLEN,
            meaning="way by which the platform sinks with the paper's pair, which holds it",
        )
        yield Metric(
            "pairs_misjudged",
            sum(pair.holds == pair.has_fallen for pair in data.pairs),
            bound=0,
            meaning="pairs whose simulation contradicts the prediction",
        )
        fallen = sum(pair.has_fallen for pair in data.pairs)
        yield Metric(
            "pairs_fallen",
            fallen,
            meaning=f"pairs with which the platform falls, of {len(data.pairs)}",
        )
        yield Metric(
            "lock_drift_mrad",
            1e3 * max(pair.drift for pair in data.pairs),
            "mrad",
            1e3 * _DRIFT,
            meaning="largest drift of a locked joint",
        )
        yield Metric(
            "unlocked_sunk_mm",
            1e3 * data.unlocked_sunk,
            "mm",
            at_least=1e3 * _FALLEN,
            meaning="way by which a tripod without locks sinks",
        )
        yield Metric(
            "quadruped_sigma",
            min(data.quadruped),
            meaning="smallest singular value of the quadruped without locks",
        )
        yield Metric(
            "quadruped_sunk_mm",
            1e3 * data.quadruped_sunk,
            "mm",
            1.0,
            meaning="way by which a quadruped without locks sinks on three limbs",
        )

    def note(self, scenario: CentreLocksScenario, data: Comparison) -> Iterator[str]:
        """The paper's choice and the best one."""
        yield (
            f"With {data.printed.name} locked, as the paper has it, the smallest singular value "
            f"of the locked joints is {data.printed.inverse:.1e} where the platform is parallel "
            f"to the ground; with {data.best.name} it is {data.best.inverse:.3f}."
        )

    def details(self, scenario: CentreLocksScenario, data: Comparison) -> dict[str, Any]:
        """The table of all pairs, the best first."""
        ordered = sorted(data.pairs, key=lambda pair: -pair.sigma_around)
        return {
            "pairs": [
                {
                    "locked": pair.name,
                    "inverse": pair.inverse,
                    "holding": pair.holding,
                    "sigma_around": pair.sigma_around,
                    "sunk_mm": 1e3 * pair.sunk,
                }
                for pair in ordered
            ]
        }

    def draw(self, scenario: CentreLocksScenario, data: Comparison) -> Iterator[Figure]:
        """Both singular values of every pair, and how far the platform sank."""
        yield Figure(
            "centre_locks",
            "Pairs of locked joints",
            "Left: smallest singular values at the pose parallel to the ground, of the locked "
            "joints (a foot's pose determines the platform's) and of standing legs and locks (the "
            "platform is held). Right: what the platform sinks by when the foot is let go, half a "
            "second later; legs yield, so that a smaller singular value sinks farther.",
            partial(_draw, data),
            (7.0, 3.6),
        )


def _tried(
    centre: HeldCentre, home: Array, around: Array, lock_set: LockSet, duration: float
) -> Pair:
    at_home, spread = (
        lock_conditions(_TRIPOD, poses, lock_set, along="left") for poses in (home, around)
    )
    sunk, drift = fall(centre, home, _LIMB, lock_set.joints, duration)
    smaller = np.minimum(spread.inverse, spread.holding)
    inverse, holding = float(at_home.inverse), float(at_home.holding)
    return Pair(lock_set, inverse, holding, smaller, sunk, drift)


def fall(
    held: HeldCentre,
    pose: Array,
    limb: int,
    joints: tuple[tuple[int, int], ...],
    duration: float,
) -> tuple[float, float]:
    """Way of the platform after a foot has been let go, and the largest drift of a locked joint.

    Args:
        held: the centre.
        pose: (6) at which it stands first [m, rad].
        limb: limb whose foot is released, counted from 1.
        joints: locked joints (limb, joint).
        duration: after which the platform is looked at [s].

    Returns:
        Distance of P_O from where it was [m], and drift [rad].
    """
    simulator = simulator_of(held.diagram)
    root, model = simulator.get_mutable_context(), held.model
    held.stand(root, pose)
    context = held.context(root)
    model.lock(context, joints)
    model.unclamp(context, limb)
    locked = [model.lock_joint(*joint) for joint in joints]
    before = [joint.get_angle(context) for joint in locked]
    start = held.pose(root)
    simulator.Initialize()
    simulator.AdvanceTo(duration)
    way = float(np.linalg.norm((held.pose(root) - start)[:3]))
    after = [joint.get_angle(context) for joint in locked]
    return way, float(np.abs(np.subtract(after, before)).max(initial=0.0))


def _draw(data: Comparison, canvas: "Canvas") -> None:
    left, right = canvas.subplots(1, 2)
    groups = (
        ("paper's", COLOURS[1], [data.printed]),
        ("best", COLOURS[2], [data.best]),
        ("others", "0.55", [p for p in data.pairs if p not in (data.printed, data.best)]),
    )
    for label, colour, pairs in groups:
        style: Any = {"color": colour, "label": label, "linestyle": "", "marker": "o"}
        left.plot([p.inverse for p in pairs], [p.holding for p in pairs], **style)
        right.plot([p.holding for p in pairs], [1e3 * p.sunk for p in pairs], **style)
    left.set(xlabel="of the locked joints [-]", ylabel="of standing legs and locks [-]")
    left.set_title("smallest singular values", fontsize=9)
    right.set(xlabel="of standing legs and locks [-]", ylabel="sunk by [mm]", yscale="log")
    right.axhline(1e3 * _FALLEN, color="0.6", linestyle="dotted")
    right.legend()
