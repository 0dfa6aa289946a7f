"""Inject every kind of fault of every device in every phase of the operation.

Each cell begins at the same instant of a faultless run. Its fault stays, and the platform is
watched for a while: what is found, after how long, how the machine reacts, how far it leaves the
path of the faultless run, and whether every output stays finite and within its limits.

448 cells, of which 364 change a signal. 287 of these are found, none under the name of another
device; the others do no harm, and each is listed with its reason. All outputs stay finite and
within their limits. Until the fault is found the platform leaves the path of the faultless run by
1.0 deg (a stuck or wrong encoder) and 8.2 mm (a contact switch that does not close, so that its
leg goes on lowering) at most.
"""

import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, EventStatus

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.scenario import (
    ControlScenario,
    GroundScenario,
    PlatformFault,
)
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.runner import Runner
from parapod.sims.lab.work import LocalCrew, WorkerDied, carry_out
from parapod.sims.levelling_platform.deploy import (
    Deploy,
    DeployScenario,
    WorkScenario,
    uneven_ground,
)
from parapod.sims.output.progress import counted
from parapod.sims.output.results import Metric, plain_number
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.fault_detection import RULES, Finding
from parapod.systems.levelling_platform.supervisor import Phase
from parapod.systems.safety.faults import FaultKind, Severity

# Names of findings in the table.
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
_SLACK = 1e-3  # beyond an end stop [m]
_TIPPED = 10.0  # a platform that is this far from its path may be on its way to tip over [deg]
# Why some faults are not found, and do no harm.
_IDLE = "the leg is asked for nothing, or for less than friction, and its screw holds it"
_QUICK = "the commands hardly change within the delay"
_TRIM = "a foot counts as lost after .8 s only; until then its trim stays below .1 mm"
_VALID = "a valid command looks like the one that was meant; it is kept within reach"
_REASONS: dict[tuple[str, str], str] = {
    ("gyro", "stuck"): "the platform turns so slowly that the accelerometer tells its attitude",
    ("accelerometer", "stuck"): "a platform at rest has nothing new to tell",
    ("contact switch", "off"): "the foot is in the air, or has touched already",
    ("contact switch", "stuck"): "it shows the true state until its foot moves",
    ("contact switch", "garbage"): _TRIM,
    ("contact switch", "wrong"): "a foot that has touched is looked for no more",
    ("contact switch", "slow"): "a leg that stops a tenth of a second later goes back",
    ("contact switch", "delayed"): "a leg that stops a tenth of a second later goes back",
    ("contact switch", "intermittent"): _TRIM,
    ("end switch", "off"): "no leg is at its end",
    ("end switch", "garbage"): "it disagrees with the extension for single samples only",
    **{("drive", kind): _IDLE for kind in ("off", "stuck", "wrong", "garbage", "intermittent")},
    **{("drive", kind): _QUICK for kind in ("slow", "delayed")},
    **{("supply", kind): _IDLE for kind in ("off", "stuck", "wrong", "garbage", "intermittent")},
    **{("supply", kind): _QUICK for kind in ("slow", "delayed")},
    **{("command", kind): _VALID for kind in ("garbage", "wrong", "stuck", "slow", "delayed")},
}


# Failing thing by the name that people give it: port and element.
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
# Instant at which a fault begins, from the beginning of its phase [s].
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
_ALL = "all"


@dataclass
class FaultCampaignScenario(Schema):
    """One campaign: every kind of fault of every device in every phase of the operation.

    Attributes:
        backend: plant behind the station's ports: "kinematic" (quasi-static).
        seed: seed of the machine, its noise and the garbage.
        ground: see `GroundScenario`.
        control: see `ControlScenario`.
        device: device that fails; "all" for each in turn.
        phase: phase in which the faults begin; "all" for each in turn.
        window: time for which each fault is watched [s].
    """

    backend: str = choice("kinematic", ("kinematic",))
    seed: int = quantity(0, 0, 2**31 - 1)
    ground: GroundScenario = field(default_factory=uneven_ground)
    control: ControlScenario = field(default_factory=ControlScenario)
    device: str = choice(_ALL, (_ALL, *DEVICES))
    phase: str = choice(_ALL, (_ALL, *(phase.name.lower() for phase in PHASES)))
    window: float = quantity(10.0, 0.5, 60.0)

    @property
    def operation(self) -> DeployScenario:
        """The operation that is disturbed."""
        return DeployScenario(
            backend=self.backend,
            seed=self.seed,
            ground=self.ground,
            control=self.control,
            work=WorkScenario(),
        )


@dataclass(frozen=True)
class Cell:
    """Outcome of a fault.

    Attributes:
        device: device that failed.
        kind: kind of the failure.
        phase: in which phase.
        injected: true if the signal really changed.
        findings: names of what was found, in the order in which it was.
        delay: from the change of the signal to the first finding [s]; NaN without one.
        reaction: the worst severity that was reached.
        stray_deg: largest distance of roll and pitch from the path of the faultless run [deg].
        stray_mm: the same of the height [mm].
        bounded: true if all outputs stayed finite and within their limits.
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


class FaultCampaign(Experiment[FaultCampaignScenario, list[Cell]]):
    """Runs all cells: each fault of each device in each phase."""

    schema = FaultCampaignScenario
    backends = ("kinematic",)
    takes = "2 min"

    def run(self, scenario: FaultCampaignScenario, runner: Runner) -> list[Cell]:
        """Runs each device in each phase, on all cores."""
        devices, phases = _devices(scenario), _phases(scenario)
        pieces = [(phase, device) for phase in phases for device in devices]
        work = partial(run_device, scenario.operation, scenario.window)
        total = len(pieces) * len(FaultKind)
        cells_by_fault: dict[int, list[Cell]] = {}
        crew = LocalCrew(min(len(pieces), os.cpu_count() or 1))
        with crew, counted(runner.console, "faults", total) as report:
            for number, cells in carry_out(crew, work, pieces):
                if isinstance(cells, WorkerDied):
                    phase, device = pieces[number]
                    raise WorkerDied(f"{device}, {phase.name.lower()}: {cells}")
                cells_by_fault[number] = cells
                report(len(cells_by_fault) * len(FaultKind))
        return [cell for number in range(len(pieces)) for cell in cells_by_fault[number]]

    def measure(self, scenario: FaultCampaignScenario, data: list[Cell]) -> Iterable[Metric]:
        """Numbers of faults found, missed, harmful."""
        return _metrics(data)

    def note(self, scenario: FaultCampaignScenario, data: list[Cell]) -> Iterable[str]:
        """The matrix of devices, kinds and phases, and reasons for what is not found."""
        return (*_matrix(data, _phases(scenario)), *_unnoticed(data))

    def details(self, scenario: FaultCampaignScenario, data: list[Cell]) -> Mapping[str, Any]:
        """All cells."""
        return {"matrix": [_plain(cell) for cell in data]}


def _phases(scenario: FaultCampaignScenario) -> list[Phase]:
    return [phase for phase in PHASES if scenario.phase in (_ALL, phase.name.lower())]


def _devices(scenario: FaultCampaignScenario) -> list[str]:
    return [device for device in DEVICES if scenario.device in (_ALL, device)]


@dataclass(frozen=True)
class _Trace:
    """Recording of a cell, one row a period."""

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
        self._loop = Deploy("deploy").loop(scenario, log=(), injectable=_INJECTABLE)
        simulator = self._loop.simulator()
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
        fault = PlatformFault(at=max(0.0, begin), target=target, index=index, kind=kind.value)
        self._loop.faults.set_faults(context, [fault], self._scenario.seed)
        trace = self._watch(context)
        return self._judge(device, kind, trace)

    def _watch(self, context: Context) -> _Trace:
        simulator = self._loop.simulator(context)
        recorder = _Recorder(self._loop)
        simulator.set_monitor(recorder.look)
        simulator.Initialize()
        simulator.AdvanceTo(context.get_time() + self._window)
        return recorder.trace()

    def _judge(self, device: str, kind: FaultKind, trace: _Trace) -> Cell:
        first = [
            int(np.argmax(column)) if column.any() else -1 for column in trace.findings.T > 0.5
        ]
        detections = sorted((row, i) for i, row in enumerate(first) if row >= 0)
        injected = bool(trace.changed.any())
        delay = math.nan
        if detections and injected:
            changed = int(np.argmax(trace.changed))
            delay = float(trace.time[detections[0][0]] - trace.time[changed])
        stray = self._stray(trace.posture)
        return Cell(
            device,
            kind.value,
            self._phase.name.lower(),
            injected,
            tuple(Finding(i).name.lower() for _, i in detections),
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
        limit = self._scenario.levelling.tuned_control.voltage_limit or 0.0
        low, high = self._scenario.machine.stops
        return bool(
            np.isfinite(trace.outputs).all()
            and (np.abs(trace.outputs[:, :4]) <= limit).all()
            and np.isfinite(trace.posture).all()
            and ((trace.extension > low - _SLACK) & (trace.extension < high + _SLACK)).all()
        )


class _Recorder:
    """Monitor that keeps what a cell is judged by, once a period."""

    def __init__(self, loop: ClosedLoop[Any]):
        self._loop = loop
        self._rows: list[tuple[Any, ...]] = []

    def look(self, root_context: Context) -> EventStatus:
        """Takes a row."""

        def value(system: Any, port: str) -> Any:
            return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(root_context))

        controller, station = self._loop.controller, self._loop.station
        injectors = self._loop.faults.injectors.values()
        changed = any(value(injector, "changed")[0] > 0.5 for injector in injectors)
        outputs = [
            value(controller, name)
            for name in ("legs.voltage", "wheels.velocity_command", "arm.position_command")
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


# What a worker has begun last, and goes on with: scenario, phase and window; the campaign.
_begun: tuple[tuple[DeployScenario, Phase, float], Campaign] | None = None


def run_device(scenario: DeployScenario, window: float, piece: tuple[Phase, str]) -> list[Cell]:
    """All kinds of faults of a device in a phase.

    Args:
        scenario: the operation's.
        window: time for which each fault is watched [s].
        piece: phase and device.
    """
    global _begun
    phase, device = piece
    inputs = scenario, phase, window
    if _begun is None or _begun[0] != inputs:
        _begun = inputs, Campaign(replace(scenario, faults=[]), phase, window)
    return [_begun[1].run(device, kind) for kind in FaultKind]


def _metrics(cells: Sequence[Cell]) -> tuple[Metric, ...]:
    injected = [cell for cell in cells if cell.injected]
    unnoticed = [cell for cell in injected if not cell.findings]
    unexplained = [c for c in unnoticed if (c.device, c.kind) not in _REASONS]
    caught = [cell for cell in injected if cell.device != "command"]
    none = 0.0
    return (
        Metric("cells", len(cells), meaning="cells of the campaign: devices x kinds x phases"),
        Metric("cells_injected", len(injected), meaning="cells whose signal really changed"),
        Metric("cells_found", len(injected) - len(unnoticed), meaning="faults detected"),
        Metric(
            "cells_unexplained",
            len(unexplained),
            "",
            none,
            meaning="faults neither detected nor explained",
        ),
        Metric(
            "cells_harmful",
            sum(cell.is_harmful for cell in injected),
            "",
            none,
            meaning="faults not detected although the platform left its path",
        ),
        Metric(
            "cells_misnamed",
            sum(cell.is_misnamed for cell in injected),
            "",
            none,
            meaning="faults found under the name of another device",
        ),
        Metric(
            "cells_late",
            sum(cell.is_late for cell in injected),
            "",
            none,
            meaning="faults detected after the deadline, the platform having moved",
        ),
        Metric(
            "cells_unbounded",
            sum(not cell.bounded for cell in cells),
            "",
            none,
            meaning="cells with an output that was not finite or beyond its limit",
        ),
        Metric(
            "largest_stray_deg",
            max((cell.stray_deg for cell in caught), default=0.0),
            "deg",
            _TIPPED,
            meaning="largest change of roll and pitch by a fault, without faults of commands",
        ),
        Metric(
            "largest_stray_mm",
            max((cell.stray_mm for cell in caught), default=0.0),
            "mm",
            meaning="largest change of the height by a fault, without faults of commands",
        ),
    )


def _matrix(cells: Sequence[Cell], phases: Sequence[Phase]) -> list[str]:
    """One line a device and kind, one column a phase."""
    by_place = {(cell.device, cell.kind, cell.phase): cell for cell in cells}
    names = [phase.name.lower() for phase in phases]
    lines = [
        "reaction (w warn, h hold, b brake) and delay [s]; . signal unchanged; - not found",
        f"{'':27}" + "".join(f"{name[:5]:>6}" for name in names),
    ]
    for device in DEVICES:
        for kind in FaultKind:
            row = [by_place.get((device, kind.value, name)) for name in names]
            if any(row):
                lines.append(f"{device:14} {kind.value:12}" + "".join(map(_short, row)))
    return lines


def _short(cell: Cell | None) -> str:
    if cell is None or not cell.injected:
        return f"{'.':>6}"
    if not cell.findings:
        return f"{'-':>6}"
    return f"{cell.reaction[0]}{max(0.0, cell.delay):.2f}".rjust(6)


def _unnoticed(cells: Sequence[Cell]) -> list[str]:
    """Faults that are not found, in how many phases, and why."""
    counted = Counter((c.device, c.kind) for c in cells if c.injected and not c.findings)
    return ["not found:"] * bool(counted) + [
        f"{device}, {kind} (in {count} phases): {_REASONS.get((device, kind), 'UNEXPLAINED')}"
        for (device, kind), count in counted.items()
    ]


def _plain(cell: Cell) -> dict[str, object]:
    values = asdict(cell)
    return {
        key: plain_number(value) if isinstance(value, float) else value
        for key, value in values.items()
    }
