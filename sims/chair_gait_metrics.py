"""What the experiment `chair-gait` measures."""

import numpy as np

from parapod.sims.chair_gait_motion import Floats, SampledWalk
from parapod.sims.results import Metric
from parapod.systems.walking_chair.checks import SPEED_LIMIT
from parapod.systems.walking_chair.gait import LIFT, LOWER, SHIFT

# Steps that are none but for rounding [mm/s] and [mm/s^2].
_NO_STEP = 1e-6
# Lengths that are equal but for rounding [mm].
_EQUAL_MM = 1e-6
# How far a corner may be below the ground, by rounding [mm].
_BELOW_MM = 1e-3


def gait_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    """Of a walk with the body moved by Eq. (45), and by a smooth law."""
    return (
        *_speed_metrics(printed, smooth),
        *_acceleration_metrics(printed, smooth),
        *_stroke_metrics(printed, smooth),
        *_law_metrics(printed, smooth),
    )


def _speed_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    limit = 1e3 * SPEED_LIMIT
    both = [walk.branches.velocity for walk in (printed, smooth)]
    return (
        Metric(
            "max_branch_speed_mm_s",
            _largest(*both),
            "mm/s",
            limit,
            paper=f"0..{limit:g}",
            meaning="of all branches, with either law",
        ),
        *(
            Metric(
                f"{what}_speed_{law}_mm_s",
                _largest(walk.branches.velocity[walk.during(*phases)]),
                "mm/s",
                limit,
                meaning=f"largest while the body {moves}, {words}",
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
            meaning="largest between two phases, smooth law",
        ),
        Metric(
            "velocity_step_printed_mm_s",
            _largest(printed.velocity_steps),
            "mm/s",
            paper="discontinuous",
            meaning="largest between two phases, Eq. (45)",
        ),
    )


def _acceleration_metrics(printed: SampledWalk, smooth: SampledWalk) -> tuple[Metric, ...]:
    return (
        Metric(
            "swing_acceleration_mm_s2",
            _largest(smooth.branches.acceleration[smooth.swings]),
            "mm/s^2",
            meaning="largest while feet swing, Eqs. (40) and (44)",
        ),
        *(
            Metric(
                f"body_acceleration_{law}_mm_s2",
                _largest(walk.branches.acceleration[~walk.swings]),
                "mm/s^2",
                meaning=f"largest within the body's phases, {words}",
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
            meaning="largest between two phases, smooth law",
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
                meaning=f"of the {words}",
            ),
            Metric(f"{name}_longest_mm", longest, "mm", high_bound, paper=f"<= {high:g}"),
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
            meaning="of all feet's corners, above the ground",
        ),
        Metric(
            "time_reversal_error_mm",
            max(_time_reversal_mm(walk) for walk in walks),
            "mm",
            _EQUAL_MM,
            paper="symmetric",
            meaning="of legs 1 against 4 and 2 against 3, one of them run backwards",
        ),
        Metric(
            "same_time_difference_mm",
            max(_largest(_pairs_differ(walk.branches.length)) for walk in walks),
            "mm",
            meaning="of the same legs at the same time: the symmetry is one of time",
        ),
        Metric(
            "ups_difference_mm",
            max(_largest(np.diff(walk.branches.length[..., 1:], axis=-1)) for walk in walks),
            "mm",
            _EQUAL_MM,
            paper="the same",
            meaning="of each leg's two UPS branches",
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
    """How far one leg of a pair is from the other with the time reversed, in each gait."""
    lengths = walk.branches.length
    ends = np.cumsum([len(gait.phases) for gait in walk.walk.gaits])
    parts = np.split(lengths, np.searchsorted(walk.phase, ends[:-1]))
    return max(_largest(_pairs_differ(part, part[::-1])) for part in parts)
