"""Where faults are injected into a diagram: between a signal and those who see it."""

from collections.abc import Collection, Sequence

from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from parapod.diagrams.fault_scenario import FaultScenario, check_faults, make_fault_injector
from parapod.diagrams.wiring import add, connect
from parapod.systems.core.errors import ScenarioError
from parapod.systems.safety.faults import FaultInjector


class FaultPoints:
    """Puts injectors where faults are to come, and nothing where none are.

    Attributes:
        injectors: by the name of their port, as in `parapod.diagrams.fault_scenario.TARGETS`.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        period: float,
        faults: Sequence[FaultScenario] = (),
        seed: int = 0,
        injectable: Collection[str] = (),
    ):
        """Prepares the injectors.

        Args:
            builder: of the diagram.
            period: of those who see the signals [s].
            faults: what is injected until `set_faults` says otherwise.
            seed: of garbage.
            injectable: further ports into which faults may be injected later.
        """
        self._builder, self._period = builder, period
        self._faults = check_faults(faults, seed)
        self._wanted = {*self._faults, *injectable}
        self.injectors: dict[str, FaultInjector] = {}

    def seen(self, port: OutputPort, name: str) -> OutputPort:
        """The port as others see it: through an injector if it can have faults.

        Args:
            port: the true signal.
            name: of the target.
        """
        if name not in self._wanted:
            return port
        faults = self._faults.get(name, ())
        injector = add(self._builder, make_fault_injector(name, self._period, faults))
        connect(self._builder, port, injector.GetInputPort("signal"))
        self.injectors[name] = injector
        shown: OutputPort = injector.GetOutputPort("faulted")
        return shown

    def ports(self) -> dict[str, OutputPort]:
        """What can be logged: signals as they are seen, and the injectors' other outputs."""
        found: dict[str, OutputPort] = {}
        for name, injector in self.injectors.items():
            found[name] = injector.GetOutputPort("faulted")
            for signal in ("extra_age", "changed"):
                found[f"fault.{name}.{signal}"] = injector.GetOutputPort(signal)
        return found

    def set_faults(
        self, root_context: Context, faults: Sequence[FaultScenario], seed: int = 0
    ) -> None:
        """Replaces the faults, in a context at its defaults.

        Raises:
            ScenarioError: a port that was built without an injector.
        """
        by_port = check_faults(faults, seed)
        for port in by_port.keys() - self.injectors.keys():
            raise ScenarioError(f"port {port} was built without an injector of faults", "faults")
        for port, injector in self.injectors.items():
            context = injector.GetMyMutableContextFromRoot(root_context)
            injector.set_faults(context, by_port.get(port, ()))
