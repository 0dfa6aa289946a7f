"""One cell of a campaign of faults: a fault of one signal in one phase of the operation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

from parapod.diagrams.fault_scenario import FaultScenario
from parapod.diagrams.levelling_platform.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.deployment import make_deployment
from parapod.sims.deploy_scenario import DeployScenario
from parapod.systems.levelling_platform.fault_detection import RULES, Finding
from parapod.systems.levelling_platform.supervisor import Phase
from parapod.systems.safety.faults import FaultKind, Severity

# What fails, by the name that people give it: port and element.
DEVICES: dict[str, tuple[str, int]] = {
    "encoder": ("legs.extension", 2),
    "gyro": ("imu.gyro", 0),
    "accelerometer": ("imu.accel", 0),
    "contact switch": ("legs.limits", 10),
    "end switch": ("legs.limits", 2),
    "drive": ("legs.voltage", 2),
    "supply": ("supply", -1),
    "command": ("posture_command", -1),
}
# How the table of findings may call them.
_NAMES: dict[str, tuple[str, ...]] = {
    "encoder": ("encoder",),
    "gyro": ("gyro", "inertial sensor"),
    "accelerometer": ("accelerometer", "inertial sensor"),
    "contact switch": ("contact switch",),
    "end switch": ("limit switch",),
    "drive": ("drive",),
    "supply": ("supply",),
    "command": ("command",),
}
# What a platform may be off its path without that being noticed [deg, mm].
STRAY_DEG, STRAY_MM = 0.5, 5.0
_INJECTABLE = (
    "legs.extension",
    "imu.gyro",
    "imu.accel",
    "legs.limits",
    "legs.voltage",
    "posture_command",
)
# When a fault begins, from the beginning of its phase [s].
_INTO: dict[Phase, float] = {
    Phase.TRANSPORT: 2.0,
    Phase.BRAKE: 0.2,
    Phase.LOWER: 5.0,
    Phase.TOUCHDOWN: 0.2,
    Phase.ESTIMATE: 1.0,
    Phase.POSTURE: 3.0,
    Phase.HOLD: 2.5,
    Phase.RETRACT: 3.0,
}
PHASES = tuple(_INTO)


@dataclass(frozen=True)
class Cell:
    """What a fault did.

    Attributes:
        device: what failed.
        kind: how.
        phase: in which phase.
        injected: whether the signal really changed.
        findings: names of what was found, in the order in which it was.
        delay: from the change of the signal to the first finding [s]; NaN without one.
        reaction: the worst severity that was reached.
        stray_deg: how far roll and pitch left the path of the faultless run [deg].
        stray_mm: likewise the height [mm].
        bounded: whether all outputs stayed finite and within their limits.
    """

    device: str
    kind: str
    phase: str
    injected: bool
    findings: tuple[str, ...]
    delay: float
    reaction: str
    stray_deg: float
    stray_mm: float
    bounded: bool

    @property
    def is_late(self) -> bool:
        """Whether the platform moved, and the first finding came after its deadline."""
        if not self.findings or self.stray_deg <= STRAY_DEG:
            return False
        return not self.delay <= RULES[Finding[self.findings[0].upper()]].deadline

    @property
    def is_misnamed(self) -> bool:
        """Whether the first finding names other devices only."""
        if not self.findings:
            return False
        named = RULES[Finding[self.findings[0].upper()]].device
        return not any(word in named for word in _NAMES[self.device])

    @property
    def is_harmful(self) -> bool:
        """Whether the platform left its path unnoticed."""
        return (
            not self.findings
            and self.device != "command"
            and (self.stray_deg > STRAY_DEG or self.stray_mm > STRAY_MM)
        )


@dataclass(frozen=True)
class _Trace:
    """What was recorded, one row a period."""

    time: NDArray[np.float64]
    posture: NDArray[np.float64]
    findings: NDArray[np.float64]
    severity: NDArray[np.float64]
    changed: NDArray[np.bool_]
    outputs: NDArray[np.float64]
    extension: NDArray[np.float64]


class Campaign:
    """Runs cells of one phase, each from the same instant of a faultless run."""

    def __init__(self, scenario: DeployScenario, phase: Phase, window: float):
        """Runs up to the phase.

        Args:
            scenario: the operation's.
            phase: in which the faults begin.
            window: for which each fault is watched [s].
        """
        self._scenario, self._phase, self._window = scenario, phase, window
        self._loop = make_deployment(
            scenario.machine,
            scenario.steps(),
            scenario.work.posture,
            log=(),
            injectable=_INJECTABLE,
        )
        simulator = Simulator(self._loop.diagram)
        self._loop.reset(simulator.get_mutable_context())
        simulator.set_monitor(self._stop_in_phase)
        simulator.Initialize()
        simulator.AdvanceTo(scenario.longest)
        simulator.clear_monitor()
        simulator.AdvanceTo(simulator.get_context().get_time() + _INTO[phase])
        self._start: Any = simulator.get_context().Clone()
        self._path = self._watch(self._start.Clone()).posture

    def _stop_in_phase(self, root_context: Context) -> EventStatus:
        controller = self._loop.controller
        phase: Any = controller.GetOutputPort("phase").Eval(
            controller.GetMyContextFromRoot(root_context)
        )
        if phase[0] == self._phase:
            return EventStatus.ReachedTermination(controller, "phase")
        return EventStatus.DidNothing()

    def run(self, device: str, kind: FaultKind) -> Cell:
        """One fault, from now on."""
        context: Any = self._start.Clone()
        target, index = DEVICES[device]
        begin = math.nextafter(context.get_time() - 1e-6, 0.0)
        fault = FaultScenario(at=max(0.0, begin), target=target, index=index, kind=kind.value)
        self._loop.faults.set_faults(context, [fault], self._scenario.seed)
        trace = self._watch(context)
        return self._judge(device, kind, trace)

    def _watch(self, context: Context) -> _Trace:
        simulator = Simulator(self._loop.diagram, context)
        recorder = _Recorder(self._loop)
        simulator.set_monitor(recorder.look)
        simulator.Initialize()
        simulator.AdvanceTo(context.get_time() + self._window)
        return recorder.trace()

    def _judge(self, device: str, kind: FaultKind, trace: _Trace) -> Cell:
        first = [
            int(np.argmax(column)) if column.any() else -1 for column in trace.findings.T > 0.5
        ]
        found = sorted((row, i) for i, row in enumerate(first) if row >= 0)
        injected = bool(trace.changed.any())
        delay = math.nan
        if found and injected:
            changed = int(np.argmax(trace.changed))
            delay = float(trace.time[found[0][0]] - trace.time[changed])
        stray = self._stray(trace.posture)
        return Cell(
            device,
            kind.value,
            self._phase.name.lower(),
            injected,
            tuple(Finding(i).name.lower() for _, i in found),
            delay,
            Severity(int(trace.severity.max())).name.lower(),
            float(stray[0]),
            float(stray[1]),
            self._is_bounded(trace),
        )

    def _stray(self, posture: NDArray[np.float64]) -> tuple[float, float]:
        """Largest distance of roll and pitch [deg] and of the height [mm] from the path."""
        off = np.abs(posture[:, np.newaxis] - self._path)
        tilt = np.degrees(off[..., :2].max(axis=2).min(axis=1).max())
        return float(tilt), 1e3 * float(off[..., 2].min(axis=1).max())

    def _is_bounded(self, trace: _Trace) -> bool:
        limit = self._scenario.control.voltage_limit
        return bool(
            np.isfinite(trace.outputs).all()
            and (np.abs(trace.outputs[:, :4]) <= limit).all()
            and np.isfinite(trace.posture).all()
            and ((trace.extension > 0.379) & (trace.extension < 0.461)).all()
        )


class _Recorder:
    """Monitor that keeps what a cell is judged by, once a period."""

    def __init__(self, loop: ClosedLoop):
        self._loop = loop
        self._rows: list[tuple[Any, ...]] = []

    def look(self, root_context: Context) -> EventStatus:
        """Takes a row."""

        def value(system: Any, port: str) -> Any:
            return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(root_context))

        controller, station = self._loop.controller, self._loop.station.diagram
        injectors = self._loop.faults.injectors.values()
        changed = any(value(injector, "changed")[0] > 0.5 for injector in injectors)
        outputs = [
            value(controller, name)
            for name in ("legs.voltage", "wheels.velocity_command", "arm_command")
        ]
        self._rows.append(
            (
                root_context.get_time(),
                value(station, "truth.posture"),
                value(controller, "findings"),
                value(controller, "severity")[0],
                changed,
                np.concatenate(outputs),
                value(station, "truth.extension"),
            )
        )
        return EventStatus.DidNothing()

    def trace(self) -> _Trace:
        """Everything as arrays."""
        return _Trace(*(np.array(column) for column in zip(*self._rows, strict=True)))


def run_phase(
    scenario: DeployScenario, phase: Phase, devices: Sequence[str], window: float
) -> list[Cell]:
    """All kinds of faults of some devices in one phase."""
    quiet = replace(scenario, faults=[])
    campaign = Campaign(quiet, phase, window)
    return [campaign.run(device, kind) for device in devices for kind in FaultKind]
