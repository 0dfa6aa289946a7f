"""Public problems with closed loops: parameters, sources, and results to compare with.

Andrews    seven bodies, three planar loops, a spring and a motor: published to 14 digits
Bricard    five rods, six hinges, one constraint too many, one freedom: the exact motion
four-bar   rods of equal length through both singular positions: closed form
crank      flexible slider-crank, its rod a chain of rigid lumps: the exact motion of the chain
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ellipj, ellipk  # type: ignore[import-untyped]

from benchmarks.linkage import (
    TOLERANCE,
    ExactMotion,
    Floats,
    Link,
    Linkage,
    Motion,
    Point,
    Spring,
    Vector,
)

_O: Vector = (0.0, 0.0, 0.0)
_X: Vector = (1.0, 0.0, 0.0)
_Y: Vector = (0.0, 1.0, 0.0)
_Z: Vector = (0.0, 0.0, 1.0)
_G = 9.81  # acceleration of free fall of both IFToMM problems [m/s2]
# Inertia of a planar link about axes in its plane, by that about the normal, which alone matters.
_IN_PLANE = 0.5


@dataclass(frozen=True)
class Problem:
    """A linkage with results to compare with.

    Attributes:
        linkage: the linkage, with its beginning.
        end: duration [s].
        samples: number of samples, at equal distances.
        steps: steps of engines with steps of one length [s]; all of them meet the samples.
        quantity: error that is measured, and its unit.
        wanted: error that a run is allowed where settings are compared by their speed.
        measure: gives the quantities (k) for the exact motion's geometry and positions (m).
        results: gives the quantities (r, k) at the last r samples.
        is_conservative: true if the energy is constant.
        tolerance: tolerance of the exact motion.
    """

    linkage: Linkage
    end: float
    samples: int
    steps: tuple[float, ...]
    quantity: tuple[str, str]
    wanted: float
    measure: Callable[[ExactMotion, Floats], ArrayLike]
    results: Callable[["Problem"], ArrayLike]
    is_conservative: bool = True
    tolerance: float = TOLERANCE

    @property
    def name(self) -> str:
        return self.linkage.name

    @property
    def times(self) -> Floats:
        """(n) times of the samples [s]."""
        return np.linspace(0.0, self.end, self.samples + 1)[1:]

    @cached_property
    def exact(self) -> ExactMotion:
        return ExactMotion(self.linkage)

    @cached_property
    def exact_motion(self) -> Motion:
        """Exact motion at the samples; not for one through singular positions."""
        return self.exact.integrate(self.times, self.tolerance)

    @cached_property
    def expected(self) -> Floats:
        """(r, k) quantities at the last r samples."""
        return np.asarray(self.results(self))

    def measured(self, motion: Motion) -> Floats:
        """(n, k) quantities of a motion."""
        return np.array([self.measure(self.exact, q) for q in motion.q])

    def error(self, motion: Motion) -> float:
        """Largest error of a quantity at a sample; infinite for a motion that is not finite."""
        if not np.isfinite(motion.q).all():
            return math.inf
        quantities = self.measured(motion)[-len(self.expected) :]
        return float(np.abs(quantities - self.expected).max())

    def energies(self, motion: Motion) -> Floats:
        """(n) energies, by that in the beginning [J]."""
        start = self.exact.energy(*self.exact.start)
        pairs = zip(motion.q, motion.v, strict=True)
        return np.array([self.exact.energy(q, v) for q, v in pairs]) - start


def _planar(moment: float) -> Vector:
    return (_IN_PLANE * moment, _IN_PLANE * moment, moment)


# Andrews' squeezing mechanism. Parameters, beginning and solution are those of the Test Set for
# Initial Value Problem Solvers (F. Mazzia and C. Magherini, University of Bari, release 2.4); it
# has the parameters from W. Schiehlen, Multibody Systems Handbook, Springer, 1990; `andrews` of
# R's package deTestSet has the same. Its angles are those of the joints here.
_ANDREWS_BEGIN = {
    "OF": -0.0617138900142764496358948458001,
    "FE": 0.0,
    "BDE": 0.455279819163070380255912382449,
    "EG": 0.222668390165885884674473185609,
    "AG": 0.487364979543842550225598953530,
    "HE": -0.222668390165885884674473185609,
    "AH": 1.23054744454982119249735015568,
}
# Angles [rad] and rates [rad/s] at .03 s.
ANDREWS_END = {
    "OF": 15.81077119629904,
    "FE": -15.75637105984298,
    "BDE": 0.04082224013073101,
    "EG": -0.5347301163226948,
    "AG": 0.5244099658805304,
    "HE": 0.5347301163226948,
    "AH": 1.048080741042263,
}
ANDREWS_RATES = {
    "OF": 1139.920302151208,
    "FE": -1424.379294994111,
    "BDE": 11.03291221937134,
    "EG": 19.29337464421385,
    "AG": 0.5735699284790808,
    "HE": -19.29337464421385,
    "AH": 0.3231791658026955,
}
# Accelerations of the first two joints in the beginning; all others have none [rad/s2].
ANDREWS_ACCELERATIONS = (14222.4439199541138705911625887, -10666.8329399655854029433719415)
_A: Vector = (-0.06934, -0.00227, 0.0)
_B: Vector = (-0.03635, 0.03273, 0.0)
_C: Vector = (0.014, 0.072, 0.0)
_TORQUE = 0.033  # torque of the motor [N m]


def _andrews() -> Linkage:
    def link(
        name: str,
        parent: str,
        joint: Vector,
        mass: float,
        centre: Vector,
        moment: float,
        torque: float = 0.0,
    ) -> Link:
        begin = _ANDREWS_BEGIN[name]
        inertia = _planar(moment)
        return Link(name, parent, joint, _Z, mass, centre, inertia, position=begin, torque=torque)

    links = (
        link("OF", "", _O, 0.04325, (0.00092, 0.0, 0.0), 2.194e-6, _TORQUE),
        link("FE", "OF", (0.007, 0.0, 0.0), 0.00365, (-0.0115, 0.0, 0.0), 4.410e-7),
        link("BDE", "", _B, 0.02373, (0.01043, -0.01874, 0.0), 5.255e-6),
        link("AG", "", _A, 0.0705, (0.02308, 0.00916, 0.0), 1.169e-5),
        link("EG", "AG", (0.04, 0.0, 0.0), 0.00706, (0.0, 0.01421 - 0.02, 0.0), 5.667e-7),
        link("AH", "", _A, 0.05498, (-0.00449, -0.01228, 0.0), 1.912e-5),
        link("HE", "AH", (0.0, -0.04, 0.0), 0.00706, (0.02 - 0.01421, 0.0, 0.0), 5.667e-7),
    )
    meeting = Point("FE", (-0.028, 0.0, 0.0))
    others = (
        Point("BDE", (0.0, -0.035, 0.0)),
        Point("EG", (0.0, -0.02, 0.0)),
        Point("HE", (0.02, 0.0, 0.0)),
    )
    spring = Spring(Point("BDE", (0.02, -0.018, 0.0)), Point("", _C), 4530.0, 0.07785)
    closures = tuple((meeting, other) for other in others)
    return Linkage("Andrews' squeezer", links, closures, spring=spring)


ANDREWS = Problem(
    _andrews(),
    end=0.03,
    samples=30,
    steps=(2e-6, 5e-6, 1e-5, 2e-5, 5e-5, 1e-4, 2e-4),
    quantity=("error of an angle", "rad"),
    wanted=0.02,
    measure=lambda _, q: q,
    results=lambda problem: [[ANDREWS_END[link.name] for link in problem.linkage.links]],
)


# Bricard's mechanism, problem A04 of the IFToMM library of multibody benchmarks (M. González et
# al., lim.ii.udc.es/mbsbenchmark): rods along edges of a cube, hinged at its corners, with axes
# along the edges that both rods leave free. The square section of .1 m is that of OpenSim's model
# (L. Tagliapietra et al., github.com/RehabEngGroup/MBSbenchmarksInOpenSim) and of Exudyn's.
_SECTION = 0.1
# Distance of two points on the last hinge's axis that coincide [m].
_HINGE = 0.1
P3 = Point("P2P3", (0.0, 0.0, 1.0))


def _rod(
    name: str, parent: str, joint: Vector, axis: Vector, way: Vector, rate: float = 0.0
) -> Link:
    """A rod of 1 m and 1 kg that begins at a joint and goes a way along an axis of its frame."""
    along = _SECTION**2 / 6.0
    across = (1.0 + _SECTION**2) / 12.0
    inertia = [along if step else across for step in way]
    centre = (0.5 * way[0], 0.5 * way[1], 0.5 * way[2])
    return Link(
        name, parent, joint, axis, 1.0, centre, (inertia[0], inertia[1], inertia[2]), rate=rate
    )


def _bricard() -> Linkage:
    down, aside, away = (0.0, -1.0, 0.0), _Z, _X
    links = (
        _rod("P0P1", "", _O, _Y, away),
        _rod("P1P2", "P0P1", away, _Z, down),
        _rod("P2P3", "P1P2", down, _X, aside),
        _rod("P5P4", "", aside, _X, down),
        _rod("P4P3", "P5P4", down, _Z, away),
    )
    closures = tuple(
        (Point("P2P3", (0.0, y, 1.0)), Point("P4P3", (1.0, y, 0.0))) for y in (0.0, _HINGE)
    )
    return Linkage("Bricard's six-bar", links, closures, gravity=(0.0, -_G, 0.0))


BRICARD = Problem(
    _bricard(),
    end=10.0,
    samples=100,
    steps=(2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2),
    quantity=("error of P3", "m"),
    wanted=0.01,
    measure=lambda exact, q: exact.position(q, P3),
    results=lambda problem: problem.measured(problem.exact_motion),
)


# A four-bar with rods of 1 m and 1 kg and one window, as problem A02 of the same library has N of
# them, upright and with 1 m/s in B0 in the beginning. In both horizontal positions it has two
# freedoms for an instant, and could leave the parallelogram for the crossed branch.
B0 = Point("A0B0", (0.0, 1.0, 0.0))
# Square of the rate that it gains on the way down from upright, by 1 - cos(angle) [1/s2]: two
# rods turn about their ends, and one is carried.
_GAIN = 4.0 * _G / (2.0 / 3.0 + 1.0)


def _slim(name: str, parent: str, joint: Vector, way: Vector, rate: float) -> Link:
    inertia = _planar(1.0 / 12.0)
    centre = (0.5 * way[0], 0.5 * way[1], 0.0)
    return Link(name, parent, joint, _Z, 1.0, centre, inertia, rate=rate)


def _four_bar() -> Linkage:
    links = (
        _slim("A0B0", "", _O, _Y, -1.0),
        _slim("B0B1", "A0B0", _Y, _X, 1.0),
        _slim("A1B1", "", _X, _Y, -1.0),
    )
    closures = ((Point("B0B1", _X), Point("A1B1", _Y)),)
    return Linkage("four-bar", links, closures, gravity=(0.0, -_G, 0.0))


def four_bar_angle(t: ArrayLike) -> Floats:
    """Angle of the rods from upright, clockwise [rad].

    With energy conserved its rate is the root of 1 + gain (1 - cos angle), and so half of the
    angle, from hanging down, is an amplitude of Jacobi's elliptic functions.
    """
    fastest = 1.0 + 2.0 * _GAIN
    parameter = 2.0 * _GAIN / fastest
    argument = 0.5 * math.sqrt(fastest) * np.asarray(t, dtype=float) - ellipk(parameter)
    amplitude: Floats = ellipj(argument, parameter)[3]
    return math.pi + 2.0 * amplitude


def four_bar_rate(angle: ArrayLike) -> Floats:
    """Rate of the rods at an angle from upright [rad/s]."""
    return np.sqrt(1.0 + _GAIN * (1.0 - np.cos(angle)))


def _four_bar_results(problem: Problem) -> Floats:
    angle = four_bar_angle(problem.times)
    return np.column_stack((np.sin(angle), np.cos(angle), np.zeros_like(angle)))


def coupler_angle(motion: Motion) -> float:
    """Largest angle of the four-bar's coupler, which is zero on its branch [rad]."""
    return float(np.abs(motion.q[:, 0] + motion.q[:, 1]).max())


FOUR_BAR = Problem(
    _four_bar(),
    end=10.0,
    samples=200,
    steps=(2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2),
    quantity=("error of B0", "m"),
    wanted=1e-3,
    measure=lambda exact, q: exact.position(q, B0),
    results=_four_bar_results,
)


# The flexible slider-crank of the same test set (B. Simeon, Math. Modelling of Systems 2, 1996,
# 1-18): the crank turns at 150 rad/s, its rod of steel bends. The test set has two modes of a
# linear beam and its stretch; the rod here is a chain of rigid lumps, with springs between them. A
# flywheel keeps the rate, which the test set prescribes.
_CRANK, _LENGTH = 0.15, 0.30
_ROD_MASS, _SLIDER_MASS, _BENDING = 0.151104, 0.075552, 0.20e12 * 0.0080**4 / 12.0
_RATE, _FLYWHEEL = 150.0, 1e4
# Rates of both modes of the rod in the beginning [m/s].
_MODE_RATES = (0.4448961125815990, 0.004634339319238670)
# Deflection of the rod's middle at .1 s in the test set, where it is the first mode's [m].
CRANK_DEFLECTION = 1.893192899613509e-4
# Number of lumps; with twelve the largest deflection is 3 % less.
_LUMPS = 4


def _crank() -> Linkage:
    size, mass = _LENGTH / _LUMPS, _ROD_MASS / _LUMPS
    x = np.linspace(0.0, _LENGTH, _LUMPS + 1)
    modes = [np.sin((k + 1) * math.pi * x / _LENGTH) for k in range(2)]
    bent = np.diff(_MODE_RATES[0] * modes[0] + _MODE_RATES[1] * modes[1]) / size
    rates = np.diff(np.append(_RATE, bent - _RATE * _CRANK / _LENGTH))
    wheel = (_FLYWHEEL, _FLYWHEEL, _FLYWHEEL)
    links = [Link("crank", "", _O, _Z, 0.36, _O, wheel, rate=_RATE)]
    for k, rate in enumerate(rates):
        parent, joint = (f"rod {k}", size) if k else ("crank", _CRANK)
        links.append(
            Link(
                f"rod {k + 1}",
                parent,
                (joint, 0.0, 0.0),
                _Z,
                mass,
                (0.5 * size, 0.0, 0.0),
                _planar(mass * size**2 / 12.0),
                rate=rate,
                stiffness=_BENDING / size if k else 0.0,
            )
        )
    slider = Link("slider", "", _O, _X, _SLIDER_MASS, _O, _planar(1e-4), slides=True)
    links.append(replace(slider, position=_CRANK + _LENGTH))
    closure = (Point(f"rod {_LUMPS}", (size, 0.0, 0.0)), Point("slider", _O))
    return Linkage("flexible slider-crank", tuple(links), (closure,), freedoms=_LUMPS)


def _deflection(exact: ExactMotion, q: Floats) -> list[float]:
    """Deflection of the rod's middle from the line between its ends [m]."""
    middle = Point(f"rod {_LUMPS // 2}", (_LENGTH / _LUMPS, 0.0, 0.0))
    points = (Point("rod 1", _O), middle, Point("slider", _O))
    begin, bent, end = (exact.position(q, point)[:2] for point in points)
    (x, y), (u, v) = (end - begin) / np.linalg.norm(end - begin), bent - begin
    return [float(x * v - y * u)]


CRANK = Problem(
    _crank(),
    end=0.1,
    samples=20,
    steps=(5e-6, 1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4),
    quantity=("error of the deflection", "m"),
    wanted=3e-5,
    measure=_deflection,
    results=lambda problem: problem.measured(problem.exact_motion),
    is_conservative=False,
    tolerance=1e-9,
)

PROBLEMS = (ANDREWS, BRICARD, FOUR_BAR, CRANK)
