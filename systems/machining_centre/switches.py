"""Locks and clamps as they are: contacts that show that they are closed."""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import batch, read_batch
from parapod.systems.core.switching import are_safe
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB

# A clamp holds a foot that is not farther from the panel, by the height of its ankle, and leans no
# more from it [-, rad].
REACH, LEAN = 1.0 / 28.0, 0.03


class Switches(LeafSystem):
    """Switches of locks and clamps.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `locks_command` | 4n | 0/1 | 1: closed |
    | in `clamps_command` | n | 0/1 | 1: closed |
    | in `feet` | 6n | m, rad | of the feet's frames |
    | out `locks_closed` | 4n | 0/1 | 1: closed |
    | out `clamps_closed` | n | 0/1 | 1: closed |

    What is commanded is due after the time that locks and clamps take. Of a plant without
    dynamics it obeys by itself. Locks and clamps of rigid bodies are parameters of their context,
    which no system can change: what does change them between two steps looks here for what is
    due, and reports what is closed then, see `set_closed`.

    A clamp closes only where its foot is on the panel.

    State: discrete; which locks (4n) and clamps (n) are closed, and for how long they have been
    asked to be other than they are (5n) [s]; updated every period.

    Bad input: a command that is neither open nor closed closes, as on the devices.

    Args:
        geometry: the centre.
        panel: the panel; None: it does not obey by itself.
        period: between two updates [s].
        delay: time that locks and clamps take [s].
    """

    def __init__(
        self,
        geometry: CentreGeometry = CentreGeometry(),
        panel: Panel | None = None,
        period: float = 0.01,
        delay: float = 0.0,
    ):
        super().__init__()
        self.set_name("switches")
        n = geometry.limbs
        self._n, self._panel, self._period, self._delay = n, panel, period, delay
        self._locks = self.DeclareVectorInputPort("locks_command", LOCKS_OF_LIMB * n)
        self._clamps = self.DeclareVectorInputPort("clamps_command", n)
        self._feet = self.DeclareVectorInputPort("feet", 6 * n)
        # All locks open, all feet clamped.
        closed = self.DeclareDiscreteState(np.repeat((0.0, 1.0), (LOCKS_OF_LIMB * n, n)))
        self.DeclareDiscreteState((LOCKS_OF_LIMB + 1) * n)
        ticket = {self.discrete_state_ticket(closed)}
        self.DeclareVectorOutputPort("locks_closed", LOCKS_OF_LIMB * n, self._calc_locks, ticket)
        self.DeclareVectorOutputPort("clamps_closed", n, self._calc_clamps, ticket)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def closed(self, context: Context) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which locks (n, 4) and clamps (n) are closed."""
        return self._apart(self._state(0, context) > 0.5)

    def due(self, context: Context) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
        """Which locks (n, 4) and clamps (n) are to be closed by now; None: those that are."""
        waited = self._state(1, context)
        if not waited.any():
            return None
        closed = self._state(0, context) > 0.5
        changed = (waited > max(self._delay - 1e-9, 0.0)) & (self._commanded(context) != closed)
        return self._apart(closed ^ changed) if changed.any() else None

    def _state(self, group: int, context: Context) -> NDArray[np.float64]:
        return batch(context.get_discrete_state(group), context)

    def _apart(self, closed: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        locks, clamps = np.split(closed, [LOCKS_OF_LIMB * self._n], axis=-1)
        return locks.reshape(*clamps.shape, -1).copy(), clamps.copy()

    def _commanded(self, context: Context) -> NDArray[np.bool_]:
        commands = [read_batch(port, context) for port in (self._locks, self._clamps)]
        return are_safe(np.concatenate(commands, axis=-1))

    def set_closed(
        self, context: Context, locks: NDArray[np.bool_], clamps: NDArray[np.bool_]
    ) -> None:
        """Sets which of them are closed now.

        Args:
            context: context of this system.
            locks: (n, 4).
            clamps: (n).
        """
        context.SetDiscreteState(0, np.concatenate((locks.ravel(), clamps)).astype(float))

    def _update(self, context: Context, state: DiscreteValues) -> None:
        closed = self._state(0, context) > 0.5
        waited = self._state(1, context) + self._period
        state.set_value(1, np.where(self._commanded(context) != closed, waited, 0.0))
        due = self.due(context)
        if self._panel is None or due is None:
            return
        (locks, clamps), (_, before) = due, self.closed(context)
        feet = read_batch(self._feet, context).reshape(*clamps.shape, 6)
        for closes in map(tuple, np.argwhere(clamps & ~before)):
            clamps[closes] = is_on_panel(self._panel, feet[closes])
        state.set_value(0, np.concatenate((_flat(locks), clamps), axis=-1).astype(float))

    def _calc_locks(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(_flat(self.closed(context)[0]).astype(float))

    def _calc_clamps(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.closed(context)[1].astype(float))


def _flat(locks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return locks.reshape(*locks.shape[:-2], -1)


def is_on_panel(panel: Panel, foot: NDArray[np.float64]) -> bool:
    """Whether a foot (6) is where a clamp holds it."""
    off = abs(panel.place(foot[:3])[2] - panel.foot_height)
    return bool(off <= REACH * panel.foot_height and panel.tilt(foot) <= LEAN)
