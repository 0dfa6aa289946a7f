"""Figures of speed beside a yardstick: their verdicts, and what is taken when."""

import sys
from itertools import count
from pathlib import Path

import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

ROOT = Path(__file__).parents[1]


@pytest.fixture
def benchmarks(monkeypatch):
    """The modules of the yardsticks and of the report."""
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks import report, yardstick

    yield yardstick, report
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]


QUIET = 0.01


@pytest.mark.parametrize(
    ("value", "at_most", "samples", "verdict"),
    [
        (60.0, False, (0.010, 0.010), "ok"),
        (59.0, False, (0.010, 0.010), "missed"),
        # Half as fast on a machine of half the speed is as fast, and no faster.
        (30.0, False, (0.020, 0.0201), "ok"),
        (29.0, False, (0.020, 0.0201), "missed"),
        # On a faster machine more is asked for.
        (60.0, False, (0.005, 0.005), "missed"),
        (120.0, True, (0.020, 0.020), "ok"),
        (121.0, True, (0.020, 0.020), "missed"),
        (59.0, True, (0.005, 0.005), "missed"),
        # A yardstick that scatters tells nothing, but what holds all the same does.
        (29.0, False, (0.020, 0.020, 0.030), "too busy to judge"),
        (31.0, False, (0.020, 0.030, 0.020), "ok"),
        (200.0, True, (0.030, 0.020), "too busy to judge"),
    ],
)
def test_speed_is_judged_beside_its_yardstick(benchmarks, value, at_most, samples, verdict):
    yardstick, report = benchmarks
    pace = yardstick.Pace("fake", samples, QUIET)
    found = report.Measurement("speed", value, "x", 60.0, at_most=at_most, pace=pace)
    assert found.verdict == verdict
    assert found.passed == (verdict != "missed")


def test_without_a_yardstick_or_a_bound_the_figure_counts(benchmarks):
    _, report = benchmarks
    assert report.Measurement("error", 1.0, "mm", 2.0, at_most=True).verdict == "ok"
    assert report.Measurement("error", 3.0, "mm", 2.0, at_most=True).verdict == "missed"
    assert report.Measurement("error", 3.0, "mm").verdict == "ok"


def test_yardstick_is_taken_before_between_and_after(benchmarks, monkeypatch):
    yardstick, _ = benchmarks
    now = count()  # a clock that is read twice for each pass: each takes 1 s
    monkeypatch.setattr(yardstick, "clock", lambda: float(next(now)))
    taken = []
    fake = yardstick.Yardstick("fake", 0.5, lambda: lambda: taken.append("yardstick"))
    durations = iter((3.0, 2.0, 4.0))

    def measured():
        taken.append("figure")
        return next(durations)

    best, pace = fake.best_beside(measured, 3)
    assert best == 2.0
    assert pace.samples == (1.0,) * 4
    assert pace.slowness == 2.0
    assert pace.is_steady
    figures = [k for k, what in enumerate(taken) if what == "figure"]
    assert "yardstick" in taken[: figures[0]]
    assert all(b - a > 1 for a, b in zip(figures, [*figures[1:], len(taken)], strict=True))


@pytest.mark.parametrize("name", ["PYTHON", "NUMPY", "DRAKE"])
def test_work_of_a_yardstick_can_be_repeated(benchmarks, name):
    yardstick, _ = benchmarks
    work = getattr(yardstick, name).work()
    work()
    work()


def test_a_breakdown_counts_calls_reads_and_what_is_calculated_anew(benchmarks):
    from benchmarks import loop

    with loop.counting() as tally:
        sampler, diagram = _sampled()
        simulator = Simulator(diagram)
        simulator.AdvanceTo(0.05)
        tally.clear()
        simulator.AdvanceTo(0.95)
    found = {callback.name: callback for callback in tally.callbacks}
    assert set(found) == {"doubled", "_update"}
    # A sample every .1 s, read twice; what it depends on is calculated once.
    assert (found["doubled"].calls, found["_update"].calls) == (9, 9)
    assert (found["doubled"].reads, found["_update"].reads) == (9, 18)
    assert all(callback.seconds > 0.0 for callback in tally.callbacks)
    assert found["_update"].system is sampler


def _sampled():
    """A sampler of twice the time, and the diagram with both."""

    class Doubler(LeafSystem):
        def __init__(self):
            super().__init__()
            self.given = self.DeclareVectorInputPort("given", 1)
            self.DeclareVectorOutputPort("doubled", 1, self._calc, {self.given.ticket()})

        def _calc(self, context, output):
            output.SetFromVector(2.0 * self.given.Eval(context))

    class Sampler(LeafSystem):
        def __init__(self):
            super().__init__()
            self.signal = self.DeclareVectorInputPort("signal", 1)
            self.DeclareDiscreteState(1)
            self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.0, self._update)

        def _update(self, context, discrete_state):
            again = self.signal.Eval(context)
            discrete_state.set_value(0.5 * (self.signal.Eval(context) + again))

    builder = DiagramBuilder()
    line = PiecewisePolynomial.FirstOrderHold([0.0, 10.0], [[0.0, 10.0]])
    time = builder.AddSystem(TrajectorySource(line))
    doubler, sampler = builder.AddSystem(Doubler()), builder.AddSystem(Sampler())
    builder.Connect(time.get_output_port(), doubler.given)
    builder.Connect(doubler.get_output_port(), sampler.signal)
    return sampler, builder.Build()
