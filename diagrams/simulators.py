"""Simulators of diagrams, with the integrator that their plants of rigid bodies need."""

from collections.abc import Callable
from typing import Any

from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, EventStatus, System

from parapod.diagrams.wiring import leaf_systems
from parapod.systems.core.errors import WiringError
from parapod.systems.core.leaf_system import LeafSystem


class ErrorControl(LeafSystem):
    """Accuracy to which a continuous plant beside it is to be integrated.

    `simulator_of` reads it. It has no ports and no state, and no integrator but Drake's CENIC
    passes it by: none of the others can integrate closed loops.

    Args:
        accuracy: largest error of a position in a step, as the integrator estimates it [m, rad].
        longest: longest step of the integrator [s].
    """

    def __init__(self, accuracy: float, longest: float):
        super().__init__()
        self.set_name("error_control")
        self.accuracy, self.longest = accuracy, longest

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        """Refuses an integrator that was not chosen by `simulator_of`.

        Raises:
            WiringError: says how a simulator is made.
        """
        raise WiringError(
            f"plant.accuracy = {self.accuracy:g} needs the integrator that loop.simulator() "
            "chooses; Simulator(loop) has another one"
        )


def simulator_of(
    system: System,
    context: Context | None = None,
    monitor: Callable[[Context], EventStatus] | None = None,
) -> Simulator:
    """A simulator, to be initialized, with the integrator that a system needs.

    Without a plant under error control and a monitor it is `Simulator(system, context)`.

    Args:
        system: a diagram with at most one such plant at any depth, or a leaf system.
        context: context to simulate in, which the simulator takes; None for a default one.
        monitor: monitor of the simulator; None: none.
    """
    simulator = Simulator(system) if context is None else Simulator(system, context)
    leaves = leaf_systems(system) if isinstance(system, Diagram) else ()
    for leaf in leaves:
        if isinstance(leaf, ErrorControl):
            config = SimulatorConfig(
                integration_scheme="cenic",
                accuracy=leaf.accuracy,
                max_step_size=leaf.longest,
            )
            ApplySimulatorConfig(config, simulator)
    if monitor is not None:
        simulator.set_monitor(monitor)
    return simulator
