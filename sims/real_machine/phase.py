"""Phase of a loop to measurements that come by themselves, once in its period or several times.

A device that is asked is read just before the loop takes samples (`DeviceThread`). A part behind a
bus publishes when it likes, and a loop that happens to tick just before goes by measurements that
are a period old for as long as it runs. So the loop begins, and keeps on, shortly after they come,
whatever the difference of two computers' clocks.
"""

from collections.abc import Sequence

from parapod.systems.hardware.io import DeviceThread

# Time from the newest measurement to the tick that takes it [periods of the sender], and the
# largest shift of a tick, by which the loop follows 2 ms a second [periods of the loop].
_LEAD, _STEP = 0.3, 2e-3
# A sender is followed whose messages in a period of the loop are a whole number but for this [-].
_WHOLE = 0.05


class Phase:
    """Says how late ticks are for measurements that come by themselves.

    Of several parts the ticks follow the one after which the oldest measurement is youngest.
    """

    def __init__(self, threads: Sequence[DeviceThread], period: float):
        """Finds the devices whose measurements come by themselves.

        Args:
            threads: threads of the devices.
            period: period of the loop [s].
        """
        self._period = period
        self._threads = [thread for thread in threads if not thread.device.is_asked]

    def late(self, at: float) -> float:
        """By how much a tick is late for them, at most half a period; negative: early [s].

        Args:
            at: time of devices at which the tick is [s].
        """
        sent = [
            (thread.sample.stamp, self._period / count)
            for thread in self._threads
            if not thread.error and (count := self._count(thread.device.sends_every))
        ]
        if not sent:
            return 0.0
        # Of ticks that follow one of the measurements: the oldest that the tick takes is youngest.
        stamp, every = min(sent, key=lambda one: max((one[0] - t) % each for t, each in sent))
        return (at - stamp - _LEAD * every + 0.5 * every) % every - 0.5 * every

    def _count(self, sends_every: float) -> int:
        """Messages in a period of the loop, a whole number; 0 for any other."""
        ratio = self._period / sends_every if sends_every > 0.0 else 0.0
        return round(ratio) if abs(ratio - round(ratio)) < _WHOLE * ratio else 0

    def shift(self, due: float) -> float:
        """By how much the tick after the one that is due at a time is to be shifted [s]."""
        most = _STEP * self._period
        return min(max(-self.late(due), -most), most)
