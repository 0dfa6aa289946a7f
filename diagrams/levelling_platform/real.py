"""The real platform: its guard, self-tests, switches and emergency stop.

The guard is the fault detector of the supervised operation, for every job.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.guard import Ticks, Trip
from parapod.diagrams.levelling_platform.homing import make_homing
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.real import RealMachine, SelfTest
from parapod.systems.levelling_platform.fault_detection import RULES, FaultDetector, Finding
from parapod.systems.levelling_platform.plane import attitude_seeing
from parapod.systems.levelling_platform.supervisor import Phase
from parapod.systems.safety.faults import Severity

# Input of the detector and signal of the loop.
_SIGNALS = {
    "extension": "legs.extension",
    "limits": "legs.limits",
    "voltage": "legs.voltage",
    "gyro": "imu.gyro",
    "accel": "imu.accel",
    "age": "status.age",
    "emergency_stop": "legs.emergency_stop",
    "attitude": "attitude_estimated",
    "ground": "ground_estimated",
    "foot_offsets": "foot_offsets_estimated",
}
_VALID, _FINDINGS = "ground_valid", "findings"
# Without these the legs are compared with their voltages, but not with the ground.
_ON_GROUND = ("attitude_estimated", "ground_estimated", "foot_offsets_estimated", _VALID)
_UP = (0.0, 0.0, 1.0)
# Without the supervised operation nothing keeps feet on the ground: a leg that is a tenth of a
# millimetre too short opens its switch.
_NO_REASON = (Finding.FOOT_LOST,)


class PlatformGuard:
    """Ends a job when the legs, their voltages, switches and the inertial sensor do not agree.

    Every finding of `FaultDetector` that makes the supervised operation hold or brake ends it, but
    for a lost foot; the self-locking legs then stand. Until the ground has been estimated nothing
    is compared with it. A job with a supervisor has a detector of its own, whose findings are
    taken: the supervisor reacts, and the job goes on.
    """

    signals = frozenset((*_SIGNALS.values(), _VALID, _FINDINGS))

    def __init__(self, scenario: LevellingScenario):
        """Begins to watch.

        Args:
            scenario: its machine and `control` part are those of the loop.
        """
        self._ticks = Ticks(scenario.control.period)
        geometry = scenario.geometry_as_known
        self._offsets = scenario.control.encoder_offsets
        self._detector = FaultDetector(geometry, scenario.fault_detector, scenario.control.period)
        self._context = self._detector.CreateDefaultContext()
        for i in range(self._detector.num_input_ports()):
            port = self._detector.get_input_port(i)
            port.FixValue(self._context, np.zeros(port.size()))

    def allow_age(self, seconds: float) -> float:
        """See `FaultDetector`."""
        return self._detector.allow_age(self._context, seconds)

    def check(self, now: float, values: Mapping[str, NDArray[Any]]) -> Trip | None:
        """See `Guard`."""
        is_supervised = _FINDINGS in values
        findings = values[_FINDINGS] if is_supervised else self._findings(now, values)
        broken_rules = [rule for rule in RULES if findings[rule.finding] > 0.5]
        grave = [
            rule
            for rule in broken_rules
            if rule.severity >= Severity.HOLD and rule.finding not in _NO_REASON
        ]
        if not grave:
            return None
        worst = max(grave, key=lambda rule: rule.severity)
        is_leg = any("encoder" in rule.device for rule in grave)
        distrusted = ("legs",) if is_leg else ()
        return Trip(worst.finding.name.lower(), worst.sign, distrusted, not is_supervised)

    def _findings(self, now: float, values: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """Findings of the guard's own detector."""
        if not self._ticks.is_regular(now):
            self._detector.forget(self._context)
        for name, value in self._seen(values).items():
            self._detector.GetInputPort(name).FixValue(self._context, value)
        ahead = self._detector.EvalUniquePeriodicDiscreteUpdate(self._context)
        self._context.get_mutable_discrete_state().SetFrom(ahead)
        findings: Any = self._detector.GetOutputPort("findings").Eval(self._context)
        return findings

    def _seen(self, values: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """Inputs of the detector."""
        values_by_name: dict[str, Any] = {
            name: values[signal] for name, signal in _SIGNALS.items() if signal in values
        }
        if "extension" in values_by_name:
            values_by_name["extension"] = values_by_name["extension"] + self._offsets
        knows_ground = all(name in values for name in _ON_GROUND) and values[_VALID][0] > 0.5
        values_by_name["phase"] = [float(Phase.POSTURE if knows_ground else Phase.FAULT)]
        if not knows_ground:  # nor is the estimated attitude there yet
            force = values_by_name.get("accel", _UP)
            values_by_name["attitude"] = attitude_seeing(force if np.any(force) else _UP, _UP)
        return values_by_name


# Voltages of a self-test by the supply's: usual and largest [-].
_USUAL, _LARGEST = 1.0 / 12.0, 1.0 / 6.0
# Without a lag, and with a limit of its own, the arm's drive would run from one set value to the
# next, and stand in between.
_BY_DEVICES = {
    "machine.arm.drives.max_acceleration_deg_s2": 1e6,
    "machine.arm.drives.time_constant_ms": 20.0,
}
# Rates of the arm's joints in a self-test: usual and largest [rad/s or m/s].
_ARM_RATES = (0.05, 0.2)
# Resolution of the optical tracker of Appendix B [mm, deg].
_TRACKER = (0.05, 0.01)


def _instrument(signals: Mapping[str, NDArray[Any]]) -> str:
    """The posture as the optical tracker of Appendix B tells it."""
    roll, pitch, height = signals["truth.posture"].tolist()
    length, angle = _TRACKER
    reading = [length * round(1e3 * height / length)]
    reading += [angle * round(math.degrees(x) / angle) for x in (roll, pitch)]
    return f"height {reading[0]:.2f} mm, roll {reading[1]:.2f} deg, pitch {reading[2]:.2f} deg"


def make_real(scenario: LevellingScenario) -> RealMachine[LevellingScenario]:
    """Self-tests and homing by the actuators, places of the end switches [mm]."""
    params, switches = scenario.machine.actuators.params, scenario.machine.actuators.switches
    usual, largest = (share * params.supply_voltage for share in (_USUAL, _LARGEST))
    legs = SelfTest(
        command="voltage",
        usual=usual,
        largest=largest,
        measures="extension",
        gain=params.gain,
        rest={"stop": 0.0},
    )
    wheels = SelfTest(
        command="velocity_command",
        usual=1.0,
        largest=2.0,
        measures="position",
        rest={"brake": 0.0},
    )
    arm = SelfTest(
        command="position_command",
        usual=_ARM_RATES[0],
        largest=_ARM_RATES[1],
        measures="position",
        is_position=True,
    )
    arms = {"arm": arm} if scenario.machine.masses.arm.count else {}
    ends = {"extended_mm": switches.extended, "retracted_mm": switches.retracted}
    return RealMachine(
        self_tests={"legs": legs, "wheels": wheels} | arms,
        homings={"legs": make_homing(scenario.machine)},
        fittings={"legs": {name: round(1e3 * end, 3) for name, end in ends.items()}},
        exchange={"multibody": 2e-3, "kinematic": 2e-3, "mujoco": 2e-3},
        by_devices=_BY_DEVICES,
        cut={
            "legs.voltage": 0.0,
            "legs.stop": 1.0,
            "wheels.velocity_command": 0.0,
            "wheels.brake": 1.0,
        },
        drives=("legs.voltage",),
        switches=("legs.limits",),
        guard=PlatformGuard,
        instrument=_instrument,
    )
