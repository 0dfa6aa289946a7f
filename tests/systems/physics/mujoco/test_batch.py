"""Machines of many rows that MuJoCo steps together."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

import parapod
from parapod.diagrams.side_by_side import LoopRows
from parapod.systems.core.ports import value_of

mujoco = pytest.importorskip("mujoco")
batches = pytest.importorskip("mujoco.batch")

REDUCED = ("backend=mujoco", "plant.leg_model=reduced", "plant.time_step=0.005")
UNTIL = 0.2


@pytest.fixture(scope="module")
def loop():
    return parapod.closed_loop(parapod.scenario("level", *REDUCED))


def simulated(loop, seeds):
    scenarios = [parapod.scenario("level", *REDUCED, f"seed={seed}") for seed in seeds]
    rows = LoopRows(loop, scenarios)
    rows.advance_to(UNTIL)
    return rows


def assert_same(recording, expected):
    for name, samples in expected.items():
        assert np.array_equal(recording[name], samples, equal_nan=True), name


def test_a_row_that_mujoco_fails_at_ends_alone(loop, monkeypatch):
    expected = simulated(loop, (1, 2, 3))
    step, calls = batches.Batch.step, []

    def failing(batch, ids=None, *arguments, **keywords):
        calls.append(list(ids))
        if len(calls) != 5:
            return step(batch, ids, *arguments, **keywords)
        step(batch, np.delete(ids, 1), *arguments, **keywords)
        raise batches.SimulationError(np.array([1]), "mju_error")

    monkeypatch.setattr(batches.Batch, "step", failing)
    rows = simulated(loop, (1, 2, 3))
    assert {row: type(error) for row, error in rows.errors.items()} == {1: mujoco.FatalError}
    assert calls[4] == [0, 1, 2]
    assert calls[5] == [0, 2]
    for row in (0, 2):
        assert_same(rows.recording(row), expected.recording(row))
    with pytest.raises(mujoco.FatalError):
        rows.recording(1)


def test_the_number_of_threads_changes_nothing(loop, monkeypatch):
    recordings = []
    for threads in (1, 3):
        monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
        recordings.append(simulated(loop, range(5)).recording(4))
    assert_same(*recordings)


def test_a_row_can_be_gone_on_with_by_drakes_simulator(loop):
    rows = simulated(loop, (4, 5))
    for row, scenario in enumerate(rows.scenarios):
        whole = Simulator(loop)
        loop.reset(whole.get_mutable_context(), scenario)
        whole.AdvanceTo(UNTIL + 0.1)
        rest = Simulator(loop, rows.context(row))
        rest.AdvanceTo(UNTIL + 0.1)
        ends = [
            value_of(loop.station, "truth.posture", simulator.get_context())
            for simulator in (whole, rest)
        ]
        assert np.array_equal(*ends)
