"""Every number that the machining centres' paper prints, and the same number here."""

import math
from collections.abc import Callable

from parapod.sims.machining_centre.workspace import NAMES
from parapod.sims.report.chapter import Claim, Numbers, Relation
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.printed import (
    CUBE,
    CUBE_HEIGHT,
    MEANS,
    MEANS_ABOVE,
    REACHABLE_PERCENT,
    THRESHOLDS,
)
from parapod.systems.machining_centre.swing import LOCKABLE, LockSet

_TRIPOD, _QUADRUPED = CentreGeometry(3), CentreGeometry(4)
# The paper's grid is not printed; one with which both numbers nearly come out leaves this.
_GRID = 0.003
_PART = "centre-workspace"


def _constant(value: float) -> Callable[[Numbers], float]:
    return lambda _: value


def _used(where: str, what: str, printed: float, unit: str, here: float) -> Claim:
    return Claim(where, what, printed, unit, _constant(here), Relation.USED)


def _put_in() -> tuple[Claim, ...]:
    """Dimensions and settings."""
    where = "section VI-D"
    return (
        _used(where, "r_p", 100.0, "mm", 1e3 * _TRIPOD.platform_radius),
        _used(where, "theta", 45.0, "deg", math.degrees(_TRIPOD.half_angle)),
        _used(where, "r_pattern", 180.0, "mm", 1e3 * _TRIPOD.pattern_radius),
        _used("Eq. (31)", "shortest leg", 390.0, "mm", 1e3 * _TRIPOD.stroke_min),
        _used("Eq. (31)", "longest leg", 650.0, "mm", 1e3 * _TRIPOD.stroke_max),
        *(
            _used(where, f"edge {axis} of the box", printed, "mm", 1e3 * edge)
            for axis, printed, edge in zip("xyz", (1000.0, 1000.0, 500.0), CUBE, strict=True)
        ),
        _used(where, "height of the box", 500.0, "mm", 1e3 * CUBE_HEIGHT),
        _used("section III-B", "psi_p of the tripod", 120.0, "deg",
              math.degrees(_TRIPOD.angles[1])),
        _used("section III-B", "psi_p of the quadruped", 90.0, "deg",
              math.degrees(_QUADRUPED.angles[1])),
        _used("Eq. (23)", "actuators of the tripod", 6, "", _TRIPOD.legs),
        _used("Eq. (23)", "actuators of the quadruped", 8, "", _QUADRUPED.legs),
        *(
            _used("Table I", f"threshold {k} of w_MinMax", printed, "", THRESHOLDS[k])
            for k, printed in enumerate((0.0, 0.08, 0.1, 0.12))
        ),
        _used("Table II", "threshold of the means", 0.08, "", MEANS_ABOVE),
        _used("section V-C", "joints locked in the loose limb", 4, "", len(LOCKABLE)),
        _used("section V-C", "joints locked in the tripod's standing limbs", 2, "",
              len(LockSet.printed(_TRIPOD, 1).standing)),
    )  # fmt: skip


def _reach() -> tuple[Claim, ...]:
    """Table I."""
    claims = []
    for limbs, name in NAMES.items():
        first, *others = REACHABLE_PERCENT[limbs]
        claims.append(
            Claim("Table I", f"{name}, reachable", first, "%", _key(f"{name}_nodes_percent"),
                  Relation.EQUAL, _GRID, remark="with 20 nodes an edge; more where it converges")
        )  # fmt: skip
        for threshold, printed in zip(THRESHOLDS[1:], others, strict=True):
            key = f"{name}_above_{round(1e3 * threshold):03d}_percent"
            claims.append(
                Claim("Table I", f"{name}, w_MinMax > {threshold:g}", printed, "%", _key(key),
                      Relation.MISSING)
            )  # fmt: skip
    return tuple(claims)


def _means() -> tuple[Claim, ...]:
    """Table II."""
    claims = []
    for limbs, name in NAMES.items():
        for symbol, word, printed in zip(
            ("w_MinMax", "w_Max", "eta_w"),
            ("w_minmax", "w_max", "ratio"),
            MEANS[limbs],
            strict=True,
        ):
            is_near = (limbs, word) == (3, "ratio")
            claims.append(
                Claim("Table II", f"{name}, mean {symbol}", printed, "",
                      _key(f"{name}_{word}_mean"),
                      Relation.EQUAL if is_near else Relation.MISSING, 0.01)
            )  # fmt: skip
    return tuple(claims)


def _key(key: str) -> Callable[[Numbers], float]:
    return lambda numbers: numbers(_PART, key)


CLAIMS = (*_put_in(), *_reach(), *_means())
