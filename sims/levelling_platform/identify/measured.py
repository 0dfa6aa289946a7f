"""Voltage steps without and with load on one machine, as the real one has to make them.

The machine begins on its wheels with the legs lifted. The steps without load are made there; then
the legs are lowered onto level ground until the platform stands, and the steps with load follow.
"""

from functools import partial

import numpy as np
from pydrake.systems.framework import System
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import named_source
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.identify.steps import Recording, StepPlan, eased_schedule
from parapod.sims.levelling_platform.leg_job import (
    AT_REST,
    LegJob,
    LegWatch,
    carry_out,
    refuse_beginning,
)
from parapod.systems.levelling_platform.eased_legs import easing_time
from parapod.systems.levelling_platform.geometry import LEG_COUNT

# Positions at which the feet of a machine on its wheels are in the air, before the end switches
# [m].
LIFTED = (0.428, 0.458)
# Rest after each way [s], and largest rate of a lifted leg [m/s].
_SETTLE, _LIFTING = 2.0, 5e-3
_SWITCHED = 0.05  # from control to voltages [s]


class _Timeline:
    """Times of a job in which both cases follow each other on one machine.

    Attributes:
        lift: the legs are brought to where the steps without load begin [s].
        unloaded: beginning and end of the steps without load [s].
        lower: beginning and end of the way to the ground [s].
        loaded: beginning and end of the steps with load [s].
    """

    def __init__(self, plan: StepPlan, machine: PlatformDesign):
        lasts = eased_schedule(plan).end_time()
        self.lift = AT_REST
        lifted = plan.lifted_extension
        low, high = machine.lifted_stroke
        farthest = max(high - lifted, lifted - low)
        begin = self.lift + easing_time(farthest, _LIFTING) + _SETTLE
        self.unloaded = begin, begin + lasts
        # What the steps leave the legs off is eased first.
        begin = self.unloaded[1] + _SETTLE
        way = lifted - plan.initial_extension
        self.lower = begin, begin + 1.5 * way / plan.lowering_rate
        begin = self.lower[1] + _SETTLE
        self.loaded = begin, begin + lasts

    def sources(self, plan: StepPlan) -> tuple[System, ...]:
        """Sources of what a `LegJob` asks for."""
        ends = [plan.lifted_extension, plan.initial_extension]
        knots = [0.0, *self.lower, self.loaded[1] + 1.0]
        values = [[[ends[0]] * 2 + [ends[1]] * 2] * LEG_COUNT, [[0.0] * 4] * LEG_COUNT]
        request = PiecewisePolynomial.CubicHermite(knots, *values)
        switches = [0.0, self.lift, self.unloaded[0], self.unloaded[1], self.loaded[0]]
        enable = PiecewisePolynomial.ZeroOrderHold(
            [*switches, self.loaded[1] + 1.0], [[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]]
        )
        voltage, times, columns = eased_schedule(plan), [0.0], [np.zeros((LEG_COUNT, 1))]
        for begin, _ in (self.unloaded, self.loaded):
            for at in voltage.get_segment_times():
                times.append(begin + at)
                columns.append(voltage.value(at))
        return (
            named_source("extension_request", request, 1),
            named_source("legs_enable", enable),
            named_source(
                "voltage_request",
                PiecewisePolynomial.FirstOrderHold(times, np.hstack(columns).tolist()),
            ),
        )


class _StepsWatch(LegWatch):
    """Notes both cases, and refuses a machine that does not begin with lifted legs."""

    def check_beginning(self) -> None:
        """See `LegWatch`."""
        low, high = (1e3 * limit for limit in self.machine.lifted_stroke)
        for leg, (length, touches) in enumerate(
            zip(1e3 * self.newest("legs.extension"), self.touching, strict=True)
        ):
            begin = f"begin on the wheels, with all legs at {low:g}..{high:g} mm"
            if touches:
                raise refuse_beginning(leg, f"touches the ground; {begin}")
            if not low <= length <= high:
                raise refuse_beginning(leg, f"is at {length:.1f} mm; {begin}")

    def recording(self, span: tuple[float, float], is_loaded: bool = False) -> Recording:
        """Recording of one case.

        Args:
            span: beginning and end of its steps [s].
            is_loaded: true if the attitude counts.
        """
        period = self._loop.scenario.control.period
        # At the very beginning the controller's last voltage is still there.
        rows = slice(round((span[0] + _SWITCHED) / period), round(span[1] / period))
        time = self.column("t")[rows]
        return Recording(
            time - time[0],
            self.column("legs.voltage")[rows],
            self.column("legs.extension")[rows],
            self.column("attitude_estimated")[rows] if is_loaded else None,
        )


def record_in_turn(
    plan: StepPlan, machine: LevellingScenario, runner: Runner
) -> tuple[Recording, Recording]:
    """The steps without load, and those with load, one after the other on one machine.

    Args:
        plan: the voltage steps.
        machine: the machine, on its wheels.
        runner: runs the job.

    Raises:
        RefusedRequest: it is not on its wheels with the legs lifted; nothing has moved.
        Tripped: it tilts, or its guard has found what cannot be.
    """
    timeline = _Timeline(plan, machine.machine)
    sources = partial(timeline.sources, plan)
    job = LegJob(runner.name, sources, timeline.loaded[1], _LIFTING, has_voltage=True)
    watch = carry_out(job, machine, runner, _StepsWatch)
    return watch.recording(timeline.unloaded), watch.recording(timeline.loaded, is_loaded=True)
