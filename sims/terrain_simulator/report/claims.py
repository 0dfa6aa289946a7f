"""Every number that the terrain simulator's paper prints, and the same number here."""

import math
from collections.abc import Callable

from parapod.sims.report.chapter import Claim, Numbers, Relation
from parapod.sims.terrain_simulator.workspace import BENCHES
from parapod.systems.terrain_simulator.printed import (
    BELT,
    GAP,
    LEVER,
    LINK,
    OFFSET_DEG,
    PLATE,
    RAIL,
    SPECIFICATION,
    STRUT,
)

_PART = "bench-workspace"
_PEDAL, _TREADMILL = (geometry for geometry, _ in BENCHES.values())


def _constant(value: float) -> Callable[[Numbers], float]:
    return lambda _: value


def _key(key: str) -> Callable[[Numbers], float]:
    return lambda numbers: numbers(_PART, key)


def _used(where: str, what: str, printed: float, unit: str, here: float) -> Claim:
    return Claim(where, what, printed, unit, _constant(here), Relation.USED)


def _put_in() -> tuple[Claim, ...]:
    """Table 2 but its l_5, and the speeds, loads and angles of Table 1."""
    claims = []
    for name, (bench, _) in BENCHES.items():
        claims += [
            _used("Table 2", f"{name}, l_1 = l_2", LINK, "m", bench.link),
            _used("Table 2", f"{name}, l_3", STRUT[name], "m", bench.strut),
            _used("Table 2", f"{name}, l_4", LEVER[name], "m", bench.lever),
            _used(
                "Table 2", f"{name}, alpha", OFFSET_DEG[name], "deg", math.degrees(bench.offset)
            ),
        ]
    specification = SPECIFICATION
    turn = math.degrees(specification.speed[2])
    return (
        *claims,
        _used("Table 2", "pedal, l_5", PLATE["pedal"], "m", _PEDAL.plate),
        _used("Table 2", "least distance of sliders", GAP, "m", _PEDAL.gap),
        _used("Table 2", "rear end of the rail", RAIL[0], "m", _PEDAL.slider_min),
        _used("Table 2", "front end of the rail", RAIL[1], "m", _PEDAL.slider_max),
        _used("Fig. 3", "treadmill, from drum to drum", 0.6, "m", _TREADMILL.plate),
        _used(
            "Table 1",
            "rotation of the pedal",
            45.0,
            "deg",
            math.degrees(specification.pedal_angle),
        ),
        _used("Table 1", "rotation of the treadmill", 14.0, "deg",
              math.degrees(specification.treadmill_angle)),
        _used("Table 1", "horizontal speed", 2.75, "m/s", specification.speed[0]),
        _used("Table 1", "vertical speed", 2.5, "m/s", specification.speed[1]),
        _used("Table 1", "angular speed", 900.0, "deg/s", turn),
        _used("Table 1", "horizontal load", 500.0, "N", specification.load[0]),
        _used("Table 1", "vertical load", 1000.0, "N", specification.load[1]),
    )  # fmt: skip


def _found() -> tuple[Claim, ...]:
    """Ranges of Table 1, the offset, and the sentence below Figure 3."""
    specification = SPECIFICATION
    speed, frequency, duty = 2.0, 2.0, 0.5
    return (
        Claim("Table 1", "horizontal range of motion", 1e3 * specification.x_range, "mm",
              _key("least_width_mm"), Relation.AT_LEAST,
              remark="in the orientation that has least, at some height"),
        Claim("Table 1", "vertical range of motion", 1e3 * specification.z_range, "mm",
              _key("least_height_mm"), Relation.MISSING,
              remark="in the orientation that has least; four of six have it"),
        Claim("Table 1", "both at once, in all orientations", len(BENCHES) * 3, "orientations",
              _key("orientations_with_box"), Relation.MISSING),
        Claim("Table 2", "pedal, alpha", OFFSET_DEG["pedal"], "deg", _key("alpha_deg"),
              remark="the largest whole one that the distance of the sliders allows"),
        Claim("Fig. 3", "belt's length over a trot's step at 2 m/s, 2 Hz, duty 0.5", 1.0, "",
              _constant(BELT / (speed * duty / frequency)), Relation.AT_LEAST),
    )  # fmt: skip


CLAIMS = (*_put_in(), *_found())
