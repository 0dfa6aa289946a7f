"""Workers of a Dask cluster."""

import logging
import warnings
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from parapod.sims.lab.work import Crew, NoWorkers
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import printable, quoted

_PACKAGE = "parapod"
_ADVICE = f"install parapod {version(_PACKAGE)} in the cluster's environment"
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
            with warnings.catch_warnings():
                # Versions of libraries that no run depends on; those of parapod are compared.
                warnings.simplefilter("ignore")
                self._client: Any = distributed.Client(
                    address, timeout=_TIMEOUT, set_as_default=False
                )
        except (OSError, ValueError, TypeError) as error:
            reason = printable(error) or type(error).__name__
            raise NoWorkers(f"no scheduler answers at {quoted(address)}: {reason}") from None
        size = sum(self._client.nthreads().values())
        try:
            if not size:
                raise NoWorkers(f"the scheduler at {quoted(address)} has no workers")
            self._check_parapod()
        except BaseException:
            self.close()
            raise
        super().__init__(self._client.get_executor(pure=False), size)
        self.losses = (*Crew.losses, distributed.KilledWorker)

    def _check_parapod(self) -> None:
        """Refuses a cluster that cannot unpickle work of parapod.

        Raises:
            NoWorkers: names where it is missing.
        """
        versions = self._client.run(version, _PACKAGE, on_error="return")
        for worker, answer in versions.items():
            if not isinstance(answer, str):
                raise NoWorkers(f"the worker at {worker} has no parapod: {_ADVICE}")
        try:
            self._client.run_on_scheduler(version, _PACKAGE)
        except PackageNotFoundError:
            raise NoWorkers(f"the scheduler has no parapod: {_ADVICE}") from None

    def close(self) -> None:
        """Disconnects; the scheduler then drops what is not done."""
        self._client.close(timeout=_TIMEOUT)
