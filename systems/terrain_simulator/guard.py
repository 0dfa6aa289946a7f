"""Guard between the plate's commands and the sliders: it slows down and stops short."""

import math
import weakref
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, is_on, read, read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    UnreachablePlate,
    forward_kinematics,
    places_and_margins,
    slider_rates,
)
from parapod.systems.terrain_simulator.path import PathLimits

_LINE = LIMITS.index("line P T A_3")
_TRIES = 6  # halvings of a step that comes too close to a limit, before none is taken
_ROUNDING = 1e-6  # share of a limit that is met exactly
_LEFT = 0.2  # share of a margin that a step leaves at least
_SHORTER = 0.98  # share of a step by which it is shortened
# Parts of the state.
_POSE, _ASKED, _RATES, _SHARE, _BEGUN = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10
_PLACES, _MARGINS, _SIZE = slice(11, 14), slice(14, 27), 27
_SAME = 1e-5  # poses closer to the start than this are the requested one [m, rad]


@dataclass(frozen=True)
class SingularityGuardParams:
    """Limits that the guard keeps; all are assumptions, as the paper names no actuators.

    Attributes:
        limits: speeds and accelerations of the sliders, and the least sin mu.
        braking: rate at which the approach to a limit is slowed down [m/s^2; 1/s^2 for sin mu].
        catching_up: time constant with which the plate makes up for what it was slowed down [s].
        approach: largest speed of a slider at which it does so, and at which the plate goes where
            it is asked to be elsewhere, as after a stop [m/s]: a person may stand beside it.
    """

    limits: PathLimits = field(default_factory=PathLimits)
    braking: float = 110.0
    catching_up: float = 0.1
    approach: float = 0.25


class SingularityGuard(LeafSystem):
    """Leads the plate where it is asked to be, as far as limits and singularities allow.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose_asked` | 3 | m, m, rad | x, z, phi that the plate is to have a period later |
    | in `position_measured` | 3 | m | the sliders, where it begins |
    | in `emergency_stop` | 1 | 0/1 | whether it is pressed |
    | out `position_command` | 3 | m | the sliders a period later |
    | out `pose_desired` | 3 | m, m, rad | the plate then |
    | out `share` | 1 | - | of the speed that is asked for; 1: not slowed down |
    | out `brake` | 1 | 0/1 | 1: the sliders stop and hold |

    A path that keeps the limits passes unchanged. Near a limit of the mechanism, of `margins` and
    of the least sin mu, a step towards it is shortened along its way, so that the margin m falls
    at sqrt(2 b m) at most and never below zero, whatever is asked; one away from it is free.
    Speeds and accelerations of the sliders are kept, but where only a sudden stop keeps a margin.
    What has been lost is made up for, slowly; a pose that no motion leads to, as at the beginning
    or after a stop, is approached slowly too.

    It begins where the sliders are measured. While they are braked, it stays where they are.

    State: discrete; pose at the next instant (3), pose asked for then (3), speeds of the sliders
    towards it (3), share (1), whether it has begun (1), places of the sliders (3) and margins (13)
    of the pose; updated every period.

    Bad input: a pose that is not finite, or that no sliders lead to, holds the plate where it is;
    sliders that no pose belongs to brake.

    Args:
        geometry: the bench.
        params: the limits.
        period: between two updates [s].
    """

    def __init__(
        self,
        geometry: BenchGeometry = BenchGeometry.pedal(),
        params: SingularityGuardParams = SingularityGuardParams(),
        period: float = 0.001,
    ):
        super().__init__()
        self.set_name("singularity_guard")
        self._geometry, self._params, self._period = geometry, params, period
        self._asked = self.DeclareVectorInputPort("pose_asked", 3)
        self._measured = self.DeclareVectorInputPort("position_measured", 3)
        self._stop = self.DeclareVectorInputPort("emergency_stop", 1)
        rest = np.zeros(_SIZE)
        rest[_SHARE] = 1.0
        state = self.DeclareDiscreteState(rest)
        here = {port.ticket() for port in (self._asked, self._measured, self._stop)}
        here |= {self.discrete_state_ticket(state)}
        self._next = declare_cached(self, "next", self._calc_next, here)
        after = {self._next.ticket}
        self.DeclareVectorOutputPort("position_command", 3, self._calc_command, after)
        for name, part in (("pose_desired", _POSE), ("share", slice(_SHARE, _BEGUN))):
            calc = partial(_copy_next, weakref.ref(self), part)
            self.DeclareVectorOutputPort(name, part.stop - part.start, calc, after)
        self.DeclareVectorOutputPort("brake", 1, self._calc_brake, after)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def next_state(self, context: Context) -> Array:
        """State a period later (27), not to be changed."""
        state: Array = self._next.value(self, context)
        return state

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        state = self.next_state(context)
        command = state[_PLACES]
        if state[_BEGUN] < 0.5:
            measured = read_array(self._measured, context)
            command = np.where(np.isfinite(measured), measured, 0.0)
        output.SetFromVector(command)

    def _calc_brake(self, context: Context, output: BasicVector) -> None:
        braked = is_on(self._stop, context) or self.next_state(context)[_BEGUN] < 0.5
        output[0] = float(braked)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(0, self.next_state(context))

    def _calc_next(self, context: Context) -> Array:
        now = context.get_discrete_state(0).value().tolist()
        desired_pose = read(self._asked, context)
        if now[_BEGUN] < 0.5 or is_on(self._stop, context):
            return self._begin(read_array(self._measured, context), desired_pose)
        pose, before = now[_POSE], now[_ASKED]
        if not all(map(math.isfinite, desired_pose)):
            desired_pose = before
        step, going = self._motion(pose, before, desired_pose)
        place = _Place(pose, now[_PLACES], now[_MARGINS])
        share, next_place = self._admissible(place, desired_pose, step, going, now[_RATES])
        going = [share * rate for rate in going]
        return np.array(
            (
                *next_place.pose,
                *desired_pose,
                *going,
                share,
                1.0,
                *next_place.places,
                *next_place.margins,
            )
        )

    def _begin(self, measured: Array, desired_pose: list[float]) -> Array:
        """State at the pose where the sliders are, at rest."""
        try:
            pose = forward_kinematics(self._geometry, measured)
        except UnreachablePlate:
            return np.zeros(_SIZE)
        near = np.abs(desired_pose - pose) <= _SAME
        place = self._place(desired_pose if near.all() else pose.tolist())
        if not np.isfinite(place.places).all():
            return np.zeros(_SIZE)
        return np.array(
            (*place.pose, *place.pose, *np.zeros(3), 0.0, 1.0, *place.places, *place.margins)
        )

    def _motion(
        self, pose: list[float], before: list[float], desired_pose: list[float]
    ) -> tuple[list[float], list[float]]:
        """Desired speeds of plate and sliders: as commanded, and to make up for the delay."""
        params, period = self._params, self._period
        along = [(after - now) / period for after, now in zip(desired_pose, before, strict=True)]
        going = slider_rates(self._geometry, pose, along).tolist()
        fastest = params.limits.slider_speed * (1.0 + _ROUNDING)
        if not all(abs(rate) <= fastest for rate in going):
            along, going = [0.0] * 3, [0.0] * 3  # a jump is not a motion
        elif before == pose:
            return along, going
        behind = [
            (there - here) / params.catching_up for there, here in zip(before, pose, strict=True)
        ]
        coming = slider_rates(self._geometry, pose, behind).tolist()
        if not all(map(math.isfinite, coming)):
            return along, going
        share = min(1.0, params.approach / max(*map(abs, coming), 1e-12))
        return _added(along, share, behind), _added(going, share, coming)

    def _admissible(
        self,
        here: "_Place",
        desired_pose: list[float],
        step: list[float],
        rates: list[float],
        before: list[float],
    ) -> tuple[float, "_Place"]:
        """Share of a speed that the limits allow, and where the plate comes with it."""
        limits, period = self._params.limits, self._period
        share = min(1.0, limits.slider_speed * (1.0 + _ROUNDING) / max(*map(abs, rates), 1e-12))
        share = _accelerated(share, rates, before, limits.slider_acceleration * period)
        # To the last bit where it is asked, so that errors do not add up.
        on_way = step == [
            (to - at) / period for to, at in zip(desired_pose, here.pose, strict=True)
        ]
        for _ in range(_TRIES):
            arrives = on_way and share == 1.0
            next_place = self._place(
                desired_pose if arrives else _added(here.pose, share * period, step)
            )
            parts = [
                self._part(margin, next_margin)
                for margin, next_margin in zip(here.margins, next_place.margins, strict=True)
                if not next_margin >= margin
            ]
            if not parts or min(parts) >= 1.0:
                return share, next_place
            share *= min(max(min(parts) * _SHORTER, 0.0), _SHORTER)
        return 0.0, here

    def _part(self, margin: float, next_margin: float) -> float:
        """Share that is allowed of a step by which a margin falls; 1 and more: all of it."""
        if not math.isfinite(next_margin):
            return 0.5
        least = margin
        if margin > 0.0:
            falling = self._period * math.sqrt(2.0 * self._params.braking * margin)
            least = max(margin - falling, _LEFT * margin)
        if next_margin >= least - _ROUNDING * abs(least):
            return 1.0
        return (margin - least) / (margin - next_margin)

    def _place(self, pose: list[float]) -> "_Place":
        places, margins = places_and_margins(self._geometry, pose)
        margins[_LINE] -= self._params.limits.sin_mu
        return _Place(pose, places.tolist(), margins.tolist())


class _Place(NamedTuple):
    """A pose (3) of the plate, its sliders' places (3), and what is left to the limits (13)."""

    pose: list[float]
    places: list[float]
    margins: list[float]


def _added(numbers: list[float], share: float, more: list[float]) -> list[float]:
    return [one + share * other for one, other in zip(numbers, more, strict=True)]


def _accelerated(share: float, rates: list[float], before: list[float], change: float) -> float:
    """Share, as near to the one that is wanted as accelerations allow."""
    least, most = -math.inf, math.inf
    for rate, was in zip(rates, before, strict=True):
        if abs(rate) > 1e-9:
            ends = (was - change) / rate, (was + change) / rate
            least, most = max(least, min(ends)), min(most, max(ends))
    if math.isinf(least):  # none moves
        return share
    if least > most:  # no share keeps them all: the least that is asked of the worst
        least = most = 0.5 * (least + most)
    slack = _ROUNDING * max(abs(most), 1.0)
    return min(max(share, max(least, 0.0)), max(most + slack, 0.0), 1.0)


def _copy_next(
    guard: weakref.ref[SingularityGuard], part: slice, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = guard()
    assert system is not None
    output.SetFromVector(system.next_state(context)[part])
