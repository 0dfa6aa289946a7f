"""Compute what a step of the walking chair asks of its branches, with and without jerks.

Figs. 7 and 8 of the paper, and a body that moves without jerks. Lengths, velocities and
accelerations of all twelve branches with the body moved by Eq. (45) and by a law without steps of
the speed. Nothing is simulated: every number is a closed form.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.plots import Limits
from parapod.diagrams.style import COLOURS
from parapod.diagrams.walking_chair.design import ChairDesign
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario, GaitScenario, PassengerScenario
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.runner import Runner
from parapod.sims.output.drawn import LogDrawing
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.checks import SPEED_LIMIT, check_gait
from parapod.systems.walking_chair.gait import (
    FIRST_SWING,
    LIFT,
    LOWER,
    SECOND_SWING,
    SHIFT,
    Side,
    TrotGait,
    Walk,
    gait_branches,
    gait_motion,
)
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.support import GaitSupport
from parapod.systems.walking_chair.trajectories import BranchMotion

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Cycles are all alike; these are enough to be drawn and written to a log.
_MOST_CYCLES = 10
type Floats = NDArray[np.float64]
# Samples of a phase, both of its ends among them: what is between them exceeds them by 0.3 um.
_SAMPLES = 1001
# Smaller steps are rounding [mm/s] and [mm/s^2].
_NO_STEP = 1e-6
# Lengths that are equal but for rounding [mm].
_EQUAL_MM = 1e-6
# Depth of a corner below the ground that rounding may cause [mm].
_BELOW_MM = 1e-3
_QUANTITIES = (
    ("a", "length", "length [mm]", "Lengths"),
    ("b", "velocity", "velocity [mm/s]", "Velocities"),
    ("c", "acceleration", "acceleration [mm/s²]", "Accelerations"),
)
# The two UPS branches of a leg do the same; the second is dashed so that both are seen.
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS[0]},
    {"color": COLOURS[1], "linewidth": 2.0},
    {"color": COLOURS[6], "linewidth": 0.9, "linestyle": (0, (4, 4))},
)
_PANEL = 9  # font size of a panel's title
_GROUND, _GHOST, _RED = "0.55", "0.75", "#C0392B"
# Feet that are drawn of a swing, the first palest.
_DRAWN_FEET = 5
_PALEST = 0.2
_STRIDE = 10  # draw every tenth sample
# A controller's period, over which a step of the velocity is an acceleration [s].
_PERIOD = 0.01


PRINTED = "linear"  # the law of Eq. (45)


@dataclass
class ChairGaitScenario(Schema):
    """A gait that is compared with the paper's.

    The body is moved by Eq. (45) and by a law without steps of the speed: section "Trotting gait
    simulation", Figs. 7 and 8. A gait that takes a branch out of its stroke or is too fast for it
    is refused.

    Attributes:
        backend: method: "exact", closed forms.
        seed: seed, which changes nothing: nothing is random.
        machine: see `ChairDesign`.
        gait: see `GaitScenario`; its body law is the one that is compared with Eq. (45).
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: ChairDesign = field(default_factory=ChairDesign)
    gait: GaitScenario = field(default_factory=GaitScenario)

    @property
    def walks(self) -> tuple[Walk, Walk]:
        """The gait with the body moved by Eq. (45), and by the scenario's law."""
        leg = self.machine.geometry.leg
        return replace(self.gait, body_law=PRINTED).walk_of(leg), self.gait.walk_of(leg)


@dataclass(frozen=True)
class SampledWalk:
    """A walk at times of which each instant between two phases is there twice, from either side.

    Attributes:
        geometry: the chair.
        walk: the gaits.
        time: (n) [s].
        phase: (n) index of the phase.
        body: (n, 3) S in the world [m].
        branches: arrays (n, 4, 3).
        velocity_steps: (k, 4, 3) by which velocities jump where phases begin and end [m/s].
        acceleration_steps: (k, 4, 3) steps of the acceleration [m/s^2].
        speed_limit: largest speed of a branch [m/s].
    """

    geometry: ChairGeometry
    walk: Walk
    time: Floats
    phase: NDArray[np.intp]
    body: Floats
    branches: BranchMotion
    velocity_steps: Floats
    acceleration_steps: Floats
    speed_limit: float = SPEED_LIMIT

    @cached_property
    def corners(self) -> Floats:
        """(n, 4, 3, 3) corners of the feet in the world, from the lengths alone [m]."""
        return foot_corners(self.geometry, self.body, np.eye(3), self.branches.length)

    def during(self, *names: str) -> NDArray[np.bool_]:
        """(n) times of the phases of these names."""
        indices = [i for i, name in enumerate(self.walk.phases) if name in names]
        return np.isin(self.phase, indices)

    @property
    def swings(self) -> NDArray[np.bool_]:
        """(n) times at which feet swing."""
        return self.during(FIRST_SWING, SECOND_SWING)


@dataclass(frozen=True)
class Walks:
    """The same gait by two laws.

    Attributes:
        printed: the body moved by Eq. (45).
        smooth: the body moved by a law without steps of the speed.
    """

    printed: SampledWalk
    smooth: SampledWalk


class ChairGait(Experiment[ChairGaitScenario, Walks]):
    """Samples the gait with both laws."""

    schema = ChairGaitScenario
    # Pale: the body moved by Eq. (45).
    drawing = LogDrawing(
        CHAIR,
        {"legs.position": "smooth.length", "position_node": f"{PRINTED}.length"},
        plots=(
            "smooth.body_position[1:3]",
            "smooth.length[0:3]",
            f"{PRINTED}.velocity[0:2]+smooth.velocity[0:2]",
            "smooth.acceleration[0:3]",
        ),
    )
    backends = ("exact",)
    takes = "2 s"

    def check(self, scenario: ChairGaitScenario) -> None:
        """Refuses a gait with too many cycles, out of a branch's stroke, or too fast for it."""
        check_walks(scenario, scenario.machine.geometry)

    def run(self, scenario: ChairGaitScenario, runner: Runner) -> Walks:
        """Moves the branches: closed forms, nothing is simulated."""
        with runner.console.status("moving the branches"):
            geometry = scenario.machine.geometry
            limit = 1e-3 * scenario.machine.drives.max_velocity_mm_s
            return Walks(*(sample_walk(geometry, walk, limit) for walk in scenario.walks))

    def logged(self, scenario: ChairGaitScenario, data: Walks) -> Logged:
        """Body, feet and branches by both laws, which have the same times."""
        signals = {}
        for law, walk in ((PRINTED, data.printed), ("smooth", data.smooth)):
            count = len(walk.time)
            signals[f"{law}.body_position"] = (walk.body, "m")
            signals[f"{law}.foot_corners"] = (walk.corners.reshape(count, -1), "m")
            for name, unit in (("length", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2")):
                values = getattr(walk.branches, name).reshape(count, -1)
                signals[f"{law}.{name}"] = (values, unit)
        standing = np.array(data.printed.walk.standing, dtype=float)
        signals["support"] = (standing[data.printed.phase], "0/1")
        return data.printed.time, signals

    def machine_scenario(self, scenario: ChairGaitScenario) -> ChairScenario:
        """The chair at the beginning of the gait, without a passenger."""
        seat = PassengerScenario(0.0)
        return ChairScenario(machine=scenario.machine, gait=scenario.gait, passenger=seat)

    def limits(self, scenario: ChairGaitScenario) -> Limits:
        """Strokes and speeds of the branches."""
        speed = 1e-3 * scenario.machine.drives.max_velocity_mm_s
        of_both = {f"{law}.velocity": (-speed, speed) for law in (PRINTED, "smooth")}
        return {**super().limits(scenario), **of_both}

    def measure(self, scenario: ChairGaitScenario, data: Walks) -> Iterable[Metric]:
        """Speeds, accelerations, strokes and symmetries."""
        return gait_metrics(data.printed, data.smooth)

    def note(self, scenario: ChairGaitScenario, data: Walks) -> Iterable[str]:
        """Impulses of acceleration, symmetries, reference corners."""
        return _notes(gait_metrics(data.printed, data.smooth))

    def draw(self, scenario: ChairGaitScenario, data: Walks) -> Iterable[Figure]:
        """Branches, plan and swing (Figs. 7 and 8)."""
        return figures(data.printed, data.smooth, scenario.gait.body_law)


def check_walks(scenario: ChairGaitScenario, geometry: ChairGeometry) -> None:
    """Refuse a gait that is too long to be drawn, or that the actuators cannot do.

    Raises:
        ScenarioError: too many cycles.
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
    """
    cycles = scenario.gait.cycles
    if cycles > _MOST_CYCLES:
        raise ScenarioError(
            f"gait.cycles = {cycles}: cycles are all alike, and up to {_MOST_CYCLES} are drawn",
            "gait.cycles",
        )
    for walk in scenario.walks:
        for gait in walk.gaits:
            check_gait(geometry, gait, 1e-3 * scenario.machine.drives.max_velocity_mm_s)


def sample_walk(
    geometry: ChairGeometry, walk: Walk, speed_limit: float = SPEED_LIMIT
) -> SampledWalk:
    """Samples all phases of a walk."""
    parts = [_sample_gait(geometry, gait) for gait in walk.gaits]
    begins = np.cumsum([0.0, *(gait.duration for gait in walk.gaits)])
    phases = np.cumsum([0, *(len(gait.phases) for gait in walk.gaits)])
    return SampledWalk(
        geometry,
        walk,
        np.concatenate([part.time + begin for part, begin in zip(parts, begins, strict=False)]),
        np.concatenate([part.phase + first for part, first in zip(parts, phases, strict=False)]),
        np.concatenate([part.body for part in parts]),
        _joined([part.branches for part in parts]),
        np.concatenate([part.velocity_steps for part in parts]),
        np.concatenate([part.acceleration_steps for part in parts]),
        speed_limit,
    )


def _sample_gait(geometry: ChairGeometry, gait: TrotGait) -> SampledWalk:
    ends = gait.phase_duration * np.arange(len(gait.phases) + 1)
    times, bodies, branches = [], [], []
    for begin, end in pairwise(ends):
        inside = np.linspace(begin, end, _SAMPLES)
        parts: tuple[tuple[Floats, Side], ...] = ((inside[:-1], "right"), (inside[-1:], "left"))
        for time, side in parts:
            times.append(time)
            bodies.append(gait_motion(geometry, gait, time, side).body.position)
            branches.append(gait_branches(geometry, gait, time, side))
    after, before = (gait_branches(geometry, gait, ends, side) for side in ("right", "left"))
    return SampledWalk(
        geometry,
        Walk((gait,)),
        np.concatenate(times),
        np.repeat(np.arange(len(gait.phases)), _SAMPLES),
        np.concatenate(bodies),
        _joined(branches),
        after.velocity - before.velocity,
        after.acceleration - before.acceleration,
    )


def _joined(parts: list[BranchMotion]) -> BranchMotion:
    return BranchMotion(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def gait_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    """Measure a walk with the body moved by Eq. (45), and by a smooth law."""
    return (
        *_speed_metrics(printed, smooth),
        *_acceleration_metrics(printed, smooth),
        *_stroke_metrics(printed, smooth),
        *_law_metrics(printed, smooth),
    )


def _speed_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    limit = 1e3 * printed.speed_limit
    both = [walk.branches.velocity for walk in (printed, smooth)]
    return (
        Metric(
            "max_branch_speed_mm_s",
            _largest(*both),
            "mm/s",
            limit,
            paper=f"0..{limit:g}",
            meaning="largest speed of all branches, with either law",
        ),
        *(
            Metric(
                f"{what}_speed_{law}_mm_s",
                _largest(walk.branches.velocity[walk.during(*phases)]),
                "mm/s",
                limit,
                meaning=f"largest speed while the body {moves}, {words}",
            )
            for what, phases, moves in (
                ("lift", (LIFT, LOWER), "is lifted or lowered"),
                ("shift", (SHIFT,), "moves ahead"),
            )
            for law, walk, words in (
                ("printed", printed, "Eq. (45)"),
                ("smooth", smooth, "smooth law"),
            )
        ),
        Metric(
            "velocity_step_mm_s",
            _largest(smooth.velocity_steps),
            "mm/s",
            _NO_STEP,
            meaning="largest change of a velocity between two phases, smooth law",
        ),
        Metric(
            "velocity_step_printed_mm_s",
            _largest(printed.velocity_steps),
            "mm/s",
            paper="discontinuous",
            meaning="largest change of a velocity between two phases, Eq. (45)",
        ),
    )


def _acceleration_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    return (
        Metric(
            "swing_acceleration_mm_s2",
            _largest(smooth.branches.acceleration[smooth.swings]),
            "mm/s^2",
            meaning="largest acceleration while feet swing, Eqs. (40) and (44)",
        ),
        *(
            Metric(
                f"body_acceleration_{law}_mm_s2",
                _largest(walk.branches.acceleration[~walk.swings]),
                "mm/s^2",
                meaning=f"largest acceleration within the body's phases, {words}",
            )
            for law, walk, words in (
                ("printed", printed, "Eq. (45), beside its impulses"),
                ("smooth", smooth, "smooth law"),
            )
        ),
        Metric(
            "acceleration_step_mm_s2",
            _largest(smooth.acceleration_steps),
            "mm/s^2",
            _NO_STEP,
            paper="smooth",
            meaning="largest change of an acceleration between two phases, smooth law",
        ),
    )


def _stroke_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    lengths = 1e3 * np.concatenate([walk.branches.length for walk in (printed, smooth)])
    strokes = 1e3 * printed.geometry.leg.strokes
    metrics = []
    for name, which, (low, high) in (
        ("up", slice(0, 1), strokes[0].tolist()),
        ("ups", slice(1, 3), strokes[1].tolist()),
    ):
        # What an actuator that is fully retracted has lost by rounding.
        low_bound, high_bound = low - _EQUAL_MM, high + _EQUAL_MM
        shortest, longest = (float(f(lengths[..., which])) for f in (np.min, np.max))
        words = f"{name.upper()} branches"
        metrics += [
            Metric(
                f"{name}_shortest_mm",
                shortest,
                "mm",
                at_least=low_bound,
                paper=f">= {low:g}",
                meaning=f"smallest length of the {words}",
            ),
            Metric(
                f"{name}_longest_mm",
                longest,
                "mm",
                high_bound,
                paper=f"<= {high:g}",
                meaning=f"largest length of the {words}",
            ),
        ]
    return tuple(metrics)


def _law_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    walks = printed, smooth
    return (
        Metric(
            "lowest_corner_mm",
            1e3 * min(float(walk.corners[..., 2].min()) for walk in walks),
            "mm",
            at_least=-_BELOW_MM,
            meaning="lowest height of all feet's corners above the ground",
        ),
        Metric(
            "time_reversal_error_mm",
            max(_time_reversal_mm(walk) for walk in walks),
            "mm",
            _EQUAL_MM,
            paper="symmetric",
            meaning="difference of legs 1 and 4 and of legs 2 and 3, one of them run backwards",
        ),
        Metric(
            "same_time_difference_mm",
            max(_largest(_pairs_differ(walk.branches.length)) for walk in walks),
            "mm",
            meaning="difference of the same legs at the same time: the symmetry is one of time",
        ),
        Metric(
            "ups_difference_mm",
            max(_largest(np.diff(walk.branches.length[..., 1:], axis=-1)) for walk in walks),
            "mm",
            _EQUAL_MM,
            paper="the same",
            meaning="difference of each leg's two UPS branches",
        ),
    )


def _largest(*values: Floats) -> float:
    """Largest absolute value, in thousandths."""
    return 1e3 * max(float(np.abs(array).max(initial=0.0)) for array in values)


def _pairs_differ(lengths: Floats, others: Floats | None = None) -> Floats:
    """Lengths (n, 4, 3) of legs 1 and 2 less those of legs 4 and 3."""
    others = lengths if others is None else others
    return lengths[:, :2] - others[:, :1:-1]


def _time_reversal_mm(walk: SampledWalk) -> float:
    """Distance of one leg of a pair from the other with the time reversed, in each gait."""
    lengths = walk.branches.length
    ends = np.cumsum([len(gait.phases) for gait in walk.walk.gaits])
    parts = np.split(lengths, np.searchsorted(walk.phase, ends[:-1]))
    return max(_largest(_pairs_differ(part, part[::-1])) for part in parts)


def figures(printed: SampledWalk, smooth: SampledWalk, law: str) -> tuple[Figure, ...]:
    """The paper's Figs. 7 and 8, and the feet's swing.

    Args:
        printed: gait with the body moved by Eq. (45).
        smooth: gait with the body moved by the law.
        law: the law's name.
    """
    of_branches = tuple(
        Figure(
            f"fig08{letter}_{quantity}",
            f"{words} of all branches",
            f"{words} of the branches of each leg, above with the body moved by Eq. (45), below "
            f"by the law '{law}' (Fig. 8{letter}). The two UPS branches of a leg do the same.",
            partial(_draw_branches, (printed, smooth), ("Eq. (45)", law), quantity, label),
            (10.0, 4.4),
        )
        for letter, quantity, label, words in _QUANTITIES
    )
    return (
        Figure(
            "fig07_footprints",
            "Footprints, support polygons and the body's way",
            "The phases of a step from above (Fig. 7): feet that stand, the polygon that they "
            "span for the whole phase, where the feet that swing come from and go to, and the "
            "body's centre S.",
            partial(_draw_plan, smooth),
            (9.6, 4.4),
        ),
        *of_branches,
        Figure(
            "swing",
            "A foot's swing from the side",
            "Trajectory of the corner that is the reference, Eqs. (40) and (44), with the foot "
            "drawn at equal times, the later the darker; it leans as much as its UP branch.",
            partial(_draw_swing, smooth),
            (9.0, 3.1),
        ),
    )


def _draw_branches(
    walks: tuple[SampledWalk, ...],
    names: tuple[str, ...],
    quantity: str,
    label: str,
    canvas: "Canvas",
) -> None:
    rows: Any = canvas.subplots(len(walks), LEG_COUNT, sharex=True, sharey=True)
    for row, walk, name in zip(rows, walks, names, strict=True):
        values = 1e3 * getattr(walk.branches, quantity)
        in_use = _kept(walk)
        for leg, axes in enumerate(row):
            for branch, style in enumerate(_STYLES):
                values_in_use = values[in_use, leg, branch]
                axes.plot(walk.time[in_use], values_in_use, label=f"branch {branch + 1}", **style)
            for end in walk.walk.ends[:-1]:
                axes.axvline(end, color="0.9", linewidth=0.8, zorder=0)
            if quantity == "velocity":
                for limit in (1e3 * walk.speed_limit, -1e3 * walk.speed_limit):
                    axes.axhline(limit, color=_GROUND, linewidth=0.8, linestyle="dotted")
        row[0].set_ylabel(f"{name}\n{label}")
    for leg, axes in enumerate(rows[0]):
        axes.set_title(f"leg {leg + 1}", fontsize=_PANEL)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, walks[0].walk.duration)
    handles = rows[0, 0].get_lines()[: len(_STYLES)]
    labels = ("UP branch", "UPS branch 2", "UPS branch 3")
    canvas.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8)


def _kept(walk: SampledWalk) -> NDArray[np.bool_]:
    """(n) samples that are drawn: some, and all at the ends of phases."""
    in_use = np.zeros(len(walk.time), dtype=np.bool_)
    in_use[::_STRIDE] = in_use[-1] = True
    changes = np.flatnonzero(np.diff(walk.phase))
    in_use[changes] = in_use[changes + 1] = True
    return in_use


def _draw_plan(walk: SampledWalk, canvas: "Canvas") -> None:
    support = GaitSupport(walk.geometry, walk.walk)
    phases = walk.walk.phases
    phases_shown = [phases.index(name) for name in (FIRST_SWING, SHIFT, SECOND_SWING)]
    panels: Any = canvas.subplots(1, len(phases_shown), sharex=True, sharey=True)
    for axes, phase in zip(panels, phases_shown, strict=True):
        samples = np.flatnonzero(walk.phase == phase)
        before, after = samples[0], samples[-1]
        polygon = 1e3 * support.polygon(phase).corners
        axes.fill(*polygon.T, facecolor=_RED, alpha=0.12, edgecolor="none", zorder=0)
        axes.fill(*polygon.T, facecolor="none", edgecolor=_RED, linewidth=1.2, zorder=3)
        for leg, stands in enumerate(walk.walk.standing[phase]):
            _draw_foot(axes, walk.corners[after, leg], filled=stands)
            if not stands:
                _draw_foot(axes, walk.corners[before, leg], filled=False, ghost=True)
            x, y = 1e3 * walk.corners[after, leg, :, :2].mean(axis=0)
            axes.annotate(f"{leg + 1}", (x, y), ha="center", va="center", fontsize=8)
        _draw_body(axes, 1e3 * walk.body[before, :2], 1e3 * walk.body[after, :2])
        axes.set_title(f"{phases[phase]}, {_seconds(walk, phase)}", fontsize=_PANEL)
        axes.set_xlabel("x [mm]")
        axes.set_aspect("equal")
    panels[0].set_ylabel("y [mm]")


def _seconds(walk: SampledWalk, phase: int) -> str:
    begin, end = (0.0, *walk.walk.ends)[phase : phase + 2]
    return f"{begin:g} to {end:g} s"


def _draw_foot(axes: Any, corners: Floats, filled: bool, ghost: bool = False) -> None:
    colour = _GHOST if ghost else COLOURS[0]
    face = (*_rgb(COLOURS[0]), 0.25) if filled else "none"
    dashes = "dashed" if ghost else "solid"
    axes.fill(*1e3 * corners[:, :2].T, facecolor=face, edgecolor=colour, linestyle=dashes)


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)


def _draw_body(axes: Any, before: Floats, after: Floats) -> None:
    axes.plot(*before, marker="o", color="black", markersize=4)
    if np.linalg.norm(after - before) > 1.0:
        axes.annotate("", after, before, arrowprops={"arrowstyle": "->", "linewidth": 1.2})
        axes.plot(*after, marker="o", color="white", markeredgecolor="black", markersize=4)
    axes.annotate("S", before, xytext=(6, -3), textcoords="offset points", fontsize=8)


def _draw_swing(walk: SampledWalk, canvas: "Canvas") -> None:
    phase = walk.walk.phases.index(FIRST_SWING)
    samples = np.flatnonzero(walk.phase == phase)
    legs = [leg for leg, stands in enumerate(walk.walk.standing[phase]) if not stands]
    references = walk.walk.motion(walk.geometry, walk.time[samples[1]]).references
    panels: Any = canvas.subplots(1, len(legs), sharey=True)
    for axes, leg in zip(panels, legs, strict=True):
        corner = int(references[leg]) - 1
        path = 1e3 * walk.corners[samples, leg, corner, 1:]
        axes.axhline(0.0, color=_GROUND, linewidth=1.0)
        axes.plot(*path.T, color=COLOURS[1], linewidth=1.2)
        for share in np.linspace(0.0, 1.0, _DRAWN_FEET):
            sample = samples[round(share * (len(samples) - 1))]
            # E1 and the edge E2 E3, which from the side is a point.
            foot = 1e3 * walk.corners[sample, leg, :2, 1:]
            colour = (*_rgb(COLOURS[0]), _PALEST + (1.0 - _PALEST) * share)
            axes.plot(*foot.T, color=colour, linewidth=2.4, solid_capstyle="round")
        axes.set_title(f"leg {leg + 1}, reference E{corner + 1}", fontsize=_PANEL)
        axes.set_xlabel("y [mm]")
        axes.set_aspect("equal")
    panels[0].set_ylabel("z [mm]")


def _notes(metrics: tuple[Metric, ...]) -> tuple[str, ...]:
    (step,) = [m.value for m in metrics if m.key == "velocity_step_printed_mm_s"]
    return (
        f"Steps of {step:.2f} mm/s are impulses of acceleration: "
        f"{1e-3 * step / _PERIOD:.2f} m/s^2 over a controller's period of {1e3 * _PERIOD:g} ms. "
        "The paper's smooth accelerations are those of the swing; the body's ramps of Eq. (45) "
        "have none between their ends, and all of them there.",
        "Legs 1 and 4, and legs 2 and 3, are symmetric in time: one does backwards what the other "
        "does. At the same time they differ.",
        "Feet lean while they are not below their hinges. Each leg's reference is the corner that "
        "is lowest then; with E1 for all of them, corners of two feet would go 14.55 mm into the "
        "ground in the paper's gait.",
    )
