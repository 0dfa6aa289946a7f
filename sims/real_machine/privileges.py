"""Privileges that keep other programs and the disk from a loop: SCHED_FIFO, mlockall, affinity.

Each is taken where the user may have it, and given back. A refusal is one line and costs
punctuality, never the job.
"""

import ctypes
import errno
import os
import resource
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

FIFO, MEMORY, CORE = "SCHED_FIFO", "mlockall", "affinity"
PRIVILEGES = (FIFO, MEMORY, CORE)
PRIORITY = 40
# Priority of emulated devices: on their own computer they would not delay a controller.
EMULATED = PRIORITY - 1
# Of mman.h and capability.h.
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
_CAP_IPC_LOCK = 14
_ISOLATED = Path("/sys/devices/system/cpu/isolated")


@dataclass(frozen=True)
class Outcome:
    """Answer of the kernel to a program that asks for a privilege.

    Attributes:
        name: one of `PRIVILEGES`.
        is_taken: true if the program has it.
        words: details of it, or the reason of the refusal with the limit that it is about.
    """

    name: str
    is_taken: bool
    words: str

    @property
    def text(self) -> str:
        """One line."""
        return f"{self.name} {'taken' if self.is_taken else 'refused'}: {self.words}"


class Kernel:
    """System calls that `privileges` needs, each of which may raise an OSError."""

    def is_fifo(self) -> bool:
        """Whether the calling thread has the policy SCHED_FIFO."""
        return os.sched_getscheduler(0) == os.SCHED_FIFO

    def set_fifo(self, priority: int | None) -> None:
        """Gives the calling thread SCHED_FIFO with a priority; None: ordinary scheduling."""
        policy = os.SCHED_OTHER if priority is None else os.SCHED_FIFO
        os.sched_setscheduler(0, policy, os.sched_param(priority or 0))

    def lock_memory(self) -> None:
        """Locks the pages of the process that have been touched, and others once they are.

        Nothing is read ahead: pages that are not needed, such as the stacks of threads to come,
        would take memory, and where that is short the kernel ends the program.
        """
        self._call("mlockall", _CURRENT | _FUTURE | _ON_FAULT)

    def unlock_memory(self) -> None:
        """Ends that."""
        self._call("munlockall")

    def cores(self) -> set[int]:
        """Cores on which the calling thread may run."""
        return os.sched_getaffinity(0)

    def set_cores(self, cores: Collection[int]) -> None:
        """Lets the calling thread run on these cores only."""
        os.sched_setaffinity(0, cores)

    def isolated(self) -> set[int]:
        """Cores that the kernel's command line has isolated."""
        try:
            return parsed_cores(_ISOLATED.read_text())
        except OSError:
            return set()

    def limit(self, what: int) -> int | None:
        """Soft limit of a resource (`resource.RLIMIT_...`); None: there is none."""
        soft, _ = resource.getrlimit(what)
        return None if soft == resource.RLIM_INFINITY else soft

    def may_lock(self) -> bool:
        """Whether the process has CAP_IPC_LOCK, for which limits do not count."""
        try:
            status = Path("/proc/self/status").read_text()
        except OSError:
            return False
        capabilities = [
            line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")
        ]
        return bool(capabilities) and bool(int(capabilities[0], 16) >> _CAP_IPC_LOCK & 1)

    @staticmethod
    def _call(function: str, *arguments: int) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        if getattr(library, function)(*arguments):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))


KERNEL = Kernel()


def parsed_cores(text: str) -> set[int]:
    """Cores of a list such as "1,4-6"."""
    cores: set[int] = set()
    for piece in text.strip().split(","):
        first, _, last = piece.partition("-")
        if first:
            cores |= set(range(int(first), int(last or first) + 1))
    return cores


@contextmanager
def privileges(
    requests: Collection[str], kernel: Kernel = KERNEL
) -> Iterator[tuple[Outcome, ...]]:
    """Takes privileges for the calling thread and those that it starts meanwhile.

    The memory's is of the whole process. Programs that it starts meanwhile inherit policy and
    cores, not the locked memory.

    Args:
        requests: names of `PRIVILEGES`.
        kernel: system calls.

    Yields what the kernel has said to each.
    """
    takers: dict[str, Callable[[Kernel, ExitStack], str]] = {
        FIFO: _with_fifo,
        MEMORY: _with_memory,
        CORE: _with_core,
    }
    with ExitStack() as stack:
        outcomes = []
        for name in PRIVILEGES:
            if name in requests:
                try:
                    outcomes.append(Outcome(name, True, takers[name](kernel, stack)))
                except (OSError, AttributeError, ValueError) as error:
                    outcomes.append(Outcome(name, False, _reason(name, error, kernel)))
        yield tuple(outcomes)


def take_priority(kernel: Kernel = KERNEL, priority: int = PRIORITY) -> Outcome:
    """Gives the calling thread, and those that it starts from now on, SCHED_FIFO for good."""
    with ExitStack() as stack:
        try:
            words = _with_fifo(kernel, stack, priority)
        except (OSError, AttributeError) as error:
            return Outcome(FIFO, False, _reason(FIFO, error, kernel))
        stack.pop_all()
    return Outcome(FIFO, True, words)


def _with_fifo(kernel: Kernel, stack: ExitStack, priority: int = PRIORITY) -> str:
    if kernel.is_fifo():
        return "the program had it before"
    kernel.set_fifo(priority)
    stack.callback(kernel.set_fifo, None)
    return f"priority {priority}"


def _with_memory(kernel: Kernel, stack: ExitStack) -> str:
    # Below a limit that is not there yet a stack that grows, or an allocation to come, would end
    # the program in the middle of its work.
    if kernel.limit(resource.RLIMIT_MEMLOCK) is not None and not kernel.may_lock():
        raise OSError(errno.EPERM, "only without a limit is it safe")
    kernel.lock_memory()
    stack.callback(kernel.unlock_memory)
    return "pages stay in memory once they are touched"


def _with_core(kernel: Kernel, stack: ExitStack) -> str:
    before, isolated = kernel.cores(), kernel.isolated()
    core = max(isolated or before)
    kernel.set_cores({core})
    stack.callback(kernel.set_cores, before)
    kind = "isolated" if isolated else "not isolated: others run there too"
    return f"core {core}, {kind}"


def _reason(name: str, error: Exception, kernel: Kernel) -> str:
    """One line with the error's name, and the limit that it may come from."""
    if not isinstance(error, OSError) or error.errno is None:
        return "this system has no such call"
    text = f"{errno.errorcode.get(error.errno, error.errno)}"
    if name == FIFO:
        limit = kernel.limit(resource.RLIMIT_RTPRIO)
        return f"{text}; the limit rtprio is {limit}, {PRIORITY} or more is needed"
    if name == MEMORY:
        limit = kernel.limit(resource.RLIMIT_MEMLOCK)
        limit_text = "unlimited" if limit is None else f"{limit // 1024} kB"
        return f"{text}; the limit memlock is {limit_text}, unlimited is needed"
    isolated = ",".join(map(str, sorted(kernel.isolated())))
    which = f"core {isolated}, which is isolated," if isolated else "the core"
    return f"{text}; {which} is not in this program's cpuset"
