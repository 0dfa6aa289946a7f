"""The sequencer: leads a centre through its job, phase by phase."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.elementwise import where
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import batch, declare_cached, has_value, is_on, read_batch
from parapod.systems.core.rows import answer_of
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import Job
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB
from parapod.systems.machining_centre.sequence import (
    Phase,
    Progress,
    Seen,
    Sequence,
    SequenceParams,
)

MODES = ("", "platform", "foot")


class CentreSequencer(LeafSystem):
    """Commands motions, locks and clamps of a job, by what is measured.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `length_error` | 2n | m | lengths of the legs less those that they were led to |
    | in `locks_closed` | 4n | 0/1 | switches of the locks |
    | in `clamps_closed` | n | 0/1 | switches of the clamps |
    | in `feet` | 6n | m, rad | the feet, as far as is known |
    | in `is_determined` | 1 | 0/1 | whether it is known where the platform is |
    | in `pose_desired` | 6 | m, rad | of the platform now |
    | in `is_stuck` | 1 | 0/1 | whether no lengths lead on |
    | in `tool_force` | 2 | N, N m | thrust and torque of the drill |
    | in `emergency_stop` | 1 | 0/1 | whether it is pressed |
    | in `stop` | 1 | 0/1 | whether end of the job is requested; unconnected: never |
    | in `pose_asked` | 6 | m, rad | asked for once the job is done; unconnected: never done |
    | in `limb_asked` | 1 | - | limb whose foot is to be lifted then; unconnected: none |
    | out `mode` | 1 | - | what moves: 0 nothing, 1 the platform, 2 the loose foot |
    | out `target` | 6 | m, rad | of what moves, a period from now |
    | out `toward` | 6 | m, rad | of the platform then, as planned: NaN where nothing is |
    | out `loose_limb` | 1 | - | limb whose clamp is to be open, from 1; 0: none |
    | out `locks_command` | 4n | 0/1 | 1: closed |
    | out `clamps_command` | n | 0/1 | 1: closed |
    | out `brake` | 1 | 0/1 | 1: the legs stand where they are |
    | out `phase` | 1 | - | see `Phase` |
    | out `operation` | 1 | - | operations that are done |
    | out `fault` | 2 | - | see `Fault`, and limb, leg or operation that it is about |
    | out `done` | 1 | 0/1 | whether nothing more comes |

    Outputs follow from the state alone.

    State: discrete, a `Progress`, updated every period.

    Bad input: lengths, clamps, feet or a pose that are not finite end the job by a fault, all
    standing where it is; a lock that is not finite counts as open, such a load as zero.
    """

    def __init__(
        self,
        geometry: CentreGeometry = CentreGeometry(),
        job: Job | None = None,
        period: float = 0.01,
        params: SequenceParams = SequenceParams(),
    ):
        """Creates the system.

        Args:
            geometry: the centre.
            job: the job; None: nothing to do.
            period: between two updates [s].
            params: times and tolerances.
        """
        super().__init__()
        self.set_name("sequencer")
        n = geometry.limbs
        self._n, self._sequence = n, Sequence(geometry, job or Job(), period, params)
        self._ports = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("length_error", geometry.legs),
                ("locks_closed", LOCKS_OF_LIMB * n),
                ("clamps_closed", n),
                ("feet", 6 * n),
                ("is_determined", 1),
                ("pose_desired", 6),
                ("is_stuck", 1),
                ("tool_force", 2),
                ("emergency_stop", 1),
                ("stop", 1),
                ("pose_asked", 6),
                ("limb_asked", 1),
            )
        }
        state = self.DeclareDiscreteState(Progress().numbers())
        self._period = period
        ticket = {self.discrete_state_ticket(state)}
        self._cached = declare_cached(self, "progress", self._calc_progress, ticket)
        for name, size, calc in (
            ("mode", 1, self._calc_mode),
            ("target", 6, self._calc_target),
            ("toward", 6, self._calc_toward),
            ("loose_limb", 1, self._calc_loose_limb),
            ("locks_command", LOCKS_OF_LIMB * n, self._calc_locks),
            ("clamps_command", n, self._calc_clamps),
            ("brake", 1, self._calc_brake),
            ("phase", 1, self._calc_phase),
            ("operation", 1, self._calc_operation),
            ("fault", 2, self._calc_fault),
            ("done", 1, self._calc_done),
        ):
            self.DeclareVectorOutputPort(name, size, calc, ticket)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _calc_progress(self, context: Context) -> Progress:
        return Progress.from_numbers(batch(context.get_discrete_state(0), context))

    def _progress(self, context: Context) -> Progress:
        progress: Progress = self._cached.value(self, context)
        return progress

    def _update(self, context: Context, state: DiscreteValues) -> None:
        advanced = self._sequence.advanced(self._progress(context), self._seen(context))
        state.set_value(0, advanced.numbers())

    def _seen(self, context: Context) -> Seen:
        ports = self._ports

        def array(name: str) -> Array:
            return read_batch(ports[name], context)

        locks, feet = array("locks_closed"), array("feet")
        return Seen(
            time=context.get_time(),
            locks=(locks > 0.5).reshape(*locks.shape[:-1], self._n, -1),
            clamps=array("clamps_closed") > 0.5,
            feet=feet.reshape(*feet.shape[:-1], self._n, 6),
            pose=array("pose_desired"),
            error=array("length_error"),
            load=np.nan_to_num(array("tool_force")),
            is_determined=is_on(ports["is_determined"], context),
            is_stuck=is_on(ports["is_stuck"], context),
            is_pressed=is_on(ports["emergency_stop"], context),
            asked=self._asked(context),
            is_stopped=has_value(ports["stop"], context) and is_on(ports["stop"], context),
        )

    def _asked(self, context: Context) -> Array | None:
        """Pose and limb that a person asks for; None without such an input."""
        pose, limb = self._ports["pose_asked"], self._ports["limb_asked"]
        if not has_value(pose, context):
            return None
        request = read_batch(pose, context)
        no_limb = np.zeros_like(request[..., :1])
        number = read_batch(limb, context) if has_value(limb, context) else no_limb
        request = np.concatenate((request, number), axis=-1)
        return request if answer_of(np.isfinite(request).all(axis=-1)) else None

    def _calc_mode(self, context: Context, output: BasicVector) -> None:
        progress = self._progress(context)
        mode = 0.0 if progress.phase is Phase.FAULT else float(MODES.index(progress.rule.moves))
        moving: Any = where(progress.duration > 0.0, mode, 0.0)
        output[0] = moving

    def _calc_target(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._sequence.at(self._progress(context), self._period))

    def _calc_toward(self, context: Context, output: BasicVector) -> None:
        toward = self._sequence.toward(self._progress(context), self._period)
        output.SetFromVector(toward)

    def _calc_loose_limb(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._sequence.loose(self._progress(context)))

    def _calc_locks(self, context: Context, output: BasicVector) -> None:
        locks = self._sequence.locks(self._progress(context))
        output.SetFromVector(locks.ravel().astype(float))

    def _calc_clamps(self, context: Context, output: BasicVector) -> None:
        clamps = self._sequence.clamps(self._progress(context))
        output.SetFromVector(clamps.astype(float))

    def _calc_brake(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._progress(context).phase is Phase.FAULT)

    def _calc_phase(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._progress(context).phase)

    def _calc_operation(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._progress(context).operation)

    def _calc_fault(self, context: Context, output: BasicVector) -> None:
        progress = self._progress(context)
        output.SetFromVector(np.array((progress.fault, progress.where), dtype=float))

    def _calc_done(self, context: Context, output: BasicVector) -> None:
        ended = (Phase.DONE, Phase.STOPPED, Phase.FAULT)
        output[0] = float(self._progress(context).phase in ended)
