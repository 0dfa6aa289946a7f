"""Guard between what is asked of the plate and the sliders: it slows down and stops short."""

import weakref
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.core.ports import declare_cached, is_on, read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import CONFIGURATIONS, BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    UnreachablePlate,
    forward_kinematics,
    margins,
    slider_places,
    slider_rates,
)
from parapod.systems.terrain_simulator.path import PathLimits

_LINE = LIMITS.index("line P T A_3")
_TRIES = 6  # halvings of a step that comes too close to a limit, before none is taken
_ROUNDING = 1e-6  # share of a limit that is met exactly
_LEFT = 0.2  # share of a margin that a step leaves at least
_SHORTER = 0.98  # of a step that is shortened
_SAME = 1e-5  # where it begins, a pose so near is the one that is asked for [m, rad]


@dataclass(frozen=True)
class SingularityGuardParams:
    """Limits that the guard keeps; all are assumptions, as the paper names no actuators.

    Attributes:
        limits: speeds and accelerations of the sliders, and the least sin mu.
        braking: rate at which the approach to a limit is slowed down [m/s^2; 1/s^2 for sin mu].
        catching_up: time constant with which the plate makes up for what it was slowed down [s].
        approach: largest speed of a slider at which it does so, and at which the plate goes where
            it is asked to be elsewhere, as after a stop [m/s]: somebody may stand beside it.
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
    towards it (3), share (1), whether it has begun (1); updated every period.

    Bad input: a pose that is not finite, or that no sliders lead to, holds the plate where it is;
    sliders that no pose belongs to brake.

    Args:
        geometry: the bench.
        params: the limits.
        period: between two updates [s].
    """

    def __init__(
        self,
        geometry: BenchGeometry = CONFIGURATIONS["pedal"],
        params: SingularityGuardParams = SingularityGuardParams(),
        period: float = 0.001,
    ):
        super().__init__()
        self.set_name("singularity_guard")
        self._geometry, self._params, self._period = geometry, params, period
        self._asked = self.DeclareVectorInputPort("pose_asked", 3)
        self._measured = self.DeclareVectorInputPort("position_measured", 3)
        self._stop = self.DeclareVectorInputPort("emergency_stop", 1)
        held = self.DeclareDiscreteState(np.concatenate((np.zeros(9), (1.0, 0.0))))
        here = {port.ticket() for port in (self._asked, self._measured, self._stop)}
        here |= {self.discrete_state_ticket(held)}
        self._next = declare_cached(self, "next", self._calc_next, here)
        after = {self._next.ticket}
        self.DeclareVectorOutputPort("position_command", 3, self._calc_command, after)
        for name, first, last in (("pose_desired", 0, 3), ("share", 9, 10)):
            calc = partial(_copy_next, weakref.ref(self), slice(first, last))
            self.DeclareVectorOutputPort(name, last - first, calc, after)
        self.DeclareVectorOutputPort("brake", 1, self._calc_brake, after)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def next_state(self, context: Context) -> Array:
        """State a period later (11), not to be changed."""
        state: Array = self._next.of(self, context)
        return state

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        state = self.next_state(context)
        command = slider_places(self._geometry, state[:3])
        known = state[-1] > 0.5 and bool(np.isfinite(command).all())
        if not known:
            measured = read_array(self._measured, context)
            command = np.where(np.isfinite(measured), measured, 0.0)
        output.SetFromVector(command)

    def _calc_brake(self, context: Context, output: BasicVector) -> None:
        braked = is_on(self._stop, context) or self.next_state(context)[-1] < 0.5
        output[0] = float(braked)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(0, self.next_state(context))

    def _calc_next(self, context: Context) -> Array:
        """Pose (3), pose asked for (3), speeds of the sliders (3), share, whether it has begun."""
        now = context.get_discrete_state(0).value().copy()
        asked = read_array(self._asked, context)
        if now[-1] < 0.5 or is_on(self._stop, context):
            return self._begin(read_array(self._measured, context), asked)
        if not np.isfinite(asked).all():
            asked = now[3:6]
        pose, before, rates = now[:3], now[3:6], now[6:9]
        wanted = self._motion(pose, before, asked)
        share = self._admissible(pose, wanted, rates)
        if share == 0.0:
            return np.concatenate((pose, asked, np.zeros(3), (0.0, 1.0)))
        # To the last bit where it is asked, lest errors add up.
        on_way = (asked - pose) / self._period
        arrives = share == 1.0 and np.array_equal(wanted, on_way)
        moved = asked if arrives else pose + share * self._period * wanted
        going = slider_rates(self._geometry, pose, share * wanted)
        return np.concatenate((moved, asked, going, (share, 1.0)))

    def _begin(self, measured: Array, asked: Array) -> Array:
        """State at the pose where the sliders are, at rest."""
        try:
            pose = forward_kinematics(self._geometry, measured)
        except UnreachablePlate:
            return np.concatenate((np.zeros(9), (0.0, 0.0)))
        near = np.abs(asked - pose) <= _SAME
        pose = asked if near.all() else pose
        return np.concatenate((pose, pose, np.zeros(3), (0.0, 1.0)))

    def _motion(self, pose: Array, before: Array, asked: Array) -> Array:
        """Speed of the plate that is wanted: that of what is asked, and what it is behind."""
        params = self._params
        along = (asked - before) / self._period
        fastest = np.abs(slider_rates(self._geometry, pose, along)).max()
        if not fastest <= params.limits.slider_speed * (1.0 + _ROUNDING):
            along = np.zeros(3)  # a jump is no motion
        elif np.array_equal(before, pose):
            return along
        behind = (before - pose) / params.catching_up
        fastest = float(np.abs(slider_rates(self._geometry, pose, behind)).max())
        if not np.isfinite(fastest):
            return along
        return along + behind * min(1.0, params.approach / max(fastest, 1e-12))

    def _admissible(self, pose: Array, wanted: Array, before: Array) -> float:
        """Share of a speed that the limits allow."""
        if not wanted.any():
            return 1.0
        kept, period = self._params.limits, self._period
        rates = slider_rates(self._geometry, pose, wanted)
        if not np.isfinite(rates).all():
            return 0.0
        fastest = float(np.abs(rates).max())
        share = min(1.0, kept.slider_speed * (1.0 + _ROUNDING) / max(fastest, 1e-12))
        share = _accelerated(share, rates, before, kept.slider_acceleration * period)
        here = self._margins(pose)
        least = np.where(
            here > 0.0,
            np.maximum(
                here - period * np.sqrt(2.0 * self._params.braking * np.maximum(here, 0.0)),
                _LEFT * here,
            ),
            here,
        )
        for _ in range(_TRIES):
            there = self._margins(pose + share * period * wanted)
            short = ~(there >= least - _ROUNDING * np.abs(least))
            if not short.any():
                return share
            lost, allowed = (here - there)[short], (here - least)[short]
            with np.errstate(invalid="ignore", divide="ignore"):
                parts = np.where(np.isfinite(lost), allowed / lost, 0.5)
            share *= float(min(max(parts.min() * _SHORTER, 0.0), _SHORTER))
        return 0.0

    def _margins(self, pose: Array) -> Array:
        left = margins(self._geometry, pose)
        left[_LINE] -= self._params.limits.sin_mu
        return left


def _accelerated(share: float, rates: Array, before: Array, change: float) -> float:
    """Share, as near to the one that is wanted as accelerations allow."""
    moving = np.abs(rates) > 1e-9
    if not moving.any():
        return share
    low, high = (
        (before[moving] - change) / rates[moving],
        (before[moving] + change) / rates[moving],
    )
    least, most = np.minimum(low, high).max(), np.maximum(low, high).min()
    if least > most:  # no share keeps them all: the least that is asked of the worst
        least = most = 0.5 * (least + most)
    slack = _ROUNDING * max(abs(most), 1.0)
    return float(min(max(share, max(least, 0.0)), max(most + slack, 0.0), 1.0))


def _copy_next(
    guard: weakref.ref[SingularityGuard], part: slice, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = guard()
    assert system is not None
    output.SetFromVector(system.next_state(context)[part])
