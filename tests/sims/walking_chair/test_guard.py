"""The guard of the real chair, shown a simulated walk, as it was and with faults in it."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.walking_chair import real
from parapod.diagrams.walking_chair.real import ChairGuard, ChairLimits
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.systems.walking_chair.payload import PayloadEstimator

_HARDWARE = Path(__file__).parents[3] / "docs" / "hardware" / "walking_chair.md"
# Latest time after which each fault is found while the branch moves [s].
FAULTS = {
    "stuck encoder": ("following_error", "is more than 5 mm off its way", 0.6),
    "wrong sign of an encoder": ("following_error", "is more than 5 mm", 0.4),
    "no encoder": ("following_error", "is more than 5 mm", 0.13),
    "jump of an encoder": ("encoder_jump", "changes faster than it can", 0.0),
    "swinging branch": ("oscillation", "swings about its way, 1.", 0.8),
    "branch held in the air": ("current_mismatch", "holds", 0.42),
    "tipping": ("no_support", "the centre of mass is not above the feet that stand", 0.13),
    "old measurements": ("legs_stale", "measurements that are old", 0.13),
    "pressed stop": ("emergency_stop", "the emergency stop is pressed", 0.0),
}
# Of which no encoder is the cause.
WITHOUT_DOUBT = ("swinging branch", "tipping", "old measurements", "pressed stop")


@pytest.fixture(scope="module")
def recorded(finished):
    """Samples of a walk by signal, and the time between two of them."""
    log = finished("chair-walk").log
    (period,) = set(np.diff(log.time).round(9))
    ages = {"status.age": np.full((len(log.time), 1), 0.01)}
    return period, {n: log.signals[n] for n in ChairGuard.signals - {*ages}} | ages


def watch(period, signals, late=(), limits=ChairLimits()):
    """The reason for which the guard ends the walk, and the sample; None if it does not."""
    guard, now = ChairGuard(scenario_of(period), limits), 50.0
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


def spoilt(name, signals, at, period=0.01):
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
        case "swinging branch":
            later = period * np.arange(len(position) - at)
            position[at:, 0] += 3.5e-3 * np.sin(2.0 * np.pi * 2.5 * later)
        case "branch held in the air":
            signals["legs.current"][at:, 0] += 1.0
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
    of_chair = fault in ("tipping", "old measurements", "pressed stop")
    assert trip.axis == (None if of_chair else ("legs", 0))
    assert trip.distrusted == (() if fault in WITHOUT_DOUBT else ("legs",))


def test_a_measurement_that_comes_a_tick_late_is_no_jump(recorded):
    period, signals = recorded
    at = fastest(signals)
    late = {key: np.array(values, dtype=float) for key, values in signals.items()}
    late["legs.position"][at] = late["legs.position"][at - 1]
    late["status.age"][at] = 0.01 + period
    limits = ChairLimits(fastest=0.1)
    assert watch(period, late, limits=limits) is None
    late["status.age"][at] = 0.01  # as if it had been measured so
    trip, when = watch(period, late, limits=limits)
    assert (trip.name, when) == ("encoder_jump", at + 1)


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


# --- currents and the ground


def estimated(period, signals):
    """What the loop's estimator makes of lengths and currents, a row for each sample."""
    estimator = PayloadEstimator()
    context = estimator.CreateDefaultContext()
    rows = []
    for k, values in enumerate(
        zip(signals["legs.position"], signals["legs.current"], strict=True)
    ):
        if k % round(0.2 / period) == 0:
            for name, value in zip(("position", "current"), values, strict=True):
                estimator.GetInputPort(name).FixValue(context, value)
            context.SetDiscreteState(estimator.EvalUniquePeriodicDiscreteUpdate(context))
        rows.append(context.get_discrete_state(0).value().copy())
    return np.array(rows)


def on_two_feet(period, support, leg):
    """Sample from which on a leg is one of two that carry, for a second at least."""
    alone = (support[:, leg] > 0.5) & (support.sum(axis=1) < 2.5)
    begins = np.flatnonzero(alone[1:] & ~alone[:-1])
    return int(begins[0]) + round(1.5 / period)


def without_force(recorded, branch, at):
    period, signals = recorded
    signals = {key: np.array(values, dtype=float) for key, values in signals.items()}
    signals["legs.current"][at:, branch] = 0.0
    return period, signals | {"payload_estimated": estimated(period, signals)}


@pytest.mark.parametrize("leg", range(4))
def test_a_drive_that_carries_nothing_is_named_where_two_legs_stand(recorded, leg):
    at = on_two_feet(recorded[0], recorded[1]["support"], leg)
    trip, when = watch(*without_force(recorded, 3 * leg, at))
    assert trip.name == "current_mismatch"
    assert trip.axis == ("legs", 3 * leg)
    assert re.match(r"holds -?0 N by its current, where the feet", trip.sign)
    assert trip.distrusted == ("legs",)
    assert (when - at) * recorded[0] <= 0.42


def test_a_drive_that_carries_far_too_much_is_named(recorded):
    period, signals = recorded
    at = on_two_feet(period, signals["support"], 0)
    signals = {key: np.array(values, dtype=float) for key, values in signals.items()}
    signals["legs.current"][at:, 0] *= 2.0
    trip, _ = watch(period, signals | {"payload_estimated": estimated(period, signals)})
    assert (trip.name, trip.axis, trip.sign[:5]) == ("current_mismatch", ("legs", 0), "holds")


def test_a_foot_that_should_stand_and_does_not_is_told(recorded):
    period, signals = recorded
    at = on_two_feet(period, signals["support"], 0)
    signals = {key: np.array(values, dtype=float) for key, values in signals.items()}
    signals["legs.current"][at:, :3] = 0.0
    trip, when = watch(period, signals | {"payload_estimated": estimated(period, signals)})
    assert trip.name == "current_mismatch"
    assert (when - at) * period <= 0.42


def test_what_a_healthy_walk_leaves_unexplained_is_what_the_limits_say(recorded):
    documented = float(re.search(r"`; (\d+) that last", ChairLimits.__doc__)[1])
    assert documented <= ChairLimits().unexplained / 4.0
    assert watch(*recorded, limits=ChairLimits(unexplained=documented)) is None


def test_a_foot_that_the_gait_has_lifted_may_touch_the_ground_for_a_while(recorded):
    period, signals = recorded
    four = signals["support"].sum(axis=1) > 3.5
    kept = {name: np.array(values, dtype=float)[four] for name, values in signals.items()}
    kept["legs.position"] = np.repeat(kept["legs.position"][-1:], four.sum(), axis=0)
    kept["legs.current"] = np.repeat(kept["legs.current"][-1:], four.sum(), axis=0)
    kept["position_node"] = kept["legs.position"]
    kept["support"][:, 0] = 0.0
    assert watch(period, kept) is None
    trip, _ = watch(period, kept, limits=ChairLimits(lowest=-1.0))
    assert trip.name == "current_mismatch"


def test_a_passenger_may_lean(recorded):
    period, signals = recorded
    at = on_two_feet(period, signals["support"], 0)
    # The estimates before have the passenger 40 mm from where the currents have him from now on.
    leant = np.array(signals["payload_estimated"])
    before = ChairGuard(scenario_of(period))
    for k in range(at):
        before.check(50.0 + k * period, {n: v[k] for n, v in signals.items()})
    before._payload = before._payload + leant[at, 0] * np.array((0.0, 0.04, 0.0))
    for k in range(at, len(leant)):
        assert before.check(50.0 + k * period, {n: v[k] for n, v in signals.items()}) is None


def scenario_of(period):
    scenario = ChairScenario()
    scenario.control.period = period
    return scenario


def test_currents_that_are_not_finite_are_left_to_other_signs(recorded):
    period, signals = recorded
    signals = {key: np.array(values, dtype=float) for key, values in signals.items()}
    signals["legs.current"][100:, 3] = np.nan
    assert watch(period, signals) is None


# --- the documents


def test_every_finding_is_in_the_documents_table_with_its_time():
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| ([\d.]+) s \| (yes|no) \|$", text(), re.MULTILINE)
    told = {name: (float(within), known == "yes") for name, _, within, known in rows}
    for fault, (name, _, deadline) in FAULTS.items():
        within, is_remembered = told[name]
        # A finding without a delay comes with the sample, and the guard looks once a period.
        assert deadline <= within
        assert is_remembered == (fault in WITHOUT_DOUBT)
    assert told.keys() == {name for name, _, _ in FAULTS.values()}


def test_the_limits_in_the_documents_are_those_of_the_guard():
    limits = ChairLimits()
    for words in (
        f"faster than {1e3 * limits.fastest:g} mm/s, for one reading",
        f"a branch is {1e3 * limits.following:g} mm off its way, or its length is unknown, for "
        f"{limits.persists:g} s",
        f"{limits.unexplained:g} N of a branch that no ground explains, for "
        f"{limits.unexplained_persists:g} s",
        f"measurements that are {1e3 * limits.oldest:g} ms old, for {limits.persists:g} s",
        f"within {1e3 * limits.lowest:g} mm of the ground",
    ):
        assert words in " ".join(text().split())


def text():
    """The page, and the guard's own text."""
    return _HARDWARE.read_text() + inspect.getdoc(real)
