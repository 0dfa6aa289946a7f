"""Every kind of fault of every device in every phase of the operation, and what comes of it.

Each cell begins at the same instant of a faultless run. Its fault stays, and the platform is
watched for a while: what is found, after how long, how the machine reacts, how far it leaves the
path of the faultless run, and whether every output stays finite and within its limits.
"""

import multiprocessing
import os
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial

from rich.progress import track

from parapod.diagrams.levelling_platform.scenario import GroundScenario
from parapod.sims.deploy_scenario import DeployScenario, WorkScenario, uneven_ground
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.fault_cells import DEVICES, PHASES, Cell, run_phase
from parapod.sims.results import Metric, Result, plain_number
from parapod.sims.unsupported_options import refuse_options
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.supervisor import Phase
from parapod.systems.safety.faults import FaultKind

BACKENDS = ("kinematic",)
_ALL = "all"
_TIPPED = 10.0  # a platform that is this far from its path may be on its way to tip over [deg]
# Why some faults are not found, and do no harm.
_IDLE = "the leg is asked for nothing, or for less than friction, and its screw holds it"
_QUICK = "the commands hardly change within the delay"
_TRIM = "a foot counts as lost after .8 s only; until then its trim stays below .1 mm"
_VALID = "a valid command cannot be told from the one that was meant; it is kept within reach"
_REASONS: dict[tuple[str, str], str] = {
    ("gyro", "stuck"): "the platform turns so slowly that the accelerometer tells its attitude",
    ("accelerometer", "stuck"): "a platform at rest has nothing new to tell",
    ("contact switch", "off"): "the foot is in the air, or has touched already",
    ("contact switch", "stuck"): "it shows what is so, until its foot moves",
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


@dataclass
class FaultCampaignScenario(Schema):
    """One campaign: every kind of fault of every device in every phase of the operation.

    Attributes:
        backend: plant behind the station's ports: "kinematic" (quasi-static).
        seed: seed of the machine, its noise and the garbage.
        ground: see `GroundScenario`.
        device: device that fails; "all" for each in turn.
        phase: phase in which the faults begin; "all" for each in turn.
        window: time for which each fault is watched [s].
    """

    backend: str = choice("kinematic", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    ground: GroundScenario = field(default_factory=uneven_ground)
    device: str = choice(_ALL, (_ALL, *DEVICES))
    phase: str = choice(_ALL, (_ALL, *(phase.name.lower() for phase in PHASES)))
    window: float = quantity(10.0, 0.5, 60.0)

    @property
    def operation(self) -> DeployScenario:
        """The operation that is disturbed."""
        return DeployScenario(
            backend=self.backend, seed=self.seed, ground=self.ground, work=WorkScenario()
        )


def run(scenario: FaultCampaignScenario, options: RunOptions) -> Result:
    """Runs all cells.

    Raises:
        OutputError: an option that has nothing to show.
    """
    why = "is not supported: a campaign is many short runs; `parapod run deploy` shows one"
    refuse_options(options, ("meshcat", "html", "log", "graphviz"), why)
    phases = [p for p in PHASES if scenario.phase in (_ALL, p.name.lower())]
    devices = [d for d in DEVICES if scenario.device in (_ALL, d)]
    work = partial(run_phase, scenario.operation, devices=devices, window=scenario.window)
    workers = min(len(phases), os.cpu_count() or 1)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        running = pool.map(work, phases)
        done = track(running, "faults, phase by phase", len(phases), console=options.console)
        cells = [cell for phase_cells in done for cell in phase_cells]
    return Result(
        "fault-campaign",
        scenario.backend,
        scenario.seed,
        _metrics(cells),
        (*_matrix(cells, phases), *_unnoticed(cells)),
        details={"matrix": [_plain(cell) for cell in cells]},
    )


def _metrics(cells: Sequence[Cell]) -> tuple[Metric, ...]:
    injected = [cell for cell in cells if cell.injected]
    unnoticed = [cell for cell in injected if not cell.findings]
    unexplained = [c for c in unnoticed if (c.device, c.kind) not in _REASONS]
    caught = [cell for cell in injected if cell.device != "command"]
    none = 0.0
    return (
        Metric("cells", len(cells), meaning="devices x kinds x phases"),
        Metric("cells_injected", len(injected), meaning="whose signal really changed"),
        Metric("cells_found", len(injected) - len(unnoticed), meaning="of these"),
        Metric(
            "cells_unexplained", len(unexplained), "", none, meaning="neither found nor explained"
        ),
        Metric(
            "cells_harmful",
            sum(cell.is_harmful for cell in injected),
            "",
            none,
            meaning="not found although the platform left its path",
        ),
        Metric(
            "cells_misnamed",
            sum(cell.is_misnamed for cell in injected),
            "",
            none,
            meaning="found under the name of another device",
        ),
        Metric(
            "cells_late",
            sum(cell.is_late for cell in injected),
            "",
            none,
            meaning="found after the deadline, the platform having moved",
        ),
        Metric(
            "cells_unbounded",
            sum(not cell.bounded for cell in cells),
            "",
            none,
            meaning="with an output that was not finite or beyond its limit",
        ),
        Metric(
            "largest_stray_deg",
            max((cell.stray_deg for cell in caught), default=0.0),
            "deg",
            _TIPPED,
            meaning="of roll and pitch from the faultless path, commands apart",
        ),
        Metric(
            "largest_stray_mm",
            max((cell.stray_mm for cell in caught), default=0.0),
            "mm",
            meaning="of the height from the faultless path, commands apart",
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
    """What is not found, in how many phases, and why."""
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


EXPERIMENT = Experiment(
    name="fault-campaign",
    summary="Every kind of fault of every device in every phase of the operation.",
    scenario=FaultCampaignScenario,
    backends=BACKENDS,
    run=run,
)
