"""Row i of many runs is Drake's run i, for every loop of a machine that is installed."""

import random
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

import parapod
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.side_by_side import LoopRows
from parapod.sims.lab.discovery import find_experiment, list_entries
from parapod.sims.lab.experiment import LoopExperiment
from parapod.systems.core.errors import ScenarioError
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
            for backend in experiment.machine.over_rows.keys() & experiment.machine.plants:
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


def moved(value, chance, least=0.5):
    if isinstance(value, dict):
        return {key: moved(part, chance, least) for key, part in value.items()}
    if isinstance(value, list):
        return [moved(part, chance, least) for part in value]
    return value * chance.uniform(least, 1.0) if isinstance(value, float) else value


def drake_run(loop, scenario):
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context(), scenario)
    if loop.monitor is not None:
        simulator.set_monitor(loop.monitor)
    simulator.Initialize()
    simulator.AdvanceTo(UNTIL[scenario.backend])
    return loop.recording(simulator.get_context())


def rows_of(loops, scenarios):
    rows = LoopRows(loops, scenarios)
    rows.advance_to(UNTIL[scenarios[0].backend])
    return rows


def assert_is_run(rows, row, loop, scenario):
    """Asserts that a row has the times, signals and units of the run of its scenario."""
    recording, expected = rows.recording(row), drake_run(loop, scenario)
    assert np.array_equal(recording.time, expected.time)
    assert recording.signals.keys() == expected.signals.keys()
    assert recording.units == expected.units
    for signal, samples in expected.items():
        scale = np.abs(samples[np.isfinite(samples)]).max(initial=0.0)
        np.testing.assert_allclose(
            recording[signal], samples, rtol=RELATIVE, atol=RELATIVE * scale, err_msg=signal
        )


@pytest.mark.parametrize(("name", "backend"), sorted(loops()))
def test_every_row_is_the_run_of_drake(name, backend):
    loop = loop_of(name, backend)
    scenarios = [varied(loop, row) for row in range(ROWS)]
    rows = rows_of(loop, scenarios)
    assert not rows.errors
    for row, scenario in enumerate(scenarios):
        assert_is_run(rows, row, loop, scenario)


MACHINES = ["level", "chair-walk", "centre-walk", "bench-walk"]


@pytest.mark.parametrize(
    ("name", "backend"), [(n, b) for n, b in sorted(loops()) if n in MACHINES]
)
def test_a_row_may_have_a_machine_of_its_own(name, backend):
    """Every number of it is another: dimensions, masses, drives, sensors."""
    usual = loop_of(name, backend)
    scenarios = []
    for row in range(ROWS):
        tree, chance = plain(usual.scenario), random.Random(row)
        tree["machine"] = moved(tree["machine"], chance, 0.9999)
        scenarios.append(build(type(usual.scenario), tree))
    loops = [ClosedLoop(usual.machine, scenario) for scenario in scenarios]
    rows = rows_of(loops, scenarios)
    assert not rows.errors
    if name == "level":  # in numbers of rows, all of it
        assert not rows.one_by_one
    for row, (loop, scenario) in enumerate(zip(loops, scenarios, strict=True)):
        assert_is_run(rows, row, loop, scenario)


@pytest.mark.parametrize(
    ("name", "backend"),
    [
        *((name, "kinematic") for name in MACHINES),
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


def test_scenarios_of_another_structure_are_named():
    loop = loop_of("level")
    other = parapod.scenario("level", "backend=kinematic", "machine.legs.l_4_mm=438").machine
    scenario = replace(loop.scenario, machine=other)
    with pytest.raises(ScenarioError, match=r"^machine\.legs\.l_4_mm of row 1 is not that of .*"):
        LoopRows(loop, [loop.scenario, scenario])
    with pytest.raises(ScenarioError, match=r"^row 1 is a scenario of another machine"):
        parapod.rows(loop, [loop.scenario, parapod.scenario("chair-walk", "backend=kinematic")])
    slower = parapod.closed_loop(
        parapod.scenario("level", "backend=kinematic", "control.period=0.02")
    )
    with pytest.raises(ScenarioError, match=r"^control\.\S+ of row 1 .*, not in their systems"):
        LoopRows([loop, slower], [loop.scenario, slower.scenario])
