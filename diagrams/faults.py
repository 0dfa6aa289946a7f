"""Faults of a machine's signals: in a scenario, checked, and injected between ports.

The machine's table of ports says which signals can have faults and which values are plausible.
An injector is added where a fault is asked for, and nothing where none is.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from parapod.diagrams.ports import Port, Span
from parapod.diagrams.wiring import add, connect
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import show
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.safety.faults import LONGEST_DELAY, Fault, FaultInjector, FaultKind

KINDS = tuple(kind.value for kind in FaultKind)

# Meaning of `value` for the kinds that have one, and its admissible range; None: any.
_VALUES: dict[str, tuple[str, tuple[float, float] | None]] = {
    FaultKind.WRONG: ("offset in the port's unit", None),
    FaultKind.SLOW: ("period in s", (0.01, 60.0)),
    FaultKind.DELAYED: ("delay in s", (0.001, LONGEST_DELAY)),
    FaultKind.INTERMITTENT: ("turn in s", (0.05, 60.0)),
}


@dataclass(frozen=True)
class FaultTarget:
    """A signal that can have faults.

    Attributes:
        port: its port.
        span: its plausible values.
    """

    port: Port
    span: Span

    @property
    def point(self) -> str:
        """Name of the place of injection, which all targets of one port share."""
        return self.port.faults[0].target or self.port.name


def targets_of(ports: Sequence[Port]) -> dict[str, FaultTarget]:
    """Signals of a table into which faults may be injected, by their names in scenarios."""
    return {
        span.target or port.name: FaultTarget(port, span) for port in ports for span in port.faults
    }


@dataclass
class FaultScenario(Schema):
    """One fault; each machine derives its own, with its targets and its largest index.

    Attributes:
        at: beginning of the fault, in the time of the simulation [s].
        target: signal, by its port's name or by a name that the machine gives it.
        index: element of the port, counted from 0; -1 for all of them.
        kind: kind of the fault; see `FaultKind`.
        duration: duration of the fault [s]; null: to the end.
        value: setting of the kind: offset of a wrong value (the port's unit), sampling period of a
            slow signal [s], delay of a delayed one [s], length of the turns in which an
            intermittent one is missing and good [s]; null: the default of target or kind. Other
            kinds have none.
        scale: factor of a wrong value [-]; null: the target's default.
    """

    at: float = quantity(0.0, 0.0, 3600.0)
    target: str = ""
    index: int = quantity(-1, -1, 2**31 - 1)
    kind: str = choice(FaultKind.OFF.value, KINDS)
    duration: float | None = quantity(None, 1e-3, 3600.0)
    value: float | None = quantity(None, -1e3, 1e3)
    scale: float | None = quantity(None, -1e3, 1e3)


def check_faults(
    targets: Mapping[str, FaultTarget],
    faults: Sequence[FaultScenario],
    seed: int = 0,
    key: str = "faults",
) -> dict[str, tuple[Fault, ...]]:
    """The faults of each point of injection that has any.

    The faults of a point stand in the order of its targets in the machine's table: those of a
    later target override those of an earlier one.

    Args:
        targets: the machine's.
        faults: faults of the scenario.
        seed: seed of garbage; faults with the same seed differ from each other.
        key: key of the scenario, for messages.

    Raises:
        ScenarioError: an index that the port does not have, a value that the kind does not have,
            or anything that `check` refuses.
    """
    by_target: dict[str, list[Fault]] = {name: [] for name in targets}
    for i, fault in enumerate(faults):
        where = f"{key}.{i}"
        target = targets[fault.target]
        _check_index(fault, target, f"{where}.index")
        for name in ("value", "scale"):
            _check_setting(fault, target.span, name, f"{where}.{name}")
        # The same for a fault whether or not others come after it.
        own_seed = int(np.random.SeedSequence((seed, i)).generate_state(1)[0])
        by_target[fault.target].append(_made(fault, target.span, own_seed))
    points = dict.fromkeys(target.point for target in targets.values())
    problems_by_point = {
        point: tuple(
            fault
            for name, target in targets.items()
            if target.point == point
            for fault in by_target[name]
        )
        for point in points
    }
    return {point: problems for point, problems in problems_by_point.items() if problems}


def make_fault_injector(
    target: FaultTarget, period: float, faults: Sequence[Fault] = ()
) -> FaultInjector:
    """The injector of a point, named `fault.<point>`.

    Args:
        target: first target of the point.
        period: period of the readers [s].
        faults: faults of this point, as `check_faults` gives them.
    """
    span = target.span
    injector = FaultInjector(
        target.port.size,
        faults,
        period,
        off_value=span.off_value,
        span=(span.low, span.high),
        is_binary=span.is_binary,
    )
    injector.set_name(f"fault.{target.point}")
    return injector


class FaultPoints:
    """Places of injection in a diagram.

    Attributes:
        injectors: the injectors by the names of their points.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        targets: Mapping[str, FaultTarget],
        period: float,
        faults: Sequence[FaultScenario] = (),
        seed: int = 0,
        injectable: Collection[str] = (),
    ):
        """Prepares the injectors.

        Args:
            builder: builder of the diagram.
            targets: the machine's.
            period: period of those who see the signals [s].
            faults: faults until `set_faults` replaces them.
            seed: seed of garbage.
            injectable: further points into which faults may be injected later.
        """
        self._builder, self._targets, self._period = builder, targets, period
        self._faults = check_faults(targets, faults, seed)
        self._wanted = {*self._faults, *injectable}
        self.injectors: dict[str, FaultInjector] = {}

    def seen(self, port: OutputPort, spec: Port) -> OutputPort:
        """The port as others see it: through an injector if it can have faults.

        Args:
            port: the true signal.
            spec: its row in the machine's table.
        """
        if not spec.faults:
            return port
        target = FaultTarget(spec, spec.faults[0])
        if target.point not in self._wanted:
            return port
        faults = self._faults.get(target.point, ())
        injector = add(self._builder, make_fault_injector(target, self._period, faults))
        connect(self._builder, port, injector.GetInputPort("signal"))
        self.injectors[target.point] = injector
        faulted: OutputPort = injector.GetOutputPort("faulted")
        return faulted

    def is_missing(self, spec: Port) -> bool:
        """Whether faults of a signal are wanted and it has no injector yet."""
        if not spec.faults:
            return False
        point = FaultTarget(spec, spec.faults[0]).point
        return point in self._wanted and point not in self.injectors

    def aged(self) -> dict[str, Port]:
        """Points with an injector whose late signals make their part older, with their ports."""
        return {
            target.point: target.port
            for target in self._targets.values()
            if target.span.ages and target.point in self.injectors
        }

    def ports(self) -> dict[str, OutputPort]:
        """Signals for a log: those with faults as they are seen, and the injectors' others."""
        by_name: dict[str, OutputPort] = {}
        for name, injector in self.injectors.items():
            by_name[name] = injector.GetOutputPort("faulted")
            for signal in ("extra_age", "changed"):
                by_name[f"fault.{name}.{signal}"] = injector.GetOutputPort(signal)
        return by_name

    def set_faults(
        self, root_context: Context, faults: Sequence[FaultScenario], seed: int = 0
    ) -> None:
        """Replaces the faults, in a context at its defaults.

        Raises:
            ScenarioError: a point that was built without an injector.
        """
        by_point = check_faults(self._targets, faults, seed)
        for point in by_point.keys() - self.injectors.keys():
            raise ScenarioError(f"port {point} was built without an injector of faults", "faults")
        for point, injector in self.injectors.items():
            context = injector.GetMyMutableContextFromRoot(root_context)
            injector.set_faults(context, by_point.get(point, ()))


def _made(scenario: FaultScenario, span: Span, seed: int) -> Fault:
    value = scenario.value
    settings: dict[str, float] = {}
    if scenario.kind == FaultKind.WRONG:
        settings["scale"], settings["offset"] = span.wrong
        if value is not None or scenario.scale is not None:
            settings["scale"] = 1.0 if scenario.scale is None else scenario.scale
            settings["offset"] = 0.0 if value is None else value
    elif value is not None:
        names = {
            FaultKind.SLOW: ("sample_period",),
            FaultKind.DELAYED: ("delay",),
            FaultKind.INTERMITTENT: ("missing_time", "good_time"),
        }[FaultKind(scenario.kind)]
        settings = dict.fromkeys(names, value)
    return Fault(
        FaultKind(scenario.kind),
        None if scenario.index < 0 else scenario.index,
        begin=scenario.at,
        duration=math.inf if scenario.duration is None else scenario.duration,
        seed=seed,
        **settings,
    )


def _check_index(fault: FaultScenario, target: FaultTarget, key: str) -> None:
    last = target.port.size - 1
    if target.span.only_whole and fault.index != -1:
        raise ScenarioError(
            f"{key} = {fault.index} is not -1; {fault.target} is all {last + 1} drives at once",
            key,
        )
    if fault.index > last:
        raise ScenarioError(
            f"{key} = {fault.index} is outside -1..{last}; {fault.target} has elements "
            f"0..{last}, -1 is all of them",
            key,
        )


def _check_setting(fault: FaultScenario, span: Span, name: str, key: str) -> None:
    """Refuse a setting that the kind does not have, or whose value is not allowed."""
    value = getattr(fault, name)
    if value is None:
        return
    having = {FaultKind.WRONG.value: "factor"}
    if name == "value":
        having = {str(kind): meaning for kind, (meaning, _) in _VALUES.items()}
    if fault.kind not in having:
        kinds = ", ".join(f"{kind} ({meaning})" for kind, meaning in having.items())
        raise ScenarioError(
            f"{key} = {show(value)} is not for kind {fault.kind}; kinds that have one: {kinds}",
            key,
        )
    if fault.kind == FaultKind.WRONG and span.is_binary:
        raise ScenarioError(
            f"{key} = {show(value)} is not for {fault.target}: kind wrong inverts its 0 and 1; "
            "leave it out",
            key,
        )
    if name == "value":
        meaning, limits = _VALUES[fault.kind]
        if limits is not None and not limits[0] <= value <= limits[1]:
            raise ScenarioError(
                f"{key} = {show(value)} is outside {show(limits[0])}..{show(limits[1])}, "
                f"the range of kind {fault.kind} ({meaning})",
                key,
            )
