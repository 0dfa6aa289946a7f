"""Compute what the walking chair carries through a step, and how near it is to tipping.

Eqs. (50)-(54) of the paper, and the 57 kg of Fig. 17. The chair stands still at instants of a
step. Forces of the ground are spread over the corners of its feet so that no branch exceeds its
actuator's thrust; the largest payload for which there is such a way bounds what any control can
carry. The support polygon says how far it is from tipping.

The paper's payload of 57 kg is an experiment with rated currents. An optimal distribution of
forces carries 168.6 kg without friction and 211 kg with it; a foot that stands on E_1 alone 37.9
kg. The paper's number is what a UP branch with .82 of its leg's load reaches.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from parapod.diagrams.plots import Limits
from parapod.diagrams.style import COLOURS
from parapod.diagrams.walking_chair.design import ChairDesign
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario, GaitScenario, PassengerScenario
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.runner import Runner
from parapod.sims.output.drawn import LogDrawing
from parapod.sims.output.figures import Figure
from parapod.sims.output.progress import progress
from parapod.sims.output.results import Metric
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.checks import check_gait
from parapod.systems.walking_chair.gait import FIRST_SWING, SECOND_SWING, GaitMotion, Walk
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.masses import Passenger, centre_of_mass
from parapod.systems.walking_chair.payload import (
    Payload,
    Stand,
    elastic_forces,
    largest_payload,
    least_branch_force,
)
from parapod.systems.walking_chair.statics import force_map
from parapod.systems.walking_chair.support import GaitSupport, SupportPolygon

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

type Floats = NDArray[np.float64]
# The paper's largest payload [kg].
PAPER_PAYLOAD = 57.0
# Corners this close to the ground touch it [m].
_TOUCHING = 1e-6
_LEVEL = np.eye(3)
# Two ways to the same number [kg].
_SAME_PAYLOAD = 0.01
# Between a payload's weight and the forces that carry it [N].
_BALANCE = 0.01
# Share of the limit.
_SAME_FORCE = 1e-3
_CORNER_E1 = np.arange(3 * LEG_COUNT) % 3 == 0
# The two UPS branches of a leg bear nearly the same; the second is dashed so that both are seen.
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS[0]},
    {"color": COLOURS[1], "linewidth": 2.0},
    {"color": COLOURS[6], "linewidth": 0.9, "linestyle": (0, (4, 4))},
)
_LIMIT = {"color": "0.55", "linewidth": 0.8, "linestyle": "dotted"}
_RED = "#C0392B"
_PANEL = 9  # font size of a panel's title


@dataclass
class PayloadScenario(Schema):
    """The payload on the seat.

    Attributes:
        mass_kg: mass whose margin and forces are computed [kg]; 57 is the paper's largest.
        x_mm: centre of mass, to the right of the seat's middle [mm].
        y_mm: centre of mass, ahead of the seat's middle [mm].
    """

    mass_kg: float = quantity(57.0, 0.0, 10_000.0)
    x_mm: float = quantity(0.0, -5000.0, 5000.0)
    y_mm: float = quantity(0.0, -5000.0, 5000.0)

    @property
    def passenger(self) -> Passenger:
        """Payload in SI units; its height does not matter to a level chair at rest."""
        return Passenger(self.mass_kg, 1e-3 * self.x_mm, 1e-3 * self.y_mm)


def _printed_gait() -> GaitScenario:
    return GaitScenario(body_law="linear")


@dataclass
class ChairPayloadScenario(Schema):
    """The chair's payload through a step.

    Section "Walking experiment research", Eqs. (50) to (54). Forces are spread over the feet's
    corners in the best possible way, by linear programming. A payload that leaves too small a
    margin to the edge of the support polygon is refused.

    Attributes:
        backend: method: "exact", statics of closed forms.
        seed: seed, which changes nothing: nothing is random.
        machine: see `ChairDesign`.
        gait: see `GaitScenario`; one of its equal cycles is computed, and the body's law says only
            when the body is where.
        payload: see `PayloadScenario`.
        friction: coefficient between feet and ground, which is compared with none at all [-].
        support_margin_mm: smallest admissible distance of the centre of mass from the edge of the
            support polygon [mm].
        instants: number of instants in each phase at which forces are spread.
    """

    moved: ClassVar = {"force_limit": "machine.drives.max_force_N"}

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: ChairDesign = field(default_factory=ChairDesign)
    gait: GaitScenario = field(default_factory=_printed_gait)
    payload: PayloadScenario = field(default_factory=PayloadScenario)
    friction: float = quantity(0.6, 0.0, 2.0)
    support_margin_mm: float = quantity(10.0, 0.0, 200.0)
    instants: int = quantity(40, 1, 1000)

    @property
    def walk(self) -> Walk:
        """One cycle, each way."""
        return replace(self.gait, cycles=1).walk_of(self.machine.geometry.leg)


class Instant(NamedTuple):
    """An instant of a step.

    Attributes:
        time: [s].
        phase: its name.
        stand: stance of the chair, with the payload where it is.
        frictionless: the largest payload without friction.
        friction: the largest payload with it.
        least_frictionless: the payload with as small a largest force as there can be.
        least_friction: the same with friction.
        equal: the payload, with friction, on branches that are all as stiff.
        soft: the same with UPS branches as soft as explains the paper's payload.
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


class ChairPayload(Experiment[ChairPayloadScenario, list[Instant]]):
    """Finds payloads, forces and margins."""

    schema = ChairPayloadScenario
    drawing = LogDrawing(
        CHAIR,
        {"legs.position": "length"},
        plots=(
            "largest_payload_frictionless+largest_payload_friction",
            "branch_force_least_friction[0:3]",
            "branch_force_equal[0:3]",
            "length[0:3]",
        ),
    )
    backends = ("exact",)
    takes = "5 s"

    def check(self, scenario: ChairPayloadScenario) -> None:
        """Refuses a gait beyond stroke or speed, and a payload that would tip the chair over."""
        check_stance(scenario)

    def run(self, scenario: ChairPayloadScenario, runner: Runner) -> list[Instant]:
        """Spreads forces at instants of a step: nothing is simulated."""
        return survey(scenario, runner.console)

    def logged(self, scenario: ChairPayloadScenario, data: list[Instant]) -> Logged:
        """Payloads, forces of the branches, their lengths, and what touches the ground."""
        signals: dict[str, tuple[Floats, str]] = {}
        for name in ("frictionless", "friction"):
            masses = np.array([getattr(instant, name).mass for instant in data])
            signals[f"largest_payload_{name}"] = (masses, "kg")
        for name in ("least_frictionless", "least_friction", "equal", "soft"):
            forces = np.array([getattr(instant, name).branch_forces for instant in data])
            signals[f"branch_force_{name}"] = (forces, "N")
        touching = np.array([instant.stand.touching for instant in data])
        signals["touching"] = (touching, "0/1")
        times = np.array([instant.time for instant in data])
        motion = scenario.walk.motions(scenario.machine.geometry, times)
        lengths = chair_inverse(
            scenario.machine.geometry,
            motion.body.position,
            _LEVEL,
            motion.feet.position,
            motion.references,
        )
        signals["length"] = (lengths.reshape(len(times), -1), "m")
        signals["support"] = (np.asarray(motion.support, dtype=float), "0/1")
        return times, signals

    def machine_scenario(self, scenario: ChairPayloadScenario) -> ChairScenario:
        """The chair at the beginning of the step, with the payload on its seat."""
        payload, gait = scenario.payload, replace(scenario.gait, cycles=1)
        seat = PassengerScenario(payload.mass_kg, payload.x_mm, payload.y_mm)
        return ChairScenario(machine=scenario.machine, gait=gait, passenger=seat)

    def limits(self, scenario: ChairPayloadScenario) -> Limits:
        """Thrust of the branches, the paper's payload, and strokes."""
        limit = scenario.machine.drives.max_force_N
        forces = ("least_frictionless", "least_friction")
        return {
            **super().limits(scenario),
            **{f"branch_force_{name}": (-limit, limit) for name in forces},
            "largest_payload_frictionless": (_asked(scenario), None),
            "largest_payload_friction": (_asked(scenario), None),
        }

    def measure(self, scenario: ChairPayloadScenario, data: list[Instant]) -> Iterator[Metric]:
        """Largest payloads, margins, and the paper's numbers."""
        yield from payload_metrics(scenario, data)
        yield from support_metrics(scenario)
        if scenario.machine == ChairDesign():
            yield from paper_metrics(scenario, data)

    def note(self, scenario: ChairPayloadScenario, data: list[Instant]) -> Iterable[str]:
        """An explanation of the paper's payload."""
        if scenario.machine != ChairDesign():
            return ()
        return _notes(scenario, tuple(self.measure(scenario, data)))

    def draw(self, scenario: ChairPayloadScenario, data: list[Instant]) -> Iterable[Figure]:
        """Payload, support and forces (Fig. 17)."""
        return figures(scenario, data)


def _lengths(scenario: ChairPayloadScenario, motion: GaitMotion) -> Floats:
    """(..., 4, 3) lengths of the branches in a motion [m]."""
    geometry, body, feet = scenario.machine.geometry, motion.body.position, motion.feet.position
    return chair_inverse(geometry, body, _LEVEL, feet, motion.references)


def check_stance(scenario: ChairPayloadScenario) -> None:
    """Refuses a gait that the actuators cannot do, and a payload that would tip the chair over.

    Raises:
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
        SupportLost: names the phase with the smallest margin.
    """
    limit = 1e-3 * scenario.machine.drives.max_velocity_mm_s
    for gait in scenario.walk.gaits:
        check_gait(scenario.machine.geometry, gait, limit)
    required = 1e-3 * scenario.support_margin_mm
    GaitSupport(scenario.machine.geometry, scenario.walk, scenario.machine.masses).check(
        scenario.payload.passenger, required
    )


def survey(scenario: ChairPayloadScenario, console: Console) -> list[Instant]:
    """Spreads forces throughout the step, at the middles of equal parts of each phase."""
    walk = scenario.walk
    softness = paper_stiffness(scenario)
    begins = (0.0, *walk.ends[:-1])
    shares = (np.arange(scenario.instants) + 0.5) / scenario.instants
    points = []
    with progress(console, "spreading forces", walk.duration) as report:
        for phase, begin, end in zip(walk.phases, begins, walk.ends, strict=True):
            for time in (begin + shares * (end - begin)).tolist():
                points.append(_spread(scenario, walk, phase, time, softness))
                report(time)
    return points


def _spread(
    scenario: ChairPayloadScenario, walk: Walk, phase: str, time: float, softness: float
) -> Instant:
    mass, friction, limit = (
        scenario.payload.mass_kg,
        scenario.friction,
        scenario.machine.drives.max_force_N,
    )
    stand = stand_at(scenario, time)._replace(payload_place=scenario.payload.passenger.place[:2])
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


def stand_at(scenario: ChairPayloadScenario, time: float) -> Stand:
    """Stance of the chair at an instant, with a payload in the middle."""
    walk, geometry = scenario.walk, scenario.machine.geometry
    motion = walk.motion(geometry, time)
    body = np.asarray(motion.body.position)
    feet = motion.feet.position
    lengths = chair_inverse(geometry, body, _LEVEL, feet, motion.references)
    corners = foot_corners(geometry, body, _LEVEL, lengths)
    touching = (corners[..., 2] < _TOUCHING) & motion.support[:, np.newaxis]
    from_body = (corners - body).reshape(-1, 3)
    return Stand(
        force_map(geometry, lengths),
        from_body,
        touching.ravel(),
        scenario.machine.masses.total,
    )


def paper_share(scenario: ChairPayloadScenario) -> float:
    """Share of a leg's load on its UP branch with which the paper's payload takes it to F_N.

    While two legs stand, each carries half of the weight.
    """
    limit = scenario.machine.drives.max_force_N
    return 2.0 * limit / (GRAVITY * (scenario.machine.masses.total + PAPER_PAYLOAD))


def paper_stiffness(scenario: ChairPayloadScenario) -> float:
    """Stiffness of a UPS branch, by that of a UP branch, which gives that share.

    The UP branch of a flat foot below its hinge is upright, and a UPS branch has the vertical
    part n_z. A vertical load is shared between them as 1, k n_z^2 and k n_z^2.
    """
    walk, geometry = scenario.walk, scenario.machine.geometry
    phase = walk.phases.index(FIRST_SWING)
    leg = walk.standing[phase].index(True)
    motion = walk.motion(geometry, walk.ends[phase], "left")
    lengths = chair_inverse(
        geometry,
        motion.body.position,
        _LEVEL,
        motion.feet.position,
        motion.references,
    )
    up, ups, _ = lengths[leg].tolist()
    n_z = (up + geometry.leg.x2 - geometry.leg.x3) / ups
    return (1.0 / paper_share(scenario) - 1.0) / (2.0 * n_z**2)


def _asked(scenario: ChairPayloadScenario) -> float:
    """Payload that must be carried [kg]: the paper's by its chair, by another the scenario's."""
    is_printed = scenario.machine == ChairDesign()
    return PAPER_PAYLOAD if is_printed else scenario.payload.mass_kg


def payload_metrics(scenario: ChairPayloadScenario, instants: list[Instant]) -> tuple[Metric, ...]:
    """The largest payloads through the step, and the forces under the scenario's."""
    mass, limit = scenario.payload.mass_kg, scenario.machine.drives.max_force_N
    return (
        *(
            Metric(
                f"payload_{name}_kg",
                min(getattr(instant, name).mass for instant in instants),
                "kg",
                at_least=_asked(scenario),
                paper=PAPER_PAYLOAD,
                meaning=f"largest payload throughout the step, best spread of forces, {words}",
            )
            for name, words in _friction_words(scenario)
        ),
        *(
            Metric(
                f"branch_force_{name}_n",
                max(_largest(getattr(instant, f"least_{name}")) for instant in instants),
                "N",
                limit,
                meaning=f"smallest possible peak force of a branch under {mass:g} kg, {words}",
            )
            for name, words in _friction_words(scenario)
        ),
        Metric(
            "balance_error_n",
            max(_balance_error(instant) for instant in instants),
            "N",
            _BALANCE,
            meaning="largest force or moment [N m] that the solution leaves unbalanced",
        ),
    )


def support_metrics(scenario: ChairPayloadScenario) -> tuple[Metric, ...]:
    """Measure how far the chair is from tipping over."""
    own, geometry = scenario.machine.masses, scenario.machine.geometry
    at_s = replace(own, body=own.body + LEG_COUNT * own.foot_end, foot=0.0, rod=0.0)
    passenger = scenario.payload.passenger
    return tuple(
        Metric(
            key,
            1e3 * float(GaitSupport(geometry, scenario.walk, masses).margins(passenger).min()),
            "mm",
            at_least=scenario.support_margin_mm,
            meaning=f"smallest distance of the centre of mass from the polygon's edge, {words}",
        )
        for key, masses, words in (
            ("support_margin_mm", at_s, "the chair's mass at S"),
            ("support_margin_with_feet_mm", own, "feet with masses of their own"),
        )
    )


def paper_metrics(scenario: ChairPayloadScenario, instants: list[Instant]) -> tuple[Metric, ...]:
    """Explain the paper's 57 kg: a payload in the middle, F_N of Eq. (53), two legs."""
    (time, *_) = [instant.time for instant in instants if instant.swings]
    stand = stand_at(scenario, time)
    on_corner = stand._replace(touching=stand.touching & _CORNER_E1)
    limit = scenario.machine.drives.max_force_N
    on_up = largest_payload(on_corner, 0.0, limit).mass
    closed_form = 2.0 * limit / GRAVITY - scenario.machine.masses.total
    softness = paper_stiffness(scenario)
    return (
        Metric(
            "payload_on_up_branches_kg",
            on_up,
            "kg",
            PAPER_PAYLOAD,
            paper=PAPER_PAYLOAD,
            meaning="largest payload with feet on E1, so that two UP branches carry it all",
        ),
        Metric(
            "closed_form_error_kg",
            abs(on_up - closed_form),
            "kg",
            _SAME_PAYLOAD,
            meaning="difference of that payload from 2 F_N / g minus the chair's mass",
        ),
        Metric(
            "up_share",
            paper_share(scenario),
            "",
            1.0,
            at_least=1.0 / 3.0,
            meaning=f"share of a leg's load on its UP branch if {PAPER_PAYLOAD:g} kg give F_N",
        ),
        Metric(
            "ups_stiffness",
            softness,
            meaning="stiffness of a UPS branch by that of a UP branch, for that share",
        ),
        _paper_force(stand, softness, limit),
    )


def _paper_force(stand: Stand, softness: float, limit: float) -> Metric:
    carried = elastic_forces(stand, PAPER_PAYLOAD, ups_stiffness=softness)
    return Metric(
        "up_force_n",
        float(carried.branch_forces.max()),
        "N",
        (1.0 + _SAME_FORCE) * limit,
        at_least=(1.0 - _SAME_FORCE) * limit,
        paper=limit,
        meaning=f"force of a UP branch under {PAPER_PAYLOAD:g} kg with UPS branches that soft",
    )


def _friction_words(scenario: ChairPayloadScenario) -> tuple[tuple[str, str], ...]:
    return ("frictionless", "no friction"), ("friction", f"friction {scenario.friction:g}")


def _largest(payload: Payload) -> float:
    return float(np.abs(payload.branch_forces).max())


def _balance_error(instant: Instant) -> float:
    """Largest of the six equations, over all that was found."""
    stand, errors = instant.stand, []
    for payload in instant[3:]:
        moment = np.cross(stand.corners, payload.forces).sum(axis=0)
        wrench = np.concatenate((payload.forces.sum(axis=0), moment))
        errors.append(np.abs(wrench - stand.wrench(payload.mass)).max())
    return float(max(errors))


def figures(scenario: ChairPayloadScenario, instants: list[Instant]) -> tuple[Figure, ...]:
    """Figures of the payload."""
    mass, softness = scenario.payload.mass_kg, paper_stiffness(scenario)
    return (
        Figure(
            "payload_over_time",
            "Largest payload through a step",
            "What the best distribution of forces carries at each instant, within every branch's "
            f"{scenario.machine.drives.max_force_N:g} N, beside the paper's {PAPER_PAYLOAD:g} kg.",
            partial(_draw_payload, scenario, instants),
            (8.0, 3.2),
        ),
        Figure(
            "payload_support",
            "Support polygons while two feet swing",
            "From above: the feet that stand, the polygon that they span, the centre of mass of "
            f"the chair with {mass:g} kg on it, and how far it is from the nearest edge, when "
            "that is least.",
            partial(_draw_support, scenario, instants),
            (6.6, 4.0),
        ),
        Figure(
            "fig17_branch_forces",
            f"Forces of the branches under {mass:g} kg",
            "Forces on branches that give, by legs: above with branches that are all as stiff, "
            f"below with UPS branches {softness:.2f} times as stiff as UP branches, which would "
            f"explain that {PAPER_PAYLOAD:g} kg are the most (Fig. 17 has the motors' currents). "
            "Dotted: the actuators' thrust.",
            partial(_draw_forces, scenario, instants),
            (10.0, 4.4),
        ),
    )


def _by_phase(instants: list[Instant], values: Floats) -> tuple[Floats, Floats]:
    """Times and values with a gap between two phases, where they may jump."""
    time = np.array([instant.time for instant in instants])
    changes = [i + 1 for i, (a, b) in enumerate(pairwise(instants)) if a.phase != b.phase]
    gaps = np.full((len(changes), *values.shape[1:]), np.nan)
    return np.insert(time, changes, np.nan), np.insert(values, changes, gaps, axis=0)


def _draw_payload(
    scenario: ChairPayloadScenario, instants: list[Instant], canvas: "Canvas"
) -> None:
    axes = canvas.subplots()
    for name, label in (
        ("friction", f"friction {scenario.friction:g}"),
        ("frictionless", "no friction"),
    ):
        masses = np.array([getattr(instant, name).mass for instant in instants])
        axes.plot(*_by_phase(instants, masses), label=label)
    axes.axhline(PAPER_PAYLOAD, color="black", linewidth=0.9, linestyle="dashed", label="paper")
    for end in scenario.walk.ends[:-1]:
        axes.axvline(end, color="0.9", linewidth=0.8, zorder=0)
    axes.set_xlim(0.0, scenario.walk.duration)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("largest payload [kg]")
    canvas.legend(
        *axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )


def _draw_support(
    scenario: ChairPayloadScenario, instants: list[Instant], canvas: "Canvas"
) -> None:
    walk = scenario.walk
    support = GaitSupport(scenario.machine.geometry, walk, scenario.machine.masses)
    phases_shown = [walk.phases.index(name) for name in (FIRST_SWING, SECOND_SWING)]
    panels: Any = canvas.subplots(1, len(phases_shown), sharex=True, sharey=True)
    for axes, phase in zip(panels, phases_shown, strict=True):
        name = walk.phases[phase]
        polygon = support.polygon(phase)
        placed = min(
            (_placed(scenario, instant) for instant in instants if instant.phase == name),
            key=lambda placed: polygon.margin(placed.centre[:2]),
        )
        for leg, stands in enumerate(walk.standing[phase]):
            if stands:
                outline = 1e3 * placed.feet[leg, :, :2]
                axes.fill(*outline.T, color=COLOURS[0], alpha=0.25, linewidth=0.0)
                x, y = outline.mean(axis=0)
                axes.annotate(f"{leg + 1}", (x, y), ha="center", va="center", fontsize=8)
        axes.fill(*1e3 * polygon.corners.T, facecolor="none", edgecolor=_RED, linewidth=1.2)
        _draw_margin(axes, polygon, placed.centre[:2])
        margin = 1e3 * polygon.margin(placed.centre[:2])
        axes.set_title(f"{name}, {placed.time:.1f} s: {margin:.1f} mm", fontsize=_PANEL)
        axes.set_aspect("equal")
        axes.set_xlabel("x [mm]")
    panels[0].set_ylabel("y [mm]")


class _Placed(NamedTuple):
    """The chair at an instant: corners (4, 3, 3) of its feet and its centre of mass [m]."""

    time: float
    feet: Floats
    centre: Floats


def _placed(scenario: ChairPayloadScenario, instant: Instant) -> _Placed:
    body = np.asarray(scenario.walk.motion(scenario.machine.geometry, instant.time).body.position)
    feet = instant.stand.corners.reshape(LEG_COUNT, 3, 3)
    _, centre = centre_of_mass(
        scenario.machine.masses, scenario.payload.passenger, feet.mean(axis=1)
    )
    return _Placed(instant.time, body + feet, body + centre)


def _draw_margin(axes: Any, polygon: SupportPolygon, centre: Floats) -> None:
    """The centre of mass, and a line from it to the nearest edge."""
    distances = polygon.offsets - polygon.normals @ centre
    nearest = int(np.argmin(distances))
    edge = centre + distances[nearest] * polygon.normals[nearest]
    axes.plot(*1e3 * np.array((centre, edge)).T, color="black", linewidth=1.0)
    axes.plot(*1e3 * centre, marker="o", color="black", markersize=5)


def _draw_forces(
    scenario: ChairPayloadScenario, instants: list[Instant], canvas: "Canvas"
) -> None:
    labels = ("all as stiff", f"UPS {paper_stiffness(scenario):.2f} times")
    rows: Any = canvas.subplots(2, LEG_COUNT, sharex=True, sharey=True)
    for row, name, label in zip(rows, ("equal", "soft"), labels, strict=True):
        forces = np.array([getattr(instant, name).branch_forces for instant in instants])
        time, values = _by_phase(instants, forces.reshape(-1, LEG_COUNT, 3))
        for leg, axes in enumerate(row):
            for branch, style in enumerate(_STYLES):
                axes.plot(time, values[:, leg, branch], **style)
            axes.axhline(scenario.machine.drives.max_force_N, **_LIMIT)
            for end in scenario.walk.ends[:-1]:
                axes.axvline(end, color="0.9", linewidth=0.8, zorder=0)
        row[0].set_ylabel(f"{label}\nforce [N]")
    for leg, axes in enumerate(rows[0]):
        axes.set_title(f"leg {leg + 1}", fontsize=_PANEL)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, scenario.walk.duration)
    names = ("UP branch", "UPS branch 2", "UPS branch 3")
    handles = rows[0, 0].get_lines()[: len(names)]
    canvas.legend(handles, names, loc="outside upper center", ncols=3, fontsize=8)


def _notes(scenario: ChairPayloadScenario, metrics: tuple[Metric, ...]) -> tuple[str, ...]:
    values = {metric.key: metric.value for metric in metrics}
    best = values["payload_frictionless_kg"]
    if best < PAPER_PAYLOAD:
        return ()
    return (
        f"The paper's {PAPER_PAYLOAD:g} kg are not what the best distribution of forces carries, "
        f"{best:.0f} kg and more. They lie between that and the "
        f"{values['payload_on_up_branches_kg']:.1f} kg of feet that press on the ground under "
        f"their UP branches alone.",
        "It is the payload at which a UP branch with "
        f"{100.0 * paper_share(scenario):.0f} % of its leg's load reaches its thrust while two "
        f"legs stand. UPS branches that are {paper_stiffness(scenario):.2f} times as stiff would "
        "explain that share, and the paper's remark that branch 1 of each leg takes the largest "
        "current; that is a fit and no measurement.",
    )
