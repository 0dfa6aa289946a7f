"""Batched kinematics: the platform's beside scipy's Newton, and the bench's both ways."""

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root  # type: ignore[import-untyped]

from benchmarks.factor import rate
from benchmarks.report import Measurement
from benchmarks.yardstick import NUMPY, clock
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.terrain_simulator import kinematics as bench

_POSTURES = 500_000
_NEWTON_POSTURES = 300
_BLOCK = 4096  # block that the second cache holds, as in the kinematics
# On one core; unit, floor and aim.
_BOUND = ("M/s", 5.0, 10.0)
_BENCH_BOUND = 2.0


def run() -> list[Measurement]:
    geometry = PlatformGeometry()
    random = np.random.default_rng(0)
    ground = random.uniform(-0.035, 0.035, (_POSTURES, 2))
    posture = np.column_stack(
        (random.uniform(-0.02, 0.02, (_POSTURES, 2)), random.uniform(0.465, 0.490, _POSTURES))
    )
    closed_form, pace = rate(
        lambda: inverse_kinematics(geometry, posture, ground, on_unreachable="nan"),
        *(_POSTURES, NUMPY),
    )
    one_ground, pace_of_one = rate(
        lambda: inverse_kinematics(geometry, posture, ground[0], on_unreachable="nan"),
        *(_POSTURES, NUMPY),
    )
    extension = inverse_kinematics(geometry, posture, ground, on_unreachable="nan")

    reachable = np.flatnonzero(np.isfinite(extension[:, 0]))[:_NEWTON_POSTURES]
    started = clock()
    by_newton = np.array([_newton(geometry, posture[i], ground[i]) for i in reachable])
    newton = len(reachable) / (clock() - started)
    worst = float(np.max(np.abs(by_newton - extension[reachable][:, :3])))
    return [
        Measurement("inverse kinematics, ground of each", closed_form / 1e6, *_BOUND, pace=pace),
        Measurement("inverse kinematics, one ground", one_ground / 1e6, *_BOUND, pace=pace_of_one),
        *_limits(posture, ground),
        Measurement("  times scipy's Newton", closed_form / newton, "x", 100.0),
        Measurement("  largest difference to Newton", worst * 1e9, "nm", 1.0, at_most=True),
        *_bench(),
    ]


def _limits(posture: NDArray[np.float64], ground: NDArray[np.float64]) -> list[Measurement]:
    """Rates that numpy reaches with the sines and cosines only, or moving the numbers only."""
    angles = [np.ascontiguousarray(column) for column in (*posture.T[:2], *ground.T)]
    limits = np.empty((_POSTURES, 4))
    blocks = [slice(start, start + _BLOCK) for start in range(0, _POSTURES, _BLOCK)]

    def turn() -> None:
        for block in blocks:
            for angle in angles:
                np.sin(angle[block])
                np.cos(angle[block])

    def move() -> None:
        for block in blocks:
            for leg in range(4):
                limits[block, leg] = posture[block, leg % 3]

    trigonometric, _ = rate(turn, _POSTURES, NUMPY)
    moving, _ = rate(move, _POSTURES, NUMPY)
    return [
        Measurement("  its sines and cosines alone", trigonometric / 1e6, "M/s"),
        Measurement("  reading and writing alone", moving / 1e6, "M/s"),
    ]


def _bench() -> list[Measurement]:
    geometry = bench.BenchGeometry.pedal()
    random = np.random.default_rng(0)
    # Within reach wherever they are.
    pose = random.uniform((0.40, 0.25, -0.3), (0.58, 0.31, 0.3), (_POSTURES, 3))
    sliders = bench.inverse_kinematics(geometry, pose)
    results = []
    for what, function, inputs in (
        ("terrain simulator, inverse with all limits", bench.inverse_kinematics, pose),
        ("  forward", bench.forward_kinematics, sliders),
        ("  Jacobian", bench.jacobian, pose),
    ):
        pace_here, pace = rate(partial(function, geometry, inputs), _POSTURES, NUMPY)
        results.append(Measurement(what, pace_here / 1e6, "M/s", _BENCH_BOUND, pace=pace))
    worst = float(np.abs(bench.forward_kinematics(geometry, sliders) - pose).max())
    return [
        *results,
        Measurement("  pose there and back", worst * 1e15, "fm, frad", 1000.0, at_most=True),
    ]


def _newton(
    geometry: PlatformGeometry, posture: NDArray[np.float64], ground: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Extensions of legs 1, 2, 3 as the paper's Eqs. (10)-(12) would be inverted numerically."""

    def residual(extension: NDArray[np.float64]) -> NDArray[np.float64]:
        four = np.append(extension, 0.405)
        return forward_kinematics(geometry, four, ground, legs=(0, 1, 2)) - posture

    solution = root(residual, np.full(3, 0.405), method="hybr", tol=1e-12)
    return solution.x
