"""Jobs on emulated devices: how many end well, idle and beside other programs."""

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.deadlines import busy
from parapod.sims.lab.discovery import find_entry
from parapod.sims.real_machine.own_emulator import own_emulator

_PARAPOD = (sys.executable, "-m", "parapod.sims")
# Settings of jobs of some seconds; those of the emulator besides.
_CENTRE = (
    *("holes.count=0", "walk.advance_mm=20", "walk.steps=1", "walk.lift_mm=8"),
    *("motion.swing_mm_s=100", "motion.acceleration_mm_s2=1500", "control.settling=0.06"),
)
_SHORT = {
    "level": (
        *("job.waypoints=[]", "job.estimate_at=1", "job.settled_after=3.5", "job.end=4.5"),
        "job.arm={start: 0, duration: 0.1, angle_deg: 1}",
    ),
    "chair-walk": (
        *("gait.way=forward", "gait.lift_mm=6", "gait.step_mm=10", "gait.swing_height_mm=2"),
        *("gait.phase_duration=1", "begin=0.5", "end=0.5"),
    ),
    "centre-walk": _CENTRE,
    "bench-walk": ("gait.strides=1",),
}
# Settings that the emulator must know too.
_EMULATED = {"centre-walk": _CENTRE}
# A job that takes longer does not end [s].
_LONGEST = 3600.0


@dataclass(frozen=True)
class Job:
    """A job that has ended.

    Attributes:
        code: exit code.
        rate: rate of the emulated time [-].
        waited: emulated time that was waited for programs that were late [s].
        words: last words on its standard error.
    """

    code: int
    rate: float
    waited: float
    words: str


def run_jobs(name: str, count: int, backend: str, is_short: bool) -> Iterator[Job]:
    """Jobs of a machine on one emulator, until one ends badly.

    Args:
        name: experiment.
        count: number of jobs.
        backend: plant behind the devices.
        is_short: true if they take some seconds only.
    """
    own = _EMULATED.get(name, ()) if is_short else ()
    settings = (*find_entry(name).load().on_devices, *(_SHORT[name] if is_short else ()))
    options = ("--set", *own) if own else ()
    with own_emulator(name, "--backend", backend, *options) as emulator:
        (rate,) = re.findall(r"^time: rate ([\d.]+)", "\n".join(emulator.said), re.MULTILINE)
        for _ in range(count):
            of_job = ("--set", *settings) if settings else ()
            process = subprocess.run(
                [*_PARAPOD, "run", name, "--backend", "hardware", *of_job],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                timeout=_LONGEST,
            )
            waits = re.findall(
                r"emulated time .* waited ([\d.]+) s .* and ([\d.]+) s", process.stderr
            )
            waited = sum(map(float, waits[0])) if waits else 0.0
            *_, words = process.stderr.strip().splitlines() or ("",)
            words = words.removeprefix("parapod: error: ")
            yield Job(process.returncode, float(rate), waited, words)
            if process.returncode:
                return


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser("python -m benchmarks jobs", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="experiments; all without any")
    parser.add_argument("--jobs", type=int, default=20, metavar="N", help="jobs of each")
    parser.add_argument("--backend", default="kinematic", help="plant behind the devices")
    parser.add_argument("--short", action="store_true", help="jobs of some seconds only")
    parser.add_argument(
        "--beside", type=int, nargs="+", default=[0, 1], metavar="K", help="busy programs beside"
    )
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.names if name not in _SHORT]:
        parser.error(f"there are no jobs of '{unknown[0]}'; there are: {', '.join(_SHORT)}")
    console = Console()
    table = Table(box=box.SIMPLE)
    for heading in ("job", "beside", "ended well", "rate", "waited [s]", "last words"):
        table.add_column(heading)
    is_well = True
    for beside in options.beside:
        for name in options.names or _SHORT:
            jobs = []
            with busy(beside):
                for job in run_jobs(name, options.jobs, options.backend, options.short):
                    jobs.append(job)
                    progress = (
                        f"{name}, {beside} busy: job {len(jobs)} of {options.jobs} has ended"
                    )
                    console.print(f"{progress} with {job.code}, rate {job.rate:g}", markup=False)
            well = sum(job.code == 0 for job in jobs)
            is_well = is_well and well == options.jobs
            waits = [job.waited for job in jobs]
            words = "" if well == options.jobs else jobs[-1].words
            table.add_row(
                *(name, f"{beside} busy", f"{well} of {options.jobs}", f"{jobs[-1].rate:g}"),
                f"{min(waits):.2f}..{max(waits):.2f}",
                words,
            )
    console.print(table)
    return 0 if is_well else 1
