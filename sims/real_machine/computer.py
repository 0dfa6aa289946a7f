"""Properties of this computer without which a figure of punctuality tells nothing."""

import os
import platform
import re
import resource
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from parapod.sims.real_machine.privileges import KERNEL, parsed_cores

_ROOT = Path("/")
_CORES = "sys/devices/system/cpu"
_THROTTLED = "RT throttling activated"
# What user, nice, system, irq and softirq have in a line of /proc/stat; and all of it.
_BUSY, _ALL = (0, 1, 2, 5, 6), range(8)


@dataclass(frozen=True)
class Computer:
    """This computer, as far as it can be read; None or "": it cannot.

    Attributes:
        kernel: release of the kernel.
        preemption: preemption model of the kernel.
        cores: cores that this program may use.
        isolated: cores that the kernel's command line keeps other programs from.
        nohz_full: cores without a periodic tick.
        governors: governors of the cores' frequencies.
        rt_period: period in which real-time programs get a share of each core [s].
        rt_runtime: real-time programs' share of that period [s]; negative: all of it.
        rtprio: largest real-time priority that the user may take; None: any.
        memlock: memory that the user may lock [bytes]; None: any.
        load: programs that want to compute, for each of the cores.
    """

    kernel: str
    preemption: str
    cores: tuple[int, ...]
    isolated: tuple[int, ...]
    nohz_full: tuple[int, ...]
    governors: tuple[str, ...]
    rt_period: float | None
    rt_runtime: float | None
    rtprio: int | None
    memlock: int | None
    load: float

    @property
    def share(self) -> float:
        """Share of a core that real-time programs may have [-]."""
        if not self.rt_period or self.rt_runtime is None or self.rt_runtime < 0.0:
            return 1.0
        return min(1.0, self.rt_runtime / self.rt_period)

    def as_json(self) -> dict[str, Any]:
        """Everything by its name."""
        return asdict(self)

    def lines(self) -> list[str]:
        """A short block for the head of a measurement."""
        isolation = f", isolated: {_list(self.isolated)}" if self.isolated else ", none isolated"
        isolation += f", without a tick: {_list(self.nohz_full)}" if self.nohz_full else ""
        if self.rt_period is None or self.rt_runtime is None:
            throttle = "not readable"
        elif self.rt_runtime < 0.0:
            throttle = "off (sched_rt_runtime_us is -1)"
        else:
            throttle = (
                f"real-time programs get {1e6 * self.rt_runtime:.0f} of each "
                f"{1e6 * self.rt_period:.0f} us of a core"
            )
        memory = "unlimited" if self.memlock is None else f"{self.memlock // 1024} kB"
        return [
            f"kernel {self.kernel}, preemption: {self.preemption}",
            f"{len(self.cores)} cores{isolation}; governor: "
            f"{', '.join(self.governors) or 'not readable'}; load {self.load:.1f} a core",
            f"RT throttling: {throttle}",
            "limits: rtprio "
            f"{'unlimited' if self.rtprio is None else self.rtprio}, memlock {memory}",
        ]


def this_computer(root: Path = _ROOT) -> Computer:
    """Looks at this computer.

    Args:
        root: folder in which /proc and /sys are.
    """
    cores = sorted(KERNEL.cores()) if hasattr(os, "sched_getaffinity") else []
    pattern = root.glob(f"{_CORES}/cpu[0-9]*/cpufreq/scaling_governor")
    limit = getattr(resource, "RLIMIT_RTPRIO", None)
    lock = getattr(resource, "RLIMIT_MEMLOCK", None)
    return Computer(
        kernel=platform.release(),
        preemption=_preemption(root),
        cores=tuple(cores),
        isolated=_cores(root, "isolated"),
        nohz_full=_cores(root, "nohz_full"),
        governors=tuple(sorted({_text(path) for path in pattern})),
        rt_period=_seconds(root, "sched_rt_period_us"),
        rt_runtime=_seconds(root, "sched_rt_runtime_us"),
        rtprio=KERNEL.limit(limit) if limit is not None else None,
        memlock=KERNEL.limit(lock) if lock is not None else None,
        load=os.getloadavg()[0] / max(1, len(cores)),
    )


def _preemption(root: Path) -> str:
    """The model that the kernel is built with, and of a dynamic one what it does now."""
    version = _text(root / "proc/sys/kernel/version")
    if _text(root / "sys/kernel/realtime") == "1":
        return "PREEMPT_RT"
    match = re.search(r"\bPREEMPT\w*", version)
    if match is None:
        return "none or voluntary" if version else "not readable"
    if match[0] != "PREEMPT_DYNAMIC":
        return match[0]
    chosen = re.search(r"\((\w+)\)", _text(root / "sys/kernel/debug/sched/preempt"))
    return f"{match[0]}, {chosen[1] if chosen else 'mode unreadable'}"


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def _cores(root: Path, name: str) -> tuple[int, ...]:
    with suppress(ValueError):  # such as "(null)"
        return tuple(sorted(parsed_cores(_text(root / _CORES / name))))
    return ()


def _seconds(root: Path, name: str) -> float | None:
    text = _text(root / "proc/sys/kernel" / name)
    return 1e-6 * int(text) if text else None


def _list(cores: Sequence[int]) -> str:
    return ",".join(map(str, cores))


@dataclass
class Throttling:
    """Whether real-time programs have been stopped, as far as a program can know that.

    The kernel reports it once after its start, in its log, which root may read. Otherwise it
    is certain only that it was not: where no core was busy for longer than real-time programs may
    be.

    Attributes:
        share: share of a core that they may have [-].
        seconds: seconds that have been looked at.
        full: seconds in which a core was busy for longer.
        busiest: largest share of a second for which a core was busy [-].
        is_told: true if the kernel's log has reported it meanwhile.
    """

    share: float
    seconds: int = 0
    full: int = 0
    busiest: float = 0.0
    is_told: bool = False
    _last: dict[str, tuple[int, int]] = field(default_factory=dict, repr=False)

    def look(self, stat: str) -> None:
        """Looks at /proc/stat, once a period."""
        now: dict[str, tuple[int, int]] = {}
        for line in stat.splitlines():
            name, *numbers = line.split() or [""]
            if re.fullmatch(r"cpu\d+", name):
                counts = [int(number) for number in numbers]
                now[name] = sum(counts[i] for i in _BUSY), sum(counts[i] for i in _ALL)
        shares = [
            (busy - self._last[name][0]) / (total - self._last[name][1])
            for name, (busy, total) in now.items()
            if name in self._last and total > self._last[name][1]
        ]
        self._last = now
        if shares:
            self.seconds += 1
            self.full += max(shares) > self.share
            self.busiest = max(self.busiest, *shares)

    @property
    def words(self) -> str:
        """One line."""
        if self.is_told:
            return "throttled: the kernel's log says so"
        if self.share >= 1.0:
            return "not throttled: it is off, or cannot be read"
        if not self.seconds:
            return "nothing is known: /proc/stat cannot be read"
        busiest = f"{100.0 * self.busiest:.0f} %"
        if not self.full:
            return f"not throttled: no core was busy for more than {busiest} of a second"
        return (
            f"perhaps throttled: in {self.full} of {self.seconds} s a core was busy for more than "
            f"{100.0 * self.share:.0f} %, by whatever programs"
        )

    def as_json(self) -> dict[str, Any]:
        """Everything that is known, by its name."""
        throttled = {"seconds": self.seconds, "full_seconds": self.full, "busiest": self.busiest}
        return {"words": self.words, "is_told": self.is_told} | throttled


@contextmanager
def watched_throttling(computer: Computer, root: Path = _ROOT) -> Iterator[Throttling]:
    """Looks once a period, in a thread of its own, while it lasts.

    Args:
        computer: this one.
        root: folder in which /proc and /dev are.
    """
    watch, over = Throttling(computer.share), threading.Event()

    def look() -> None:
        with suppress(OSError):
            while True:
                watch.look((root / "proc/stat").read_text())
                if over.wait(computer.rt_period or 1.0):
                    return

    thread = threading.Thread(target=look, name="throttling", daemon=True)
    before = time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else 0.0
    thread.start()
    try:
        yield watch
    finally:
        over.set()
        thread.join()
        watch.is_told = any(at >= before for at in _told(root / "dev/kmsg"))


def _told(log: Path) -> list[float]:
    """Times since the start at which the kernel has reported throttling [s]."""
    measured_times: list[float] = []
    with suppress(OSError):
        file = os.open(log, os.O_RDONLY | os.O_NONBLOCK)
        try:
            while line := os.read(file, 8192).decode(errors="replace"):
                head, _, text = line.partition(";")
                if _THROTTLED in text:
                    measured_times.append(1e-6 * float(head.split(",")[2]))
        except (BlockingIOError, ValueError, IndexError):
            pass  # its end, or another one's format
        finally:
            os.close(file)
    return measured_times


def print_computer(computer: Computer, console: Console) -> None:
    """Prints the block."""
    for line in computer.lines():
        console.print(line, markup=False, highlight=False)
