"""Largest age of measurements on computers that are quiet, slow, or too slow."""

from types import SimpleNamespace

import pytest

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import list_machines
from parapod.diagrams.wiring import leaf_systems
from parapod.sims.real_machine.age_limit import Ages, ages_of, allow_old_measurements
from parapod.sims.real_machine.real_time import DeadlineError
from parapod.systems.hardware.io import STALE_AFTER

SAID = "measurements are up to {} ms old on this computer: their limit of age is {} ms in place of"


class Computer:
    """A clock, and the thread of a device that measures some time before it is looked at."""

    def __init__(self, age=0.005, late=0.0, error=None, of=None, measures=(("position", 1),)):
        self.now, self.age, self.late, self.error = 50.0, age, late, error
        self.clock_of, self.takes = of or self, 0
        self.device = SimpleNamespace(measures=dict(measures))

    @property
    def sample(self):
        return SimpleNamespace(stamp=self.clock_of.now - self.age)

    def taken(self):
        self.takes += 1

    def clock(self):
        return self.now

    def sleep(self, duration):
        self.now += duration + self.late

    def ages(self, *others):
        return ages_of([self, *others], 0.01, self.clock, self.sleep)


def test_ages_are_looked_at_for_half_a_second_and_samples_are_taken():
    computer = Computer(age=0.02, late=0.003)
    seen = computer.ages()
    assert seen == pytest.approx((0.02, 0.003))
    assert computer.now == pytest.approx(50.5, abs=0.02)
    assert computer.takes == pytest.approx(50, abs=1)


def test_the_oldest_device_counts_and_one_that_is_at_fault_or_measures_nothing_does_not():
    computer = Computer(age=0.01)
    others = [
        Computer(age=0.04, of=computer),
        Computer(age=0.3, of=computer, error="the fuse is blown"),
        Computer(age=0.3, of=computer, measures={}),
    ]
    assert computer.ages(*others).oldest == pytest.approx(0.04)
    assert all(other.takes == computer.takes for other in others)


@pytest.fixture(scope="module", params=list_machines(), ids=lambda machine: machine.name)
def job(request):
    """The loop of a machine's real job, its context, and a fresh guard."""
    machine = request.param
    if "hardware" not in machine.backends or machine.real.guard is None:
        pytest.skip("it has no real jobs")
    scenario = machine.scenario(backend="hardware")
    loop = ClosedLoop(machine, scenario)
    return loop, loop.CreateDefaultContext(), lambda: machine.real.guard(scenario)


def limits_after(job, *seen):
    """Largest ages by which all that watches them goes, and what is said."""
    loop, root, make = job
    loop.SetDefaultContext(root)
    guard, said, looks = make(), [], iter([Ages(age, 0.004) for age in seen])
    allow_old_measurements(loop, root, guard, lambda: next(looks), said.append)
    limits = [
        system.oldest(system.GetMyContextFromRoot(root))
        for system in leaf_systems(loop)
        if hasattr(system, "allow_age")
    ]
    detector = getattr(guard, "_detector", None)
    limits.append(guard._oldest if detector is None else detector.oldest(guard._context))
    return limits, said


def test_a_quiet_computer_changes_nothing_and_nothing_is_said(job):
    usual, said = limits_after(job, 0.0)
    assert not said
    assert set(usual) <= {0.05, 0.06}
    assert limits_after(job, 0.012) == (usual, [])
    assert limits_after(job, 0.025) == (usual, [])


def test_a_slow_computer_raises_all_limits_and_says_so_in_one_line(job):
    (usual, *_), _ = limits_after(job, 0.0)
    limits, said = limits_after(job, 0.038)
    assert limits == pytest.approx([0.08] * len(limits))
    assert said == [f"{SAID.format(38, 80)} {1e3 * usual:.0f}"]


def test_no_limit_is_above_the_age_at_which_measurements_are_no_numbers(job):
    for age in (0.05, 0.07, STALE_AFTER):
        limits, (line,) = limits_after(job, age)
        assert limits == [STALE_AFTER] * len(limits)
        assert "their limit of age is 100 ms" in line


def test_a_computer_that_is_too_slow_twice_is_refused_and_once_is_forgiven(job):
    with pytest.raises(DeadlineError) as caught:
        limits_after(job, 0.2, 0.13)
    assert str(caught.value) == (
        "measurements would be up to 130 ms old when they are taken, and this program wakes up to "
        "4 ms late; above 100 ms no machine is driven"
    )
    usual, _ = limits_after(job, 0.0)
    assert limits_after(job, 0.2, 0.01) == (usual, [])
