"""Phase of a loop to measurements that come by themselves, in the period of the loop.

A device that is asked is read just before the loop takes samples (`DeviceThread`). A part behind a
bus publishes when it likes, and a loop that happens to tick just before goes by measurements that
are a period old for as long as it runs. So the loop begins, and keeps on, shortly after they come,
whatever the difference of two computers' clocks.
"""

from collections.abc import Sequence

from parapod.systems.hardware.io import DeviceThread

# Time from the newest measurement to the tick that takes it, and the largest shift of a tick, by
# which the loop follows 2 ms a second [periods]; and periods that are the same [-].
_LEAD, _STEP, _SAME = 0.3, 2e-3, 1e-2


class Phase:
    """Says how late ticks are for measurements that come by themselves.

    Of several parts the ticks follow the one after which the oldest measurement is youngest.
    """

    def __init__(self, threads: Sequence[DeviceThread], period: float):
        """Finds the devices whose measurements come by themselves in the period of the loop.

        Args:
            threads: threads of the devices.
            period: period of the loop [s].
        """
        self._period = period
        self._threads = [
            thread for thread in threads if abs(thread.device.sends_every / period - 1.0) < _SAME
        ]

    def late(self, at: float) -> float:
        """By how much a tick is late for them, at most half a period; negative: early [s].

        Args:
            at: time of devices at which the tick is [s].
        """
        period, lead = self._period, _LEAD * self._period
        stamps = [thread.sample.stamp for thread in self._threads if not thread.error]
        if not stamps:
            return 0.0
        # Of ticks that follow one of the measurements: the oldest that the tick takes is youngest.
        followed = min(stamps, key=lambda one: max((one - other) % period for other in stamps))
        return (at - followed - lead + 0.5 * period) % period - 0.5 * period

    def shift(self, due: float) -> float:
        """By how much the tick after the one that is due at a time is to be shifted [s]."""
        most = _STEP * self._period
        return min(max(-self.late(due), -most), most)
