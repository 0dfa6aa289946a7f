"""Commands to the devices of one part of a machine, as input ports."""

import time
from collections.abc import Sequence

from pydrake.systems.framework import Context, InputPort, LeafSystem

from parapod.systems.core.ports import read
from parapod.systems.hardware.io_thread import DeviceThread

# After the controllers' updates of the same instant, so that commands are not a period old [s].
WRITE_OFFSET = 1e-6


class PartWriter(LeafSystem):
    """Hands commands to the threads of a part's devices.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `stamp` | 1 | s | `time.monotonic` of the measurements behind them; unconnected: now |

    Besides, one input for each signal that a device is commanded, with its name, size and SI unit.

    No state. Commands are handed over in a periodic publish event, a microsecond after the loop's
    instant: they are those that the controllers have made of that instant's measurements. Nothing
    here waits for a device.

    Bad input: what is not finite is neutral for the device.
    """

    def __init__(
        self,
        part: str = "part",
        threads: Sequence[DeviceThread] = (),
        period: float = 0.01,
    ):
        """Creates the system; its ports follow from what the devices are commanded.

        Args:
            part: name of the part.
            threads: of its devices.
            period: of the loop [s].
        """
        super().__init__()
        self.set_name(f"{part}_writer")
        self._threads = [thread for thread in threads if thread.device.commands]
        self._inputs: dict[str, InputPort] = {}
        for thread in self._threads:
            for signal, size in thread.device.commands.items():
                if signal not in self._inputs:
                    self._inputs[signal] = self.DeclareVectorInputPort(signal, size)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        self.DeclarePeriodicPublishEvent(period, WRITE_OFFSET, self._publish_commands)

    def _publish_commands(self, context: Context) -> None:
        connected = self._stamp.HasValue(context)
        stamp = read(self._stamp, context)[0] if connected else time.monotonic()
        values = {name: tuple(read(port, context)) for name, port in self._inputs.items()}
        for thread in self._threads:
            thread.post({name: values[name] for name in thread.device.commands}, stamp)
