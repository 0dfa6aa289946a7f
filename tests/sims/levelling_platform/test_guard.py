"""The guard of the real platform, shown simulated jobs, as they were and with faults in them."""

import re
from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.real import PlatformGuard
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.levelling_platform.fault_detection import Finding

_HARDWARE = Path(__file__).parents[3] / "docs" / "hardware" / "index.md"
PERIOD = 0.01
# Latest time after which each fault is found while the legs move [s].
FAULTS = {
    "stuck encoder": ("leg_response", 1.0, "legs"),
    "wrong sign of an encoder": ("leg_response", 0.5, "legs"),
    "jump of an encoder": ("encoder_jump", 0.02, "legs"),
    "drift of an encoder": ("leg_response", 1.0, "legs"),
    "no encoder": ("encoder_invalid", 0.02, "legs"),
    "no supply": ("leg_response|supply", 1.0, "legs"),
    "old legs": ("legs_stale", 0.02, "legs"),
    "old samples": ("imu_stale", 0.02, ""),
    "pressed stop": ("emergency_stop", 0.0, ""),
    "no gyroscope": ("gyro_invalid", 0.2, ""),
    "wild gyroscope": ("gyro_invalid", 0.2, ""),
    "no gravity": ("accel_invalid", 0.3, ""),
    "tilted accelerometer": ("accel_mismatch", 0.6, ""),
    "tilted platform": ("posture_mismatch", 1.0, "legs"),
    "an encoder that lost counts": ("feet_mismatch", 0.5, "legs"),
}


@pytest.fixture(scope="module")
def recorded(finished):
    """recorded(part): samples by signal, at every tick."""

    def read(part):
        log = finished(part).log
        assert np.diff(log.time) == pytest.approx(PERIOD)
        ages = {"status.age": np.full((len(log.time), 4), 0.01)}
        return log.time, {
            name: log.signals[name]
            for name in PlatformGuard.signals - {*ages} & log.signals.keys()
        } | ages

    return read


def watch(time, signals, period=PERIOD, late=()):
    """The reason for which the guard ends a job, and when; None if it does not."""
    guard, now = PlatformGuard(LevellingScenario()), 50.0
    for k, t in enumerate(time):
        now += period + (0.05 if k in late else 0.0)
        trip = guard.check(now, {name: values[k] for name, values in signals.items()})
        if trip is not None:
            return trip, t
    return None


@pytest.mark.parametrize("part", ["level", "uneven-ground", "track-posture"])
def test_no_job_is_ended_in_which_nothing_is_wrong(recorded, part):
    assert watch(*recorded(part)) is None


def spoilt(name, signals, at):
    """Signals with a fault from a tick on."""
    signals = {key: np.array(values, dtype=float) for key, values in signals.items()}
    legs, gyro, accel = signals["legs.extension"], signals["imu.gyro"], signals["imu.accel"]
    after = np.arange(len(legs) - at)
    match name:
        case "stuck encoder":
            driven = np.abs(signals["legs.voltage"][at : at + 50]).mean(axis=0).argmax()
            legs[at:, driven] = legs[at, driven]
        case "wrong sign of an encoder":
            legs[at:, 0] = 2.0 * legs[at, 0] - legs[at:, 0]
        case "jump of an encoder":
            legs[at:, 2] += 2e-3
        case "drift of an encoder":
            legs[at:, 3] += 3e-5 * after
        case "no encoder":
            legs[at:, 0] = np.nan
        case "no supply":
            legs[at:] = legs[at]
        case "old legs":
            signals["status.age"][at:, 0] = 0.06
        case "old samples":
            signals["status.age"][at:, 1] = 0.06
        case "pressed stop":
            signals["legs.emergency_stop"][at:] = 1.0
        case "no gyroscope":
            gyro[at:, 2] = np.nan
        case "wild gyroscope":
            gyro[at:, 0] = 0.07
        case "no gravity":
            accel[at:] *= 0.5
        case "tilted accelerometer":
            accel[at:, 0] += 0.5
        case "tilted platform":
            signals["attitude_estimated"][at:, 0] += 0.012
            accel[at:, 1] += 0.012 * 9.81
        case "an encoder that lost counts":
            legs[at:, 1] += np.minimum(1e-4 * after, 5e-3)
            signals["legs.voltage"][at : at + 50, 1] += 1.0
    return signals


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_while_the_legs_move_is_named_in_time(recorded, fault):
    time, signals = recorded("level")
    # In the middle of a way of all legs after the ground is known.
    fast = np.abs(signals["legs.voltage"]).min(axis=1) * (signals["ground_valid"][:, 0] > 0.5)
    at = int(np.argmax(np.convolve(fast, np.ones(50), "valid")))  # for half a second
    trip, when = watch(time, spoilt(fault, signals, at))
    names, deadline, part = FAULTS[fault]
    assert trip.name in names.split("|")
    assert time[at] <= when <= time[at] + deadline
    assert trip.distrusted == ((part,) if part else ())


def test_ticks_that_are_left_out_are_no_jumps(recorded):
    time, signals = recorded("level")
    fast = np.abs(np.diff(signals["legs.extension"], axis=0)).max(axis=1)
    at = int(np.argmax(fast))
    # Ten ticks are missing where the legs move fastest.
    kept = np.r_[0 : at - 5, at + 5 : len(time)]
    shown = {name: values[kept] for name, values in signals.items()}
    assert watch(time[kept], shown, late=(at - 5,)) is None
    assert watch(time[kept], shown) is not None


def test_before_the_ground_is_known_and_without_an_estimator_the_legs_are_watched(recorded):
    time, signals = recorded("level")
    seen = {name: values for name, values in signals.items() if "estimated" not in name}
    assert watch(time, seen) is None
    trip, _ = watch(time, spoilt("jump of an encoder", seen, 10))
    assert trip.name == "encoder_jump"


def test_a_job_with_a_supervisor_goes_on_but_remembers_no_positions_that_may_be_wrong(recorded):
    _, signals = recorded("level")
    guard = PlatformGuard(LevellingScenario())
    values = {name: samples[0] for name, samples in spoilt("no encoder", signals, 0).items()}
    values["findings"] = np.zeros(len(Finding))
    assert guard.check(50.0, values) is None  # that is for the supervisor's detector to find
    values["findings"][Finding.ENCODER_JUMP] = 1.0
    trip = guard.check(50.01, values)
    assert (trip.name, trip.distrusted, trip.ends) == ("encoder_jump", ("legs",), False)
    values["findings"][:] = 0.0
    values["findings"][Finding.OPERATOR_LOST] = 1.0
    trip = guard.check(50.02, values)
    assert (trip.name, trip.distrusted, trip.ends) == ("operator_lost", (), False)
    # The worst is the reason, whichever comes first in the table.
    values["findings"][[Finding.ENCODER_JUMP, Finding.EMERGENCY_STOP]] = 1.0
    trip = guard.check(50.03, values)
    assert (trip.name, trip.distrusted, trip.ends) == ("emergency_stop", ("legs",), False)


def test_the_documents_tell_what_is_found_and_by_when():
    rows = re.findall(
        r"^\| ([^|`]+) \| (`[^|]+`) \| ([\d.]+) s \| (yes|no) \|$", _HARDWARE.read_text(), re.M
    )
    told = {
        name: (finding.replace("`", "").replace(" or ", "|"), float(within), remembered)
        for name, finding, within, remembered in rows
    }
    found = {
        name: (finding, deadline, "no" if part else "yes")
        for name, (finding, deadline, part) in FAULTS.items()
    }
    assert told == found
