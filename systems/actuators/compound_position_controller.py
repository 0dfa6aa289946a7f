"""Position control of a velocity-controlled drive between discrete nodes, Eqs. (46)-(48)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import nan_without_warning
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import batch, declare_cached, has_value, is_on, read_batch
from parapod.systems.core.rows import answer_of

MODES = ("compound", "velocity", "position")


@dataclass(frozen=True)
class CompoundPositionControllerParams:
    """Gains of the controller; the paper prints none, so all are assumptions.

    Attributes:
        mode: "compound" corrects the velocity by the position's error (Eq. 47), "velocity" does
            not, and "position" runs at full speed until the node is reached.
        proportional: P of Eq. (47) [1/s].
        k_p: gain k_p of the velocity PI (Eq. 48) [-].
        k_i: gain k_i of the velocity PI, per sample [-].
        velocity_limit: largest command [m/s] (section "Trotting gait simulation": 80 mm/s).
        dead_band: error at which mode "position" stands still [m]: a count of the encoder.
    """

    mode: str = "compound"
    proportional: float = 10.0
    k_p: float = 0.6
    k_i: float = 0.25
    velocity_limit: float = 0.08
    dead_band: float = 5e-6

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"mode '{self.mode}' is not one of {', '.join(MODES)}")


class CompoundPositionController(LeafSystem):
    """Leads drives from node to node, at a velocity that also corrects what is missing.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position_node` | n | m | where the drives should be at the end of this period |
    | in `position_measured` | n | m | where they are |
    | in `enable` | 1 | - | above 0.5: control; otherwise 0; unconnected: always control |
    | out `velocity_command` | n | m/s | within the limit; to be sampled every period |

    At a sample, the node of the last one is due: what is missing from it, times P, is added to
    the velocity that leads to the next node (Eqs. 46, 47), and a PI law makes the drives follow
    that velocity, measured by what the encoders have counted since the last sample (Eq. 48).
    The command follows from the measurement of the same instant; its receiver, a drive or
    its model, samples it, at the controller's period. In mode "position" the drive's own loop
    runs instead, as often as the drive samples the command: full speed towards the node.

    State: discrete, the node that is due (n) [m]; last measured positions (n) [m]; sums of the
    velocity's errors (n) [m/s]; whether in control (1). Sums are held while the command is
    saturated and they would drive it further out. When control begins, the node that is due is
    where the drives are.

    Bad input: a channel whose node or position is not finite is commanded 0 and keeps its sum.
    """

    def __init__(
        self,
        params: CompoundPositionControllerParams = CompoundPositionControllerParams(),
        channels: int = 3,
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("compound_position_controller")
        self.params, self._channels, self._period = params, channels, period
        self._node = self.DeclareVectorInputPort("position_node", channels)
        self._measured = self.DeclareVectorInputPort("position_measured", channels)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        state = self.DeclareDiscreteState(3 * channels + 1)
        inputs = {port.ticket() for port in (self._node, self._measured, self._enable)}
        tickets = inputs | {self.discrete_state_ticket(state)}
        self._law = declare_cached(self, "law", self._calc_law, tickets)
        self.DeclareVectorOutputPort(
            "velocity_command", channels, self._calc_velocity_command, {self._law.ticket}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_state)

    def _is_enabled(self, context: Context) -> bool:
        return not has_value(self._enable, context) or is_on(self._enable, context)

    def _calc_velocity_command(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._law.value(self, context)[0])

    def _update_state(self, context: Context, discrete_state: Any) -> None:
        discrete_state.set_value(self._law.value(self, context)[1])

    @nan_without_warning
    def _calc_law(self, context: Context) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Commands (..., n), and the state after this sample."""
        n = self._channels
        if not self._is_enabled(context):
            return np.zeros(n), np.zeros(3 * n + 1)
        values = batch(context.get_discrete_state_vector(), context)
        due, last, sums = values[..., :n], values[..., n : 2 * n], values[..., 2 * n : 3 * n]
        node = read_batch(self._node, context)
        measured = read_batch(self._measured, context)
        in_control = values[..., -1]
        if not answer_of(in_control > 0.5):
            due, last, sums = measured, measured, np.zeros_like(measured)
        if self.params.mode == "position":
            command = self._run(due - measured)
        else:
            command, sums = self._follow(node, measured, due, last, sums)
        one = np.ones_like(in_control)[..., np.newaxis]
        return command, np.concatenate((node, measured, sums, one), axis=-1)

    def _run(self, missing: NDArray[np.float64]) -> NDArray[np.float64]:
        """Full speed where more than a count is missing."""
        finite = np.where(np.isfinite(missing), missing, 0.0)
        away = np.abs(finite) > self.params.dead_band
        return self.params.velocity_limit * np.where(away, np.sign(finite), 0.0)

    def _follow(
        self,
        node: NDArray[np.float64],
        measured: NDArray[np.float64],
        due: NDArray[np.float64],
        last: NDArray[np.float64],
        sums: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Commands and sums of errors (..., n each), Eqs. (46)-(48)."""
        params, h = self.params, self._period
        desired = (node - due) / h
        if params.mode == "compound":
            desired = desired + params.proportional * (due - measured)
        error = desired - (measured - last) / h
        is_measured = np.isfinite(error)
        if not is_measured.all():
            error = np.where(is_measured, error, 0.0)
        limit, integral = params.velocity_limit, sums + error
        speed = np.where(is_measured, params.k_p * error + params.k_i * integral, 0.0)
        command = np.minimum(np.maximum(speed, -limit), limit)
        saturates_more = (command != speed) & (np.sign(speed) == np.sign(error))
        return command, np.where(is_measured & ~saturates_more, integral, sums)
