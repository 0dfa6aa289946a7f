"""Force cells whose amplifiers are at analog inputs of a card of National Instruments."""

import math
import statistics
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ni.session import CONFIGURE_TIMEOUT, NiSession
from parapod.systems.hardware.ni.settings import ForceCell, NiForceCellSettings

# A voltage beyond this share of the range is at its end: the converter goes no further.
_END = 0.999


class NiForceCells(Device):
    """Force cells with an amplifier each, at analog inputs of one card.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `force` | n | N | of the cells, in the order of the channel string |

    A force is the sensitivity times the voltage above that without a force; each is the mean of
    the settings' `samples`.

    **Values without a force.** A voltage at an end of the range, even of one sample, is an
    overload or an amplifier whose cell has a broken wire: `read` raises, and names cell and
    channel. So it does for one that is not a number. A wire that breaks between amplifier and card
    leaves the input open, and an open input may show anything: a resistor of some 100 kOhm from
    each input to a voltage beyond the range makes it one of these. No force is shown in place of a
    bad one, nor those of the other cells.

    **Sessions.** As of `NiDaq`; cells and legs may share a card, since analog inputs are a task of
    their own. Two devices with analog inputs of one card cannot: it has one converter.
    """

    def __init__(self, settings: NiForceCellSettings):
        """Describes the cells; nothing is opened.

        Args:
            settings: channels and sensitivities of the cells, and the place of the card.

        Raises:
            ValueError: settings that do not fit together.
        """
        self._settings, self._cells = settings, settings.cells
        self.name, self.place = f"{settings.product} {settings.place}", settings.place
        self.measures: Mapping[str, int] = {"force": len(self._cells)}
        self._session: _CellSession | None = None

    def configure(self) -> None:
        """See `Device`."""
        self.close()
        session = _CellSession(self._settings, self.name)
        with session.opening(CONFIGURE_TIMEOUT):
            self._session = session

    def read(self) -> Signals:
        """Forces of the cells.

        Raises:
            DeviceError: there are none, or a voltage does not belong to a force.
        """
        if self._session is None:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        self._session.begin()
        rows = zip(self._cells, self._session.read().tolist(), strict=True)
        return {
            "force": [self._force(i, cell, volts) for i, (cell, volts) in enumerate(rows, start=1)]
        }

    def _force(self, number: int, cell: ForceCell, volts: Sequence[float]) -> float:
        """Force of a cell by its samples [N]."""
        where, end = f"cell {number} at {cell.channel}", _END * self._settings.range_V
        for value in volts:
            if not math.isfinite(value):
                raise DeviceError(self.name, f"{where} reads {value} V", DeviceFault.CORRUPT)
            if abs(value) >= end:
                raise DeviceError(
                    self.name,
                    f"{where} is at the end of its range, {value:.2f} V of "
                    f"{self._settings.range_V:g} V: overload, or a broken wire",
                )
        return cell.newton_per_volt * (statistics.fmean(volts) - cell.zero)

    def close(self) -> None:
        """Gives the card back; see `Device`."""
        session, self._session = self._session, None
        if session is not None:
            session.begin()
            session.close()


class _CellSession(NiSession[NiForceCellSettings]):
    """The analog inputs of one card."""

    def _create(self) -> None:
        settings = self.settings
        # By the part's name: what belongs to another device is not taken over.
        task = self._task(f"force_{settings.part}")
        task.ai_channels.add_ai_voltage_chan(
            settings.channels, min_val=-settings.range_V, max_val=settings.range_V
        )
        self._inputs = self._readers.AnalogMultiChannelReader(task.in_stream)
        self._inputs.verify_array_shape = False  # it would ask the card each time
        self._volts = np.zeros((len(settings.cells), settings.samples))

    def read(self) -> NDArray[np.float64]:
        """Voltages of the cells, a row each [V]."""
        self._volts.fill(math.nan)
        with self.told():
            self._inputs.read_many_sample(self._volts, self.settings.samples, self.waits)
        return self._volts
