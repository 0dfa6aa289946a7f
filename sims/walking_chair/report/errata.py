"""Misprints in the walking chair's paper, and the computations that show them."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from parapod.sims.report.chapter import Check, Erratum, Numbers
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import branch_lengths, leg_corners, leg_inverse, up_branch
from parapod.systems.walking_chair.printed import (
    printed_angles,
    printed_jacobian,
    printed_point_acceleration,
    printed_point_velocity,
    roots,
)
from parapod.systems.walking_chair.rates import leg_jacobian

_CHAIR = ChairGeometry()
_LEG = _CHAIR.leg
_GAIT = TrotGait()
# A posture away from every symmetry: l_11 [m], alpha, beta [rad].
_UP = np.array((0.70, math.radians(10.0), math.radians(15.0)))
_STEP = 1e-6  # step of central differences [m, s]
_EXACT = 1e-7  # error of differences in an equation that holds


def _corner(number: int) -> NDArray[np.float64]:
    """Corner E_1, E_2 or E_3 in that posture [m]."""
    corner: NDArray[np.float64] = leg_corners(_LEG, _UP)[number - 1]
    return corner


def _roots() -> Check:
    point = _corner(2)
    good = roots(_LEG, point, 1.0, -1.0)
    bad = roots(_LEG, point, -1.0, 1.0)
    error = np.abs(np.array(good) - _UP[1:]).max()
    alpha, beta = np.degrees(bad)
    return Check(
        f"At alpha = 10, beta = 15 deg '+' in Eq. (16) and '-' in Eq. (18) give the angles to "
        f"{error:.0e} rad; the other roots give {alpha:.0f} and {beta:.0f} deg.",
        bool(error < 1e-12 and max(abs(alpha), abs(beta)) > 90.0),
    )


def _half_angles() -> Check:
    point = _corner(2)
    alpha, beta = printed_angles(_LEG, point)
    printed = branch_lengths(_LEG, np.array((_UP[0], alpha, beta)))
    error = 1e3 * (printed - leg_inverse(_LEG, point, "E2"))
    return Check(
        f"With u = tan(alpha / 2) the angle is 2 arctan(u). As printed alpha is off by "
        f"{math.degrees(alpha - _UP[1]):.2f} and beta by {math.degrees(beta - _UP[2]):.2f} deg at "
        f"(10, 15) deg, and with the foot's own rotation about U_11 the UPS branches by "
        f"{error[1]:.2f} and {error[2]:.2f} mm.",
        bool(abs(alpha - _UP[1]) > 1e-3 and abs(beta - _UP[2]) > 1e-3),
    )


def _signs() -> Check:
    times = np.linspace(0.0, _GAIT.duration, 501)
    lengths = gait_branches(_CHAIR, _GAIT, times).length
    tilts = np.degrees(_tilts(times))
    return Check(
        f"In the paper's own gait beta runs from {tilts.min():.2f} to {tilts.max():.2f} deg "
        f"({len(lengths)} instants, all legs).",
        bool(tilts.min() < -8.0 and tilts.max() > 8.0),
    )


def _tilts(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles beta of all legs in the gait (n, 4) [rad]."""
    motion = gait_motion(_CHAIR, _GAIT, times)
    body = np.asarray(motion.body.position)
    from_leg = motion.feet.position - body[:, None, :] - _CHAIR.p_SA
    points = np.einsum("lij,nli->nlj", _CHAIR.R_SA, from_leg)
    tilts: NDArray[np.float64] = up_branch(_LEG, points, motion.references)[..., 2]
    return tilts


def _spin() -> Check:
    point = _corner(2)
    differences = np.stack(
        [
            (leg_inverse(_LEG, point + s, "E2") - leg_inverse(_LEG, point - s, "E2")) / (2 * _STEP)
            for s in _STEP * np.eye(3)
        ],
        axis=-1,
    )
    printed = np.abs(printed_jacobian(_LEG, _UP) - differences).max()
    exact = np.abs(leg_jacobian(_LEG, point, "E2") - differences).max()
    return Check(
        f"Against differences for E_2 at (10, 15) deg: with Eq. (24) as printed J is off by "
        f"{printed:.1e}, with the foot's spin about the UP branch by {exact:.0e}.",
        bool(printed > 1e-3 and exact < _EXACT),
    )


def _body_velocity() -> Check:
    printed, corrected, differences = printed_point_velocity()
    bad, good = (np.abs(v - differences).max() for v in (printed, corrected))
    return Check(
        f"For a body that turns about all axes, against differences: as printed off by "
        f"{bad:.2g} m/s, corrected by {good:.0e} m/s.",
        bool(bad > 1e-2 and good < _EXACT),
    )


def _body_acceleration() -> Check:
    corrected, differences = printed_point_acceleration()
    good = np.abs(corrected - differences).max()
    return Check(
        f"The printed terms with the body's angular velocity squared are not accelerations: T_1 "
        f"T_3 S(w) and 2 S(w) p' mix frames and lack a velocity. The corrected ones agree with "
        f"differences to {good:.0e} m/s^2.",
        bool(good < 1e-5),
    )


def _impulses() -> Check:
    ends = _GAIT.phase_duration * np.arange(1, 5)
    sides = [gait_branches(_CHAIR, _GAIT, ends, side).velocity for side in ("left", "right")]
    steps = 1e3 * np.abs(sides[1] - sides[0]).max(axis=(1, 2))
    printed_steps = ", ".join(f"{step:.2f}" for step in steps)
    return Check(
        f"At 5, 10, 15 and 20 s the branches' velocities jump by up to {printed_steps} mm/s, "
        "which are impulses of the acceleration; within a phase it is smooth.",
        bool((steps > 4.0).all()),
    )


def _flat_feet() -> Check:
    times = np.linspace(0.0, _GAIT.duration, 501)
    motion = gait_motion(_CHAIR, _GAIT, times)
    body = np.asarray(motion.body.position)
    # The feet's E_1 corners take the way that the reference corners have, as the paper's text
    # does that speaks of E_1 alone.
    corner = _LEG.corners[motion.references[0] - 1]
    shift = np.einsum("lij,lj->li", _CHAIR.R_SA, corner)
    feet = motion.feet.position - shift
    lengths = chair_inverse(_CHAIR, body, np.eye(3), feet, 1)
    lowest = 1e3 * foot_corners(_CHAIR, body, np.eye(3), lengths)[..., 2].min()
    tilt = np.degrees(np.abs(_tilts(times)).max())
    return Check(
        f"A foot beside its hinge is tilted, in this gait by up to {tilt:.1f} deg; given E_1 for "
        f"all legs other corners go {-lowest:.2f} mm into the ground. Flat are the two feet that "
        "carry while the others swing.",
        bool(tilt > 8.0 and lowest < -14.0),
    )


def _symmetry() -> Check:
    times = np.linspace(0.0, _GAIT.duration, 1001)
    lengths = 1e3 * gait_branches(_CHAIR, _GAIT, times).length
    reversed_error = max(
        np.abs(lengths[:, a] - lengths[::-1, b]).max() for a, b in ((0, 3), (1, 2))
    )
    same = np.abs(lengths[:, 0] - lengths[:, 3]).max()
    return Check(
        f"l_1(t) = l_4(25 s - t) and l_2(t) = l_3(25 s - t) to {reversed_error:.0e} mm; at the "
        f"same t legs 1 and 4 differ by up to {same:.0f} mm.",
        bool(reversed_error < 1e-6 and same > 50.0),
    )


def _of_numbers(check: Callable[[], Check]) -> Callable[[Numbers], Check]:
    """A check that needs no experiment."""
    return lambda _: check()


ERRATA = (
    Erratum(
        "Roots", "Eqs. (16), (18)", "both roots are left open",
        "'+' for v and '-' for u, or angles of two arguments", _of_numbers(_roots),
    ),
    Erratum(
        "Half angles", "Eq. (19)", "alpha = arctan(2u), beta = arctan(2v)",
        "alpha = 2 arctan(u), beta = 2 arctan(v)", _of_numbers(_half_angles),
    ),
    Erratum(
        "Signs of the angles", "before Eq. (19)", "v > 0 and u > 0",
        "the angles take both signs", _of_numbers(_signs),
    ),
    Erratum(
        "The foot's spin", "Eq. (24), and so (25) to (27)", "w_11 = n_11 x v / l_11",
        "plus the spin about n_11, which the joint's axes make alpha' sin(beta)",
        _of_numbers(_spin),
    ),
    Erratum(
        "Velocity with a turning body", "Eq. (33)", "-T_1 R_s S(s_p) w_s",
        "+T_1 R_s S(s_p) R_s^T w_s", _of_numbers(_body_velocity),
    ),
    Erratum(
        "Acceleration with a turning body", "Eq. (35)", "terms of different dimensions",
        "T_1 (a_F - a_S - e x r - w x (w x r) - 2 w x v)", _of_numbers(_body_acceleration),
    ),
    Erratum(
        "Smooth accelerations", "conclusion 3 on Fig. 8",
        "the acceleration changes are smooth, without impact",
        "within a phase; between phases the velocity jumps", _of_numbers(_impulses),
    ),
    Erratum(
        "Surface contact", "trotting gait planning", "the feet have surface contact",
        "the two that carry while others swing; otherwise corners and edges",
        _of_numbers(_flat_feet),
    ),
    Erratum(
        "Symmetry of the legs", "conclusion 1 on Fig. 8",
        "legs 1 and 4, 2 and 3 change symmetrically", "with time reversed",
        _of_numbers(_symmetry),
    ),
)  # fmt: skip
