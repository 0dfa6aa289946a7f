"""Dimensions of the terrain simulator (Figures 3 and 4, Table 2)."""

import math
from dataclasses import dataclass, fields
from functools import cached_property


@dataclass(frozen=True)
class BenchGeometry:
    """A bench: three sliders on a rail, two links to the pivot P, one to the pivot T, a plate.

    The base frame has x along the rail, to the front, and z up; its third axis goes into the page.
    The plate's middle O' is its origin, x' leads from its rear end Q to its front end T. A pose is
    x, z of O' and the angle phi of the plate: phi > 0 is front end down. The links A_1 P and A_2 P
    are equally long.

    Attributes:
        link: length l_1 = l_2 of the links A_1 P and A_2 P [m].
        strut: length l_3 of the link A_3 T [m].
        lever: length l_4 from P to T [m].
        plate: length l_5 from Q to T [m].
        offset: angle alpha of the plate against P T [rad].
        strut_ahead: true if A_3 is ahead of T; the paper has a branch of either sign, and with the
            other one each bench has no workspace.
        slider_min: place of each slider at the rear end of its rail [m].
        slider_max: place at the front end [m].
        gap: least distance of A_1 and A_2, which a stop keeps apart [m].
        strut_gap: least distance from A_2 to A_3 if they share a rail [m]; None if A_3 passes A_2
            on a rail of its own.
        floor: least height of the pivots P and T; the paper asks for one and names none [m].
        belt: true if the plate is a treadmill.
    """

    link: float
    strut: float
    lever: float
    plate: float
    offset: float
    strut_ahead: bool
    slider_min: float = 0.08
    slider_max: float = 1.12
    gap: float = 0.1
    strut_gap: float | None = None
    floor: float = 0.02
    belt: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None or isinstance(value, bool):
                continue
            if not math.isfinite(value):
                raise ValueError(f"{field.name} must be finite, not {value!r}")
            if field.name not in ("offset", "slider_min") and not value > 0.0:
                raise ValueError(f"{field.name} must be positive, not {value!r}")
        if not abs(self.offset) < 0.5 * math.pi:
            raise ValueError(f"offset must be within +-pi/2, not {self.offset!r}")
        if not self.slider_min < self.slider_max:
            raise ValueError(
                f"slider_min = {self.slider_min:g} m must be less than "
                f"slider_max = {self.slider_max:g} m"
            )
        if not self.gap < 2.0 * self.link:
            raise ValueError(
                f"gap = {self.gap:g} m must be less than two links, {2.0 * self.link:g} m"
            )

    @classmethod
    def pedal(cls) -> "BenchGeometry":
        """Bench with a pedal, Table 2."""
        return cls(0.30, 0.42, 0.09, 0.12, math.radians(33.0), True, strut_gap=0.1)

    @classmethod
    def treadmill(cls) -> "BenchGeometry":
        """Bench with a treadmill, Table 2.

        There l_5 = 0, against the text and Figure 4, where l_4 = l_5 and alpha = 0; and A_3 must
        pass A_2, or next to nothing is left of the workspace.
        """
        return cls(0.30, 0.45, 0.60, 0.60, 0.0, False, belt=True)

    @property
    def size(self) -> float:
        """Length of the links to P by that of the paper's benches [-]."""
        return self.link / BenchGeometry.pedal().link

    @cached_property
    def p_OP(self) -> tuple[float, float]:
        """Pivot P in the plate's frame [m]: below it."""
        return (
            0.5 * self.plate - self.lever * math.cos(self.offset),
            -self.lever * math.sin(self.offset),
        )

    @cached_property
    def p_OT(self) -> tuple[float, float]:
        """Pivot T in the plate's frame [m]: its front end."""
        return 0.5 * self.plate, 0.0

    @property
    def branch(self) -> float:
        """Sign of the root with which A_3 is found: 1.0 ahead of T, -1.0 behind."""
        return 1.0 if self.strut_ahead else -1.0
