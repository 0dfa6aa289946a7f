"""Mechanisms posed numerically: a hexapod one pose at a time, in rows, and on its page."""

import os
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat

from benchmarks.factor import rate
from benchmarks.report import Measurement
from benchmarks.yardstick import NUMPY, Pace, clock
from parapod.sims.lab.panel import Panel
from parapod.sims.lab.poser import PosePage, Poser
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.model import add_model

HEXAPOD = Path(__file__).parents[1] / "examples" / "mechanisms" / "hexapod" / "hexapod.urdf"
# Poses one by one, in rows, and frames of the page.
_ONE, _ROWS, _FRAMES = 500, 100_000, 200
_SPREAD = np.array((0.03, 0.03, 0.03, 0.1, 0.1, 0.1))
_MIDDLE = np.array((0.0, 0.0, 0.45, 0.0, 0.0, 0.0))


def run() -> list[Measurement]:
    started = clock()
    mechanism = Mechanism.load(HEXAPOD)
    loaded = clock() - started
    started = clock()
    counted = mechanism.mobility.freedoms
    counting = clock() - started
    angle = np.linspace(0.0, 2.0 * np.pi, _ONE)
    path = _MIDDLE + _SPREAD * np.sin(np.outer(angle, (1, 2, 3, 2, 1, 3)))

    def inverse() -> list[np.ndarray]:
        q, poses = mechanism.home, []
        for goal in path:
            q = mechanism.inverse("platform", goal, q)
            poses.append(q)
        return poses

    poses = inverse()
    motors = mechanism.motor_positions(np.array(poses))

    def forward() -> None:
        q = poses[0]
        for goal in motors:
            q = mechanism.forward(goal, q)

    random = np.random.default_rng(0)
    goals = _MIDDLE + _SPREAD * random.uniform(-1.0, 1.0, (_ROWS, 6))
    lengths = mechanism.motor_positions(mechanism.inverse_rows("platform", goals)[0])
    one, pace_one = rate(inverse, _ONE, NUMPY)
    back, pace_back = rate(forward, _ONE, NUMPY)
    rows, pace_rows = rate(lambda: mechanism.inverse_rows("platform", goals), _ROWS, NUMPY)
    ahead, pace_ahead = rate(lambda: mechanism.forward_rows(lengths), _ROWS, NUMPY)
    frames, pace_frames = _page()
    return [
        Measurement("hexapod: file read", loaded, "s", 2.0, at_most=True),
        Measurement(f"hexapod: {counted} freedoms counted", 1e3 * counting, "ms"),
        Measurement("hexapod: inverse, next pose of a path", one / 1e3, "k/s", 1.0, pace=pace_one),
        Measurement("hexapod: forward, next pose", back / 1e3, "k/s", 1.0, pace=pace_back),
        Measurement(
            "hexapod: inverse in rows, from home", rows / 1e3, "k/s", 100.0, pace=pace_rows
        ),
        Measurement("hexapod: forward in rows, from home", ahead / 1e3, "k/s", pace=pace_ahead),
        Measurement("hexapod: frames of the page", frames, "1/s", 30.0, pace=pace_frames),
    ]


def _page() -> tuple[float, Pace]:
    """Frames a second of the page, a slider moving, without a browser."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    meshcat = Meshcat()
    poser = Poser(lambda plant: add_model(plant, HEXAPOD), "platform", meshcat)
    panel = Panel(meshcat, "pose")
    page = PosePage(poser, panel)

    def move() -> None:
        for k in range(_FRAMES):
            panel.SetSliderValue("leg_1 [mm]", 30.0 * np.sin(0.1 * k))
            page.look()

    measured = rate(move, _FRAMES, NUMPY)
    panel.close()
    return measured
