"""The experiment `identify-actuators`: its estimator, its numbers, its refusals."""

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.identify.experiment import (
    IdentifyActuatorsScenario,
    record,
)
from parapod.sims.levelling_platform.identify.steps import (
    Recording,
    Steps,
    find_steps,
    schedule,
    separate_friction,
)
from parapod.sims.output.options import RunOptions
from parapod.systems.core.scenario_file import load_scenario


def scenario_with(*overrides):
    return load_scenario(IdentifyActuatorsScenario, overrides=overrides)


@pytest.fixture(scope="module")
def logged(finished):
    return finished("identify-actuators")


def _signals(log, case):
    return [log.signals[f"{case}.legs.{name}"] for name in ("voltage", "extension")]


def test_the_estimator_finds_the_slope_of_each_ramp_behind_its_transient():
    time = np.arange(0.0, 3.0, 0.01)
    voltage = np.select([(time >= 0.5) & (time < 1.5), time >= 2.0], [2.0, -1.0], 0.0)
    gain = np.array([0.008, 0.009, 0.010, 0.011])
    extension = 0.4 + np.outer(np.cumsum(voltage) * 0.01, gain)
    extension[(time >= 0.5) & (time < 0.55)] += 0.01  # a transient
    found = find_steps(Recording(time, np.tile(voltage[:, None], 4), extension), 0.1)
    assert found.voltage.tolist() == [2.0, -1.0]
    assert np.allclose(found.gain, gain)
    assert found.deviation_percent(0.01) == pytest.approx(20.0)


VOLTAGE = np.array([1.0, -1.0, 2.0, -3.0])
GAIN = np.array([0.008, 0.009, 0.010, 0.011])


def test_friction_is_told_from_the_gain_in_each_direction():
    speed = np.outer(VOLTAGE - np.where(VOLTAGE > 0.0, 0.1, -0.3), GAIN)
    found = separate_friction(Steps(VOLTAGE, speed))
    assert np.allclose(found.gain, GAIN)
    assert np.allclose(found.extending, 0.1)
    assert np.allclose(found.retracting, 0.3)


def test_a_direction_without_steps_takes_nothing_from_the_gain():
    voltage = np.abs(VOLTAGE)
    found = separate_friction(Steps(voltage, np.outer(voltage - 0.2, GAIN)))
    assert np.allclose(found.gain, GAIN)
    assert np.allclose(found.extending, 0.2)
    assert np.allclose(found.retracting, 0.0)


def drawn_gains(scenario):
    """Gains that the machine's reset draws."""
    error = scenario.machine.actuators.gain_error
    return 0.01 * (1.0 + np.random.default_rng(scenario.seed).uniform(-error, error, 4))


def test_both_cases_have_the_gains_that_the_seed_draws():
    coarse = (
        "plant.leg_model=reduced",
        "plant.time_step=0.01",
        "machine.actuators.coulomb_friction=0",
    )
    scenario = scenario_with(*coarse, "seed=3", "encoder_resolution_mm=0")
    recordings = record(scenario, Runner("", RunOptions(console=Console(quiet=True))))
    assert np.allclose(recordings.gain, drawn_gains(scenario), rtol=1e-12)
    assert np.ptp(recordings.gain) > 1e-4
    unloaded = find_steps(recordings.unloaded, 0.1)
    assert np.allclose(unloaded.gain, recordings.gain, rtol=1e-3)
    lowers = unloaded.voltage > 0.0  # a self-locking screw feels no load then
    loaded = find_steps(recordings.loaded, 0.1)
    assert np.allclose(loaded.gain[lowers], recordings.gain, rtol=1e-3)


def test_the_log_alone_gives_the_true_gains_within_the_bound(logged):
    log = logged.log
    for case in ("unloaded", "loaded"):
        found = separate_friction(find_steps(Recording(log.time, *_signals(log, case)), 0.1))
        assert np.allclose(found.gain, drawn_gains(scenario_with()), rtol=0.01)
    # Friction is most of what the paper's K lacks of it.
    steps = find_steps(Recording(log.time, *_signals(log, "loaded")), 0.1)
    assert np.abs(steps.gain / drawn_gains(scenario_with()) - 1.0).max() > 0.1


def test_the_schedule_travels_the_same_way_in_every_step():
    trajectory = schedule(scenario_with().plan)
    time = np.arange(0.0, trajectory.end_time(), 1e-3) + 5e-4
    voltage = trajectory.vector_values(time)[0]
    assert 1e-3 * 0.01 * np.abs(voltage).sum() == pytest.approx(10 * 12e-3, rel=0.01)
    assert len(set(voltage.tolist()) - {0.0}) == 10
    assert trajectory.value(trajectory.end_time())[0, 0] == 0.0


def test_all_bounds_hold_and_load_slows_only_the_steps_that_lift(logged):
    log = logged.log
    assert -5.0 < logged.values["load_effect_percent"] < 0.0
    cases = [
        find_steps(Recording(log.time, *_signals(log, case)), 0.1)
        for case in ("unloaded", "loaded")
    ]
    slower = 1.0 - (cases[1].gain / cases[0].gain).mean(axis=1)
    lifts = cases[0].voltage < 0.0
    assert (slower[lifts] > 0.01).all()
    assert (np.abs(slower[~lifts]) < 0.01).all()
    assert cases[0].gain.mean() == pytest.approx(logged.values["gain_unloaded"])
