"""Privileges that a kernel gives or refuses."""

import errno
import os
import resource

import pytest

from parapod.sims.real_machine.privileges import (
    CORE,
    EMULATED,
    FIFO,
    KERNEL,
    MEMORY,
    PRIVILEGES,
    Kernel,
    parsed_cores,
    privileges,
    take_priority,
)
from parapod.sims.real_machine.real_time import undisturbed


class Fake(Kernel):
    """A kernel that refuses what it is told to, and remembers what it has done."""

    def __init__(self, refuses=(), limits=(), isolated=(), may_lock=False, had_fifo=False):
        self.refuses, self.limits, self.done = dict(refuses), dict(limits), []
        self._isolated, self._may_lock, self._had_fifo = set(isolated), may_lock, had_fifo

    def _do(self, name, value=None):
        if name in self.refuses:
            raise OSError(self.refuses[name], os.strerror(self.refuses[name]))
        self.done.append((name, value))

    def is_fifo(self):
        return self._had_fifo

    def set_fifo(self, priority):
        self._do("fifo", priority)

    def lock_memory(self):
        self._do("lock")

    def unlock_memory(self):
        self._do("unlock")

    def cores(self):
        return {0, 1, 2}

    def set_cores(self, cores):
        self._do("cores", set(cores))

    def isolated(self):
        return self._isolated

    def limit(self, what):
        return self.limits.get(what)

    def may_lock(self):
        return self._may_lock


def test_what_is_asked_for_is_taken_and_given_back_and_nothing_else():
    kernel = Fake()
    with privileges(PRIVILEGES, kernel) as outcomes:
        assert kernel.done == [("fifo", 40), ("lock", None), ("cores", {2})]
    assert [outcome.name for outcome in outcomes if outcome.is_taken] == list(PRIVILEGES)
    assert kernel.done[3:] == [("cores", {0, 1, 2}), ("unlock", None), ("fifo", None)]
    kernel = Fake()
    with privileges((), kernel) as outcomes:
        assert outcomes == ()
    assert kernel.done == []


def test_privileges_are_given_back_when_the_work_fails():
    kernel = Fake()

    def work():
        with privileges([FIFO], kernel):
            raise RuntimeError

    with pytest.raises(RuntimeError):
        work()
    assert kernel.done == [("fifo", 40), ("fifo", None)]


@pytest.mark.parametrize(
    ("name", "refused", "number", "limits", "words"),
    [
        (FIFO, "fifo", errno.EPERM, {resource.RLIMIT_RTPRIO: 0}, "EPERM; the limit rtprio is 0, "),
        (MEMORY, "lock", errno.ENOMEM, {}, "ENOMEM; the limit memlock is unlimited, "),
        (CORE, "cores", errno.EINVAL, {}, "EINVAL; the core is not in this program's cpuset"),
    ],
)
def test_a_refusal_is_told_in_one_line_and_survived(name, refused, number, limits, words):
    kernel = Fake({refused: number}, limits)
    with undisturbed(PRIVILEGES, kernel) as outcomes:
        (outcome,) = (one for one in outcomes if not one.is_taken)
    assert outcome.name == name
    assert outcome.text.startswith(f"{name} refused: {words}")
    assert "\n" not in outcome.text
    # The others are taken all the same, and the refused one is not given back.
    assert len(kernel.done) == 4
    assert refused not in dict(kernel.done)


def test_memory_is_not_locked_below_a_limit_that_could_end_the_program_later():
    limited = {resource.RLIMIT_MEMLOCK: 8 * 2**20}
    kernel = Fake(limits=limited)
    with privileges([MEMORY], kernel) as (outcome,):
        assert kernel.done == []
    words = "mlockall refused: EPERM; the limit memlock is 8192 kB, unlimited is needed"
    assert outcome.text == words
    # For a program with CAP_IPC_LOCK limits do not count.
    kernel = Fake(limits=limited, may_lock=True)
    with privileges([MEMORY], kernel) as (outcome,):
        assert outcome.is_taken
    assert kernel.done == [("lock", None), ("unlock", None)]


def test_a_system_without_such_calls_refuses_them():
    class Elsewhere(Fake):
        is_fifo = lock_memory = cores = property()  # raises AttributeError

    with privileges(PRIVILEGES, Elsewhere()) as outcomes:
        assert [one.words for one in outcomes] == ["this system has no such call"] * 3


def test_a_program_that_had_the_priority_before_keeps_it():
    kernel = Fake(had_fifo=True)
    with privileges([FIFO], kernel) as (outcome,):
        assert outcome.is_taken
    assert kernel.done == []


def test_the_isolated_core_is_taken_where_there_is_one():
    kernel = Fake(isolated={1})
    with privileges([CORE], kernel) as (outcome,):
        assert kernel.done == [("cores", {1})]
    assert outcome.words == "core 1, isolated"
    kernel = Fake({"cores": errno.EINVAL}, isolated={7})
    with privileges([CORE], kernel) as (outcome,):
        assert "core 7, which is isolated, is not in this program's cpuset" in outcome.text


def test_priority_of_a_thread_that_ends_with_it_is_not_given_back():
    kernel = Fake()
    assert take_priority(kernel).is_taken
    assert kernel.done == [("fifo", 40)]
    beside = Fake()
    assert take_priority(beside, EMULATED).is_taken
    assert beside.done == [("fifo", 39)]
    assert not take_priority(Fake({"fifo": errno.EPERM})).is_taken


@pytest.mark.parametrize(
    ("text", "cores"), [("", set()), ("3\n", {3}), ("0,2-4,9", {0, 2, 3, 4, 9})]
)
def test_lists_of_cores_are_read(text, cores):
    assert parsed_cores(text) == cores


def test_this_computer_gives_back_what_it_gave():
    def now():
        with open("/proc/self/status") as file:
            locked = [line.split()[1] for line in file if line.startswith("VmLck")]
        return locked, os.sched_getscheduler(0), os.sched_getaffinity(0)

    before = now()
    with privileges(PRIVILEGES) as outcomes:
        taken = {one.name: one.is_taken for one in outcomes}
        (locked,), policy, cores = now()
        assert taken[MEMORY] == (int(locked) > 0)
        assert taken[FIFO] == (policy == os.SCHED_FIFO)
        assert not taken[CORE] or len(cores) == 1
    assert now() == before
    assert KERNEL.limit(resource.RLIMIT_RTPRIO) is None or all(
        "\n" not in one.text for one in outcomes
    )
