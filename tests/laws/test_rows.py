"""Row i of many runs is Drake's run i, for every loop of a machine that is installed."""

import random
from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

import parapod
from parapod.diagrams.side_by_side import LoopRows
from parapod.sims.lab.discovery import find_experiment, list_entries
from parapod.sims.lab.experiment import LoopExperiment
from parapod.systems.core.schema import build, plain

UNTIL = {"kinematic": 1.2, "mujoco": 0.3}  # [s]
ROWS = 3
# Rounding of matrix products, which Drake's C++ and NumPy may sum in another order.
RELATIVE = 1e-12


def loops():
    """Experiments with a closed loop, and the plants that their machine has over rows."""
    for entry in list_entries():
        experiment = entry.load()
        if isinstance(experiment, LoopExperiment):
            for backend in UNTIL.keys() & experiment.machine.plants:
                yield entry.name, backend


@cache
def loop_of(name, backend="kinematic"):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    scenario = parapod.scenario(name)
    if backend in find_experiment(name).backends:
        scenario.backend = backend
    loop = parapod.closed_loop(scenario)
    if loop.scenario.backend != backend:
        pytest.skip(f"{name} has no {backend} loop")
    return loop


def varied(loop, row):
    """The loop's scenario with other values of everything that it can be reset to."""
    tree, chance = plain(loop.scenario), random.Random(row)
    for key in loop.machine.resets(loop.scenario):
        if key == "seed":
            tree["seed"] += 7 * row
            continue
        *parts, last = key.split(".")
        node = tree
        for part in parts:
            node = node[part]
        node[last] = moved(node[last], chance)
    return build(type(loop.scenario), tree)


def moved(value, chance):
    if isinstance(value, dict):
        return {key: moved(part, chance) for key, part in value.items()}
    if isinstance(value, list):
        return [moved(part, chance) for part in value]
    return value * chance.uniform(0.5, 1.0) if isinstance(value, float) else value


def drake_run(loop, scenario):
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context(), scenario)
    if loop.monitor is not None:
        simulator.set_monitor(loop.monitor)
    simulator.Initialize()
    simulator.AdvanceTo(UNTIL[scenario.backend])
    return loop.recording(simulator.get_context())


def rows_of(loop, scenarios):
    rows = LoopRows(loop, scenarios)
    rows.advance_to(UNTIL[loop.scenario.backend])
    return rows


@pytest.mark.parametrize(("name", "backend"), sorted(loops()))
def test_every_row_is_the_run_of_drake(name, backend):
    loop = loop_of(name, backend)
    scenarios = [varied(loop, row) for row in range(ROWS)]
    rows = rows_of(loop, scenarios)
    assert not rows.errors
    for row, scenario in enumerate(scenarios):
        recording, expected = rows.recording(row), drake_run(loop, scenario)
        assert np.array_equal(recording.time, expected.time)
        assert recording.signals.keys() == expected.signals.keys()
        assert recording.units == expected.units
        for signal, samples in expected.items():
            scale = np.abs(samples[np.isfinite(samples)]).max(initial=0.0)
            np.testing.assert_allclose(
                recording[signal], samples, rtol=RELATIVE, atol=RELATIVE * scale, err_msg=signal
            )


@pytest.mark.parametrize(
    ("name", "backend"),
    [
        *((name, "kinematic") for name in ("level", "chair-walk", "centre-walk", "bench-walk")),
        ("level", "mujoco"),
    ],
)
def test_a_row_depends_neither_on_others_nor_on_their_order(name, backend):
    loop = loop_of(name, backend)
    scenarios = [varied(loop, row) for row in range(ROWS)]
    together = rows_of(loop, scenarios)
    for order in ([2], [1, 0], [2, 0, 1, 0]):
        others = rows_of(loop, [scenarios[row] for row in order])
        for place, row in enumerate(order):
            recording, expected = others.recording(place), together.recording(row)
            for signal, samples in expected.items():
                assert np.array_equal(recording[signal], samples, equal_nan=True), signal
