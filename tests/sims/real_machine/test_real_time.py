import gc
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from parapod.sims.real_machine.real_time import (
    KEPT,
    DeadlineError,
    RealTimeLoop,
    Timing,
    percentiles,
    rehearse,
    undisturbed,
)
from parapod.systems.hardware.addresses import WIRES
from parapod.systems.hardware.signals import ended_by_signals

PERIOD = 0.01


class World:
    """A clock that stands still unless somebody sleeps or a tick takes its time."""

    def __init__(self, costs=(), oversleeps=()):
        self.now, self.costs, self.started = 50.0, dict(costs), []
        self.oversleeps = dict(oversleeps)  # by tick [s]

    def clock(self):
        return self.now

    def sleep(self, duration):
        self.now += duration + self.oversleeps.get(len(self.started), 0.0)

    def tick(self, context):
        self.started.append(self.now)
        self.now += self.costs.get(len(self.started) - 1, 0.001)


def run(world, ticks, **options):
    simulator = Simulator(ConstantVectorSource([0.0]))
    simulator.Initialize()
    loop = RealTimeLoop(
        simulator, PERIOD, world.tick, clock=world.clock, sleep=world.sleep, **options
    )
    loop.run(ticks * PERIOD)
    return loop.timing


def test_ticks_are_due_at_multiples_of_the_period_whatever_they_cost():
    world = World({k: 0.001 * (k % 5) for k in range(20)})
    timing = run(world, 20)
    assert world.started == pytest.approx([50.0 + k * PERIOD for k in range(20)])
    assert timing.missed == 0
    assert max(timing.late) == pytest.approx(0.0)


def test_a_schedule_that_is_shifted_stays_so_and_nothing_counts_as_late():
    world, dues = World(), []

    def shift(due):
        dues.append(due)
        return 0.0002 if len(dues) < 4 else 0.0

    timing = run(world, 8, shift=shift)
    assert dues == pytest.approx(world.started)
    assert np.diff(world.started) == pytest.approx(3 * [PERIOD + 0.0002] + 4 * [PERIOD])
    assert max(timing.late) == pytest.approx(0.0)
    assert timing.missed == 0


def test_a_late_tick_is_followed_by_no_burst():
    world = World({3: 0.035})
    timing = run(world, 8)
    gaps = [b - a for a, b in zip(world.started, world.started[1:], strict=False)]
    assert min(gaps) >= PERIOD - 1e-9
    # Due at 40, 50, 60 ms while the tick of 30 ms went on: left out, and back on the grid.
    assert timing.missed == 3
    assert timing.missed_at == pytest.approx([50.0 + 0.065])
    assert world.started[4] == pytest.approx(50.0 + 7 * PERIOD)


class Counter(LeafSystem):
    """Counts its updates, its outputs and what it publishes, outside of its context."""

    def __init__(self):
        super().__init__()
        self.updates = self.outputs = self.published = 0
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, self._publish)
        self.DeclareVectorOutputPort("count", 1, self._output)

    def _update(self, context, state):
        self.updates += 1
        state.set_value(context.get_discrete_state_vector().value() + 1.0)

    def _output(self, context, output):
        self.outputs += 1
        output.set_value(context.get_discrete_state_vector().value())

    def _publish(self, context):
        self.published += 1


def test_a_rehearsal_calculates_what_a_tick_does_and_leaves_no_trace():
    builder = DiagramBuilder()
    inner = DiagramBuilder()
    counter = inner.AddSystem(Counter())
    builder.AddSystem(inner.Build())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    rehearse(diagram, context)
    assert (counter.updates, counter.outputs, counter.published) == (1, 1, 0)
    assert counter.GetMyContextFromRoot(context).get_discrete_state_vector().value() == [0.0]


def test_a_tick_that_is_far_too_late_ends_the_loop():
    with pytest.raises(DeadlineError, match="ms after the next was due"):
        run(World({3: 0.2}), 8)


@pytest.mark.parametrize("kept", [KEPT, 1])
def test_a_computer_that_is_too_slow_ends_the_loop(kept):
    with pytest.raises(DeadlineError, match="too slow"):
        run(World(dict.fromkeys(range(400), 0.012)), 400, kept=kept)


@pytest.mark.parametrize("late", [0.012, 0.025, 0.098])
def test_ticks_that_begin_late_miss_deadlines_like_those_that_take_long(late):
    world = World(oversleeps=dict.fromkeys(range(100, 400), late))
    with pytest.raises(DeadlineError, match=r"\d+ of 100 deadlines were missed at a period of 10"):
        run(world, 400)
    # At the latest when a second has passed.
    assert 0.4 < world.now - 51.0 < 1.1
    # Late, but before the next is due.
    assert run(World(oversleeps=dict.fromkeys(range(400), 0.008)), 400).missed == 0


def test_a_tick_that_would_begin_far_too_late_is_not_begun():
    world = World(oversleeps={3: 0.11})
    with pytest.raises(DeadlineError, match="would have begun 110 ms late"):
        run(world, 8)
    assert len(world.started) == 3


def test_a_computer_that_is_slow_for_less_than_half_of_a_second_goes_on():
    timing = run(World(dict.fromkeys([*range(40), *range(300, 340)], 0.012)), 400)
    assert timing.missed == 80


def test_an_emulator_goes_on_however_late_it_is():
    timing = run(World({3: 0.5}), 8, is_strict=False)
    assert timing.missed > 0
    assert timing.ticks == len(timing.cost) == 8


def test_physics_makes_up_for_lost_time_at_most_a_quarter_faster_than_the_clock():
    world = World({3: 0.055})
    timing = run(world, 60, is_strict=False, patience=0.1)
    assert (timing.missed, timing.ticks) == (0, 60)
    gaps = [b - a for a, b in zip(world.started, world.started[1:], strict=False)]
    assert min(gaps) == pytest.approx(0.8 * PERIOD)
    # 45 ms are made up for by 2 ms a tick, and then the ticks are on the grid again.
    assert gaps[4:26] == pytest.approx([0.8 * PERIOD] * 22)
    assert world.started[30:] == pytest.approx([50.0 + k * PERIOD for k in range(30, 60)])


def test_physics_that_is_too_late_leaves_out_what_it_cannot_make_up_for():
    timing = run(World({3: 0.055}), 60, is_strict=False, patience=0.03)
    assert timing.missed == 5


def test_the_real_clock_is_kept_to(judge):
    simulator = Simulator(ConstantVectorSource([0.0]))
    simulator.Initialize()
    loop = RealTimeLoop(simulator, PERIOD, is_strict=False)
    with judge() as judged:
        loop.run(0.3)
    assert judged.took >= 0.28
    assert simulator.get_context().get_time() == pytest.approx(0.295)
    assert loop.timing.ticks + loop.timing.missed >= 30
    judged.check(2.0)


def test_period_error_is_what_two_late_ticks_differ_by():
    timing = Timing(PERIOD)
    for late in (0.0, 0.003, 0.001):
        timing.add(late, 0.0)
    assert timing.period_error == pytest.approx([0.003, 0.002])


def test_a_loop_that_runs_for_long_keeps_the_newest_ticks_and_counts_all():
    timing = run(World({k: 1e-5 * (k + 1) for k in range(50)}), 50, kept=20)
    assert timing.cost == pytest.approx([1e-5 * (k + 1) for k in range(30, 50)])
    assert (len(timing.late), len(timing.period_error)) == (20, 19)
    assert timing.ticks == 50


def test_ticks_are_kept_up_to_a_bound_unless_all_are_wanted():
    assert Timing(PERIOD).late.maxlen == Timing(PERIOD).cost.maxlen == KEPT
    assert Timing(PERIOD, None).late.maxlen is Timing(PERIOD, None).cost.maxlen is None


def test_percentiles_of_nothing_are_not_numbers():
    assert percentiles([1.0, 2.0, 3.0])[0] == 2.0
    assert percentiles([]) == pytest.approx([float("nan")] * 3, nan_ok=True)


def test_the_garbage_collector_is_away_meanwhile_and_back_after():
    interval = sys.getswitchinterval()
    with undisturbed():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert sys.getswitchinterval() == interval


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, also where the tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_in_the_middle_of_a_tick_ends_the_loop_after_it(name):
    """Raised in a conversion to C++ it would become a TypeError about another argument."""
    done = []

    def tick(context):
        if len(done) == 2:
            os.kill(os.getpid(), getattr(signal, name))
            for _ in range(100):
                context.SetTime(context.get_time())  # where the interpreter looks for signals
        done.append(context.get_time())

    simulator = Simulator(ConstantVectorSource([1.0]))
    simulator.Initialize()
    with ended_by_signals(), pytest.raises(KeyboardInterrupt):
        RealTimeLoop(simulator, 0.001, tick).run(1.0)
    assert len(done) == 3


def test_a_second_signal_ends_a_tick_that_hangs():
    reached = []

    def tick(context):
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.01)
            reached.append(True)

    simulator = Simulator(ConstantVectorSource([1.0]))
    simulator.Initialize()
    with ended_by_signals(), pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        RealTimeLoop(simulator, 0.001, tick).run(1.0)
    assert len(reached) == 1


def test_a_signal_ends_a_tick_that_hangs_already():
    def tick(context):
        time.sleep(0.15)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)
        raise AssertionError("the tick went on")

    simulator = Simulator(ConstantVectorSource([1.0]))
    simulator.Initialize()
    with ended_by_signals(), pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        RealTimeLoop(simulator, 0.001, tick, is_strict=False).run(1.0)


@pytest.mark.usefixtures("interruptible")
def test_a_signal_in_the_last_tick_is_not_lost():
    simulator = Simulator(ConstantVectorSource([1.0]))
    simulator.Initialize()
    with ended_by_signals(), pytest.raises(KeyboardInterrupt):
        RealTimeLoop(simulator, 0.001, lambda context: os.kill(os.getpid(), signal.SIGTERM)).run(
            0.001
        )
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# Begins a program in a session of its own, as a test or a shell does, and tells its number.
PARENT = """
import subprocess, sys
child = subprocess.Popen(sys.argv[1:], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                         start_new_session=True)
while "ready" not in child.stderr.readline():
    assert child.poll() is None
print(child.pid, flush=True)
child.wait()
"""


def test_an_emulator_ends_with_the_program_that_began_it(tmp_path, in_time):
    directory = tmp_path / "e"
    emulator = (sys.executable, "-m", "parapod.sims", "emulate", "level", "--backend", "kinematic")
    parent = subprocess.Popen(
        (sys.executable, "-c", PARENT, *emulator, "--set", "hardware.drivers=[]"),
        env=os.environ | {"PARAPOD_EMULATOR": str(directory)},
        stdout=subprocess.PIPE,
        text=True,
    )
    number = int(parent.stdout.readline())
    try:
        time.sleep(0.5)
        os.kill(number, 0)  # it lives, like its parent
        assert (directory / WIRES).exists()
        parent.kill()
        parent.wait()
        began = time.monotonic()
        while (directory / WIRES).exists() and time.monotonic() < began + 60.0:
            time.sleep(0.01)
        # In peace: it has taken its wires with it.
        assert not (directory / WIRES).exists()
        in_time(time.monotonic() - began, 2.0, "end after the parent was killed [s]")
    finally:
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
