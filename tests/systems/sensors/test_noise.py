"""Noise of sensors: Drake's numbers, from a seed, in every context."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from pydrake.common import RandomDistribution, RandomGenerator
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import RandomSource

from parapod.systems.sensors.noise import NoiseSource, noise_sample

PERIOD = 8.0 / 819.2
SIZE = 15


class Reader(LeafSystem):
    """Reads its input as an inertial sensor does: at initialization and once a period."""

    def __init__(self, size, period):
        super().__init__()
        self.seen = []
        port = self.DeclareVectorInputPort("noise", size)
        self.DeclareDiscreteState(1)

        def read(context, discrete_state):
            self.seen.append(port.Eval(context).copy())
            return EventStatus.Succeeded()

        self.DeclareInitializationDiscreteUpdateEvent(read)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, read)


def seen_by_a_sensor(source, duration, prepare=lambda context: None):
    builder = DiagramBuilder()
    builder.AddSystem(source)
    reader = builder.AddSystem(Reader(source.get_output_port(0).size(), PERIOD))
    builder.Connect(source.get_output_port(0), reader.get_input_port())
    simulator = Simulator(builder.Build())
    prepare(source.GetMyMutableContextFromRoot(simulator.get_mutable_context()))
    simulator.AdvanceTo(duration)
    return np.array(reader.seen)


def of_drake(seed, size, duration):
    source = RandomSource(RandomDistribution.kGaussian, size, PERIOD)
    return seen_by_a_sensor(
        source,
        duration,
        lambda context: source.SetRandomContext(context, RandomGenerator(seed)),
    )


@pytest.mark.skipif(sys.platform != "linux", reason="Drake's numbers are those of libstdc++ there")
@pytest.mark.parametrize(("size", "seed"), [(1, 0), (4, 5), (SIZE, 2**31 - 1)])
def test_a_sensor_sees_the_numbers_of_drakes_source(seed, size):
    drakes = of_drake(seed, size, 5.0)
    ours = seen_by_a_sensor(NoiseSource(size, PERIOD, seed), 5.0)
    assert ours.shape == drakes.shape == (513, size)
    np.testing.assert_array_equal(ours, drakes)


def test_the_first_numbers_of_a_seed_are_the_same_everywhere():
    """Those of Drake's `RandomSource` on Linux after `RandomGenerator(5)`."""
    expected = (0.14452152022785492, 1.0780589685816888, 0.13270309649729814)
    np.testing.assert_allclose(noise_sample(5, 0, SIZE)[:3], expected, rtol=1e-15)


def test_a_sensor_sees_every_sample_once_in_order():
    seen = seen_by_a_sensor(NoiseSource(SIZE, PERIOD, 7), 5.0)
    expected = [noise_sample(7, number, SIZE) for number in range(len(seen))]
    np.testing.assert_array_equal(seen, expected)


def test_a_context_that_is_given_a_seed_begins_its_sequence():
    source = NoiseSource(SIZE, PERIOD, 1)
    given = seen_by_a_sensor(source, 1.0, lambda context: source.set_seed(context, 9))
    built = seen_by_a_sensor(NoiseSource(SIZE, PERIOD, 9), 1.0)
    np.testing.assert_array_equal(given, built)
    np.testing.assert_array_equal(
        seen_by_a_sensor(NoiseSource(SIZE, PERIOD, 1), 0.0)[0], noise_sample(1, 0, SIZE)
    )


def test_a_simulation_that_is_initialized_again_goes_on_with_the_sequence():
    source = NoiseSource(2, PERIOD, 3)
    simulator = Simulator(source)
    context = simulator.get_mutable_context()
    for periods in (0.5, 1.0, 1.5, 2.0, 7.0, 7.25):
        simulator.AdvanceTo(periods * PERIOD)
        before = source.get_output_port().Eval(context).copy()
        simulator.Initialize()
        np.testing.assert_array_equal(source.get_output_port().Eval(context), before)
        np.testing.assert_array_equal(before, noise_sample(3, 1 + int(np.ceil(periods)), 2))


def test_samples_depend_on_seed_and_number_alone():
    """In any order, from any thread, and after those in between were forgotten."""
    numbers = [5000, 0, 127, 128, 4999, 2000, 5000, 1]
    once = {number: noise_sample(11, number, 3).copy() for number in sorted(numbers)}

    def look(number):
        return np.array_equal(noise_sample(11, number, 3), once[number])

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(look, numbers * 5))


def test_samples_cannot_be_changed_by_those_who_read_them():
    with pytest.raises(ValueError, match="read-only"):
        noise_sample(0, 0, 2)[0] = 1.0


def test_samples_are_unit_gaussian_and_their_elements_independent():
    samples = np.array([noise_sample(2, number, 4) for number in range(20000)])
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(np.cov(samples.T), np.eye(4), atol=0.04)
    np.testing.assert_allclose((samples**4).mean(axis=0), 3.0, rtol=0.1)
    assert abs(np.corrcoef(samples[1:, 0], samples[:-1, 0])[0, 1]) < 0.03


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_out_of_range_are_refused(seed):
    source = NoiseSource()
    with pytest.raises(ValueError, match=rf"seed must be in 0..4294967295, not {seed}"):
        NoiseSource(seed=seed)
    with pytest.raises(ValueError, match="seed must be"):
        source.set_seed(source.CreateDefaultContext(), seed)


@pytest.mark.parametrize("period", [0.0, float("inf"), float("nan")])
def test_a_period_that_is_not_above_zero_is_refused(period):
    with pytest.raises(ValueError, match="period must be above 0"):
        NoiseSource(1, period)
