"""Workers of a Dask cluster."""

import logging
from typing import Any

from parapod.sims.lab.work import Crew, NoWorkers
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import printable, quoted

# Longest time that a scheduler may take to answer [s].
_TIMEOUT = 10.0


class ClusterCrew(Crew):
    """Workers of a Dask scheduler that is there already.

    The scheduler itself carries out again what workers have not finished that died; a run that
    kills several of them fails.
    """

    def __init__(self, address: str):
        """Connects to a scheduler.

        Args:
            address: its address, as in tcp://10.0.0.1:8786.

        Raises:
            NoWorkers: there is no scheduler, or it has no workers.
            MissingExtra: distributed is not installed.
        """
        distributed = need("distributed")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # we tell what matters
        try:
            self._client: Any = distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            reason = printable(error) or type(error).__name__
            raise NoWorkers(f"no scheduler answers at {quoted(address)}: {reason}") from None
        size = sum(self._client.nthreads().values())
        if not size:
            self._client.close()
            raise NoWorkers(f"the scheduler at {quoted(address)} has no workers")
        super().__init__(self._client.get_executor(pure=False), size)
        self.losses = (*Crew.losses, distributed.KilledWorker)

    def close(self) -> None:
        """Disconnects; the scheduler then drops what is not done."""
        self._client.close(timeout=_TIMEOUT)
