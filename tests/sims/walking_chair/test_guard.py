"""The guard of the real chair, shown a simulated walk, as it was and with faults in it."""

import numpy as np
import pytest

from parapod.diagrams.walking_chair.guard import ChairGuard
from parapod.diagrams.walking_chair.scenario import ChairScenario

# Latest time after which each fault is found while the branch moves [s].
FAULTS = {
    "stuck encoder": ("following_error", "branch 11 is more than 5 mm off its way", 0.6),
    "wrong sign of an encoder": ("following_error", "branch 11 is more", 0.4),
    "no encoder": ("following_error", "branch 11 is more", 0.13),
    "jump of an encoder": ("encoder_jump", "branch 11 changes faster than it can", 0.0),
    "tipping": ("no_support", "the centre of mass is not above the feet that stand", 0.13),
    "old measurements": ("legs_stale", "measurements that are old", 0.13),
    "pressed stop": ("emergency_stop", "the emergency stop is pressed", 0.0),
}
# Of which no encoder is the cause.
WITHOUT_DOUBT = ("tipping", "old measurements", "pressed stop")


@pytest.fixture(scope="module")
def recorded(finished):
    """Samples of a walk by signal, and the time between two of them."""
    log = finished("chair-walk").log
    (period,) = set(np.diff(log.time).round(9))
    ages = {"status.age": np.full((len(log.time), 1), 0.01)}
    return period, {n: log.signals[n] for n in ChairGuard.signals - {*ages}} | ages


def watch(period, signals, late=()):
    """The reason for which the guard ends the walk, and the sample; None if it does not."""
    scenario = ChairScenario()
    scenario.control.period = period
    guard, now = ChairGuard(scenario), 50.0
    for k in range(len(signals["legs.position"])):
        now += period + (0.05 if k in late else 0.0)
        trip = guard.check(now, {name: values[k] for name, values in signals.items()})
        if trip is not None:
            return trip, k
    return None


def fastest(signals):
    """Sample from which on the first branch moves fast."""
    rates = np.abs(np.diff(signals["legs.position"][:, 0]))
    return int(np.argmax(np.convolve(rates, np.ones(30), "valid")))


def spoilt(name, signals, at):
    """Signals with a fault from a sample on."""
    signals = {key: np.array(values, dtype=float) for key, values in signals.items()}
    position = signals["legs.position"]
    match name:
        case "stuck encoder":
            position[at:, 0] = position[at, 0]
        case "wrong sign of an encoder":
            position[at:, 0] = 2.0 * position[at, 0] - position[at:, 0]
        case "no encoder":
            position[at:, 0] = np.nan
        case "jump of an encoder":
            position[at:, 0] += 4e-3
        case "tipping":
            signals["support_margin"][at:] = -1e-3
        case "old measurements":
            signals["status.age"][at:] = 0.07
        case "pressed stop":
            signals["legs.emergency_stop"][at:] = 1.0
    return signals


def test_a_walk_in_which_nothing_is_wrong_is_not_ended(recorded):
    assert watch(*recorded) is None


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_while_the_branches_move_is_named_in_time(recorded, fault):
    period, signals = recorded
    at = fastest(signals)
    trip, when = watch(period, spoilt(fault, signals, at))
    name, words, deadline = FAULTS[fault]
    assert trip.name == name
    assert trip.sign.startswith(words)
    assert 0 <= (when - at) * period <= deadline + 1e-9
    assert trip.distrusted == (() if fault in WITHOUT_DOUBT else ("legs",))


def test_a_sign_that_does_not_last_ends_nothing(recorded):
    period, signals = recorded
    at = fastest(signals)
    passing = spoilt("tipping", signals, at)
    passing["support_margin"][at + round(0.08 / period) :] = 0.05
    assert watch(period, passing) is None


def test_ticks_that_are_left_out_are_no_jumps(recorded):
    period, signals = recorded
    at = fastest(signals)
    kept = np.r_[0:at, at + 5 : len(signals["legs.position"])]
    shown = {name: values[kept] for name, values in signals.items()}
    assert watch(period, shown, late=(at,)) is None
    assert watch(period, shown)[0].name == "encoder_jump"
