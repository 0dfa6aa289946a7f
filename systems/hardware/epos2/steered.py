"""Axes on EPOS2 24/5 controllers whose set values follow from the newest measurements, too."""

from abc import abstractmethod
from collections.abc import Callable, Sequence

from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.ds402 import Controlword
from parapod.systems.hardware.epos2.controller import Timing
from parapod.systems.hardware.epos2.device import Epos2Device
from parapod.systems.hardware.epos2.settings import Epos2Settings


class Epos2Steered(Epos2Device):
    """Axes that are commanded zero to stay where they are, and limited by what is measured.

    Set values follow from what is commanded and from the newest measurements. They are sent at
    every command, and a reading that asks for others sends these at once: so also between two
    commands of a controller that hangs.
    """

    def __init__(
        self,
        settings: Epos2Settings,
        timing: Timing = Timing(),
        is_synchronous: bool = True,
        clock: Callable[[], float] = monotonic,
    ):
        """See `Epos2Device`."""
        super().__init__(settings, timing, is_synchronous, clock)
        self._wanted: Sequence[float] = (0.0,) * len(settings.node_ids)
        # Set values that have been sent; None: another controlword has.
        self._sent: list[int | None] | None = None

    def _want(self, command: Sequence[float] | None) -> None:
        self._wanted = (0.0,) * len(self._directions) if command is None else command

    def _begin(self, settings: Sequence[int]) -> None:
        """Enabled at zero, drives move nothing until the first command."""

    def _run(self) -> None:
        self._send(Controlword.ENABLE_OPERATION, self._targets())

    def _send(self, word: Controlword, settings: Sequence[int] = ()) -> None:
        # If sending fails midway, all are sent again.
        self._sent = [None] * len(settings) if settings else None
        super()._send(word, settings)
        if settings:
            self._sent = [*settings]

    def _restrain(self) -> None:
        """Sends axes other set values, where those that were sent are not allowed any more."""
        if self._sent is None:
            return
        targets = self._targets()
        for i, (controller, target) in enumerate(zip(self._controllers, targets, strict=True)):
            if target != self._sent[i]:
                controller.steer(target)
                self._sent[i] = target

    @abstractmethod
    def _targets(self) -> list[int]:
        """Set values of the motors for desired motions of the axes, within the limits."""
