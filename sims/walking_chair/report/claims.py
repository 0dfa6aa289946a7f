"""Every number that the walking chair's paper prints, and the same number here."""

from collections.abc import Callable

import numpy as np

from parapod.sims.report.chapter import Claim, Numbers, Relation
from parapod.systems.walking_chair.checks import SPEED_LIMIT
from parapod.systems.walking_chair.gait import TrotGait, gait_branches
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.payload import FORCE_LIMIT, PayloadEstimatorParams
from parapod.systems.walking_chair.trajectories import FootCircle, FootTrajectory

_CHAIR, _GAIT = ChairGeometry(), TrotGait()
_LEG = _CHAIR.leg
_HEIGHT = _LEG.retracted_height


def _constant(value: float) -> Callable[[Numbers], float]:
    return lambda _: value


def _of(part: str, key: str, scale: float = 1.0) -> Callable[[Numbers], float]:
    return lambda numbers: scale * numbers(part, key)


def _used(
    where: str, what: str, printed: float, unit: str, here: float, remark: str = ""
) -> Claim:
    return Claim(where, what, printed, unit, _constant(here), Relation.USED, remark=remark)


def _dimensions() -> tuple[Claim, ...]:
    """Table 1, Figs. 3 and 4, and the text beside them."""
    table = (
        ("A", 200.0, _LEG.a),
        ("B", 120.0, _LEG.b),
        ("t_1", 10.0, _LEG.t1),
        ("t_2", 10.0, _LEG.t2),
        ("d_1", 21.0, _LEG.d1),
        ("d_2", 23.0, _LEG.d2),
        ("d_3", 25.0, _LEG.d3),
        ("d_4", 44.0, _LEG.d4),
        ("d_5", 20.0, _LEG.d5),
        ("d_6", 62.0, _LEG.d6),
    )
    places = _CHAIR.placements[2]
    return (
        *(_used("Table 1", name, printed, "mm", 1e3 * here) for name, printed, here in table),
        Claim("Table 1", "range of the actuators", "441 to 741", "mm",
              _constant(1e3 * _LEG.actuator_min - 441.0), Relation.EQUAL, 1e-9,
              show=lambda _: f"{1e3 * _LEG.actuator_min:g} to {1e3 * _LEG.actuator_max:g} mm"),
        _used("Fig. 4", "c_1 = c_3", 155.0, "mm", 1e3 * abs(places.x), "to what is assumed"),
        _used("Fig. 4", "c_2 = c_4", 142.3, "mm", 1e3 * abs(places.y), "to what is assumed"),
    )  # fmt: skip


def _gait() -> tuple[Claim, ...]:
    """The section on the gait, and Fig. 8."""
    where, part = "trotting gait simulation", "chair-gait"
    at_end = gait_branches(_CHAIR, _GAIT, 25.0).length
    lift = _GAIT.lift
    swing = FootTrajectory(_GAIT.step, _GAIT.swing_height, _GAIT.phase_duration)
    peak = float(swing.motion(0.5 * _GAIT.phase_duration).position[2])
    ends = float(np.abs(swing.motion(_GAIT.phase_duration).velocity).max())
    return (
        Claim(where, "initial height H_0", 665.4, "mm", _constant(1e3 * _HEIGHT)),
        _used(where, "step S_0", 102.7, "mm", 1e3 * _GAIT.step),
        _used(where, "period T_m", 5.0, "s", _GAIT.phase_duration),
        Claim("Eq. (44)", "largest height of the foot, H", 100.0, "mm", _constant(1e3 * peak)),
        Claim("Eq. (44)", "velocity of the foot when it lands", 0.0, "mm/s", _constant(1e3 * ends),
              tolerance=1e-9),
        Claim("Eq. (45)", "lift of the body after 5 s", 114.7, "mm", _constant(1e3 * lift),
              remark="22.94 mm/s in the paper"),
        Claim("Eq. (45)", "steps of the branches' velocity", 22.94, "mm/s",
              _of(part, "velocity_step_printed_mm_s"), tolerance=1e-3,
              remark="the paper calls the velocity discontinuous; a smooth law has none"),
        Claim("Fig. 8", "lengths of the UP branches within 591.4 to 891.4 mm: smallest", 591.4,
              "mm", _of(part, "up_shortest_mm"), tolerance=1e-6),
        Claim("Fig. 8", "lengths of the UPS branches within 574 to 874 mm: smallest", 574.0, "mm",
              _of(part, "ups_shortest_mm"), Relation.AT_LEAST),
        Claim("Fig. 8", "velocities of all branches", 80.0, "mm/s",
              _of(part, "max_branch_speed_mm_s"), Relation.AT_MOST, remark="a limit, not a value"),
        Claim("Fig. 8", "the chair is back at its initial height", 591.4, "mm",
              _constant(1e3 * float(at_end[0, 0])), tolerance=1e-6),
    )  # fmt: skip


def _control() -> tuple[Claim, ...]:
    """The experiment with one leg."""
    part, circle = "chair-circle", FootCircle()
    lengths = 1e3 * leg_inverse(_LEG, circle.motion(np.linspace(0.0, 5.0, 501)).position)
    return (
        _used("Eq. (49)", "radius of the circle", 100.0, "mm", 1e3 * circle.radius),
        _used("Eq. (49)", "height of the circle", -675.4, "mm", 1e3 * circle.z),
        Claim("Fig. 14", "largest error of the radius", 2.454, "mm",
              _of(part, "radial_error_compound_mm"), Relation.AT_MOST, is_measured=True,
              remark="control alone; .5 mm of play or homing in a branch make 2.454 mm"),
        Claim("Fig. 14", "the error does not accumulate", "“not accumulated”", "",
              _of(part, "growth_compound_mm"), tolerance=0.05,
              show=lambda numbers: f"{numbers(part, 'growth_compound_mm'):.1g} mm in three laps"),
        Claim("Fig. 11", "lengths of the branches within their stroke", 574.0, "mm",
              _constant(float(lengths[:, 1:].min())), Relation.AT_LEAST),
    )  # fmt: skip


def _payload() -> tuple[Claim, ...]:
    """The experiments with passengers."""
    params = PayloadEstimatorParams()
    return (
        _used("Fig. 19", "weight of the chair", 49.2, "kg", ChairMasses().total),
        _used("Eq. (53)", "thrust F_N of an actuator", 427.3, "N", FORCE_LIMIT),
        _used("speed of an actuator", "largest", 80.0, "mm/s", 1e3 * SPEED_LIMIT),
        _used("Fig. 17", "rated current", 3.0, "A", FORCE_LIMIT / params.force_per_current),
        Claim("Fig. 17", "largest payload, by the rated current", 57.0, "kg",
              _of("chair-payload", "payload_frictionless_kg"), Relation.AT_LEAST,
              remark="the best distribution of forces without friction; a foot on E_1 alone 37.9"),
        Claim("conclusions", "payload by weight", 1.16, "",
              _constant(Passenger().mass / ChairMasses().total), tolerance=5e-3),
        Claim("Fig. 17", "largest current with 57 kg", 3.0, "A",
              _of("chair-walk", "peak_force_N", 1.0 / params.force_per_current), Relation.AT_MOST,
              is_measured=True,
              remark="branches that are equally stiff; the paper's branches 1 carry more"),
        Claim("Fig. 17", "branches 2 and 3 of a leg move", "“the same”", "",
              _of("chair-gait", "ups_difference_mm"), tolerance=1e-6,
              show=lambda numbers: f"{numbers('chair-gait', 'ups_difference_mm'):.0e} mm apart"),
        Claim("section on experiments", "walk with a passenger", "“smooth motion”", "",
              _of("chair-walk", "tilt_deg"), tolerance=0.1,
              show=lambda numbers: f"tilt {numbers('chair-walk', 'tilt_deg'):.1g} deg"),
    )  # fmt: skip


CLAIMS = (*_gait(), *_control(), *_payload(), *_dimensions())
