"""What the experiment `chair-circle` measures."""

import numpy as np

from parapod.sims.chair_circle_recording import GEOMETRY, SETTLING, Floats, Recording
from parapod.sims.chair_circle_scenario import ChairCircleScenario
from parapod.sims.results import Metric
from parapod.systems.walking_chair.checks import stroke_excess
from parapod.systems.walking_chair.rates import leg_jacobian
from parapod.systems.walking_chair.trajectories import FootCircle

# What the laser tracker found, "comparing the radius" of the trajectories [mm].
PAPER_RADIAL_MM = 2.454
# Of the compound mode, by the time between two nodes [mm/s]: its error is a lag, which goes with
# that time.
_ERROR_BY_PERIOD = 60.0
_COMPOUND_BY_VELOCITY = 0.2
_COMPOUND_BY_POSITION = 0.1
_GROWTH_MM = 0.05
_PLACES = 3601


def error_metrics(
    scenario: ChairCircleScenario, recordings: dict[str, Recording]
) -> tuple[Metric, ...]:
    """Errors of the foot in every mode, and how they compare."""
    errors = {mode: foot_error_mm(recording) for mode, recording in recordings.items()}
    compound = recordings["compound"]
    bounds = {"compound": _ERROR_BY_PERIOD * scenario.control.period}
    metrics = [
        Metric(
            f"foot_error_{mode}_mm",
            error,
            "mm",
            bounds.get(mode),
            meaning=f"largest on the circle from {SETTLING:g} s on, mode {mode}",
        )
        for mode, error in errors.items()
    ]
    metrics.append(
        Metric(
            "compound_by_velocity",
            errors["compound"] / errors["velocity"],
            "",
            _COMPOUND_BY_VELOCITY,
            meaning="these errors: what correcting the velocity by the position is worth",
        )
    )
    metrics += [
        Metric(
            f"largest_error_{mode}_mm",
            1e3 * float(recording.distance.max()),
            "mm",
            paper="at both ends" if mode == "compound" else None,
            meaning=f"of the whole run, its steps of the speed included, mode {mode}",
        )
        for mode, recording in recordings.items()
    ]
    metrics += [
        Metric(
            f"radial_error_{mode}_mm",
            radial_error_mm(recording),
            "mm",
            paper=PAPER_RADIAL_MM if mode == "compound" else None,
            meaning=f"largest of the trajectory's radius on the circle, mode {mode}",
        )
        for mode, recording in recordings.items()
    ]
    if scenario.circle.laps > 1:
        metrics.append(
            Metric(
                "growth_compound_mm",
                _growth_mm(compound, scenario.circle.lap_duration),
                "mm",
                _GROWTH_MM,
                paper=0.0,
                meaning="largest error of the last lap less that of the first, mode compound",
            )
        )
    return tuple(metrics)


def velocity_metrics(
    scenario: ChairCircleScenario, recordings: dict[str, Recording]
) -> tuple[Metric, ...]:
    """How the branches move."""
    ripples = {mode: _ripple_mm_s(recording) for mode, recording in recordings.items()}
    compound = recordings["compound"]
    planned = compound.planned
    limit = scenario.drives.max_velocity_mm_s
    left = -1e3 * float(stroke_excess(GEOMETRY, planned.length).max())
    return (
        *(
            Metric(
                f"ripple_{mode}_mm_s",
                ripple,
                "mm/s",
                paper="little noticeable" if mode == "compound" else None,
                meaning=f"rms of the branches' velocities about the planned ones, mode {mode}",
            )
            for mode, ripple in ripples.items()
        ),
        Metric(
            "ripple_by_position",
            ripples["compound"] / ripples["position"],
            "",
            _COMPOUND_BY_POSITION,
            meaning="these ripples: what leading the drives at a velocity is worth",
        ),
        Metric(
            "planned_branch_speed_mm_s",
            1e3 * float(np.abs(planned.velocity).max()),
            "mm/s",
            limit,
            meaning="largest that the circle asks of a branch",
        ),
        Metric(
            "max_branch_speed_mm_s",
            1e3 * float(np.abs(compound.velocity).max()),
            "mm/s",
            limit,
            meaning="largest of a branch, mode compound",
        ),
        Metric(
            "stroke_left_mm",
            left,
            "mm",
            at_least=0.0,
            meaning="smallest distance of a branch from the ends of its stroke, as planned",
        ),
    )


def sensitivity_metrics(circle: FootCircle) -> tuple[Metric, ...]:
    """What wrong lengths of the branches do to the foot."""
    any_way, radially = sensitivities(circle)
    return (
        Metric(
            "foot_error_by_branch_error",
            any_way,
            meaning="largest of the foot by that of the lengths (root of squares), on the circle",
        ),
        Metric(
            "radial_error_by_branch_error",
            radially,
            meaning="largest of the radius by that of the lengths (root of squares)",
        ),
        Metric(
            "branch_error_for_paper_mm",
            PAPER_RADIAL_MM / radially,
            "mm",
            meaning="of the lengths (root of squares) that can explain the paper's radial error",
        ),
    )


def sensitivities(circle: FootCircle) -> tuple[float, float]:
    """Largest error of the foot, and of its radius, by a unit of error of the lengths.

    The first is the largest singular value of J^-1, which is in the direction that suits it; the
    second the largest norm of the row of J^-1 along the radius.
    """
    time = np.linspace(0.0, circle.duration, _PLACES)
    places = circle.motion(time).position
    foot_by_lengths = np.linalg.inv(leg_jacobian(GEOMETRY, places))
    outwards = (places - (0.0, circle.centre_y, circle.z)) / circle.radius
    rows = np.einsum("...i,...ij->...j", outwards, foot_by_lengths)
    any_way = np.linalg.norm(foot_by_lengths, ord=2, axis=(-2, -1)).max()
    return float(any_way), float(np.linalg.norm(rows, axis=-1).max())


def foot_error_mm(recording: Recording) -> float:
    """Largest error of the foot on the circle, the first second left out [mm]."""
    return 1e3 * float(recording.distance[recording.is_settled].max())


def radial_error_mm(recording: Recording) -> float:
    """Largest error of the trajectory's radius on the circle, either way [mm]."""
    return 1e3 * float(np.abs(recording.radial_error[recording.moves]).max())


def _growth_mm(recording: Recording, lap: float) -> float:
    time, distance = recording.time, recording.distance
    first = recording.is_settled & (time <= SETTLING + lap)
    last = recording.moves & (time >= recording.circle.duration - lap)
    return 1e3 * float(distance[last].max() - distance[first].max())


def _ripple_mm_s(recording: Recording) -> float:
    about: Floats = recording.velocity - recording.planned.velocity
    return 1e3 * float(np.sqrt(np.mean(about[recording.is_settled] ** 2)))
