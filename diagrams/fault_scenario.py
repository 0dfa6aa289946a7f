"""Faults of the levelling platform's signals in a scenario, checked and made ready to inject."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parapod.diagrams.levelling_platform.ports import INPUTS, OUTPUTS
from parapod.diagrams.scenario import choice, quantity
from parapod.diagrams.scenario_reader import Reader
from parapod.diagrams.scenario_tree import plain
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import show
from parapod.systems.safety.faults import LONGEST_DELAY, Fault, FaultInjector, FaultKind
from parapod.systems.sensors.imu import ImuParams

_PORTS = {spec.name: spec for spec in (*INPUTS, *OUTPUTS)}
_ACTUATOR, _IMU = LinearActuatorParams(), ImuParams()
_SUPPLY = _ACTUATOR.supply_voltage


@dataclass(frozen=True)
class FaultTarget:
    """A signal of the levelling platform that can have faults.

    Attributes:
        port: name of the port whose injector the faults go to.
        size: its number of elements.
        low: smallest plausible value, of garbage; one for all elements or one for each.
        high: largest, likewise.
        off_value: what it shows of a device that does not publish.
        is_binary: its values are 0 and 1.
        wrong: factor [-] and offset (in the port's unit) of a wrong value when nothing is said.
    """

    port: str
    size: int
    low: float | tuple[float, ...]
    high: float | tuple[float, ...]
    off_value: float = 0.0
    is_binary: bool = False
    wrong: tuple[float, float] = (1.0, 0.0)


def _station_port(
    name: str,
    low: float,
    high: float,
    wrong: tuple[float, float] = (1.0, 0.0),
    is_binary: bool = False,
) -> FaultTarget:
    return FaultTarget(name, _PORTS[name].size, low, high, is_binary=is_binary, wrong=wrong)


TARGETS: dict[str, FaultTarget] = {
    # A counter that has lost 5 mm.
    "legs.extension": _station_port(
        "legs.extension", _ACTUATOR.stop_min, _ACTUATOR.stop_max, (1.0, 5e-3)
    ),
    # 5.7 deg/s and a tenth of gravity: too much for a bias, too little to be absurd.
    "imu.gyro": _station_port("imu.gyro", -_IMU.gyro_range, _IMU.gyro_range, (1.0, 0.1)),
    "imu.accel": _station_port("imu.accel", -_IMU.accel_range, _IMU.accel_range, (1.0, 1.0)),
    "legs.limits": _station_port("legs.limits", 0.0, 1.0, is_binary=True),
    # Swapped wires.
    "legs.voltage": _station_port("legs.voltage", -_SUPPLY, _SUPPLY, (-1.0, 0.0)),
    # All four drives at once; a wrong supply has half its voltage.
    "supply": FaultTarget("legs.voltage", 4, -_SUPPLY, _SUPPLY, wrong=(0.5, 0.0)),
    # NaN is no command: the reference keeps to the last one.
    "posture_command": FaultTarget(
        "posture_command",
        3,
        low=(math.radians(-10.0), math.radians(-10.0), 0.38),
        high=(math.radians(10.0), math.radians(10.0), 0.58),
        off_value=math.nan,
        wrong=(1.0, 0.02),
    ),
}
KINDS = tuple(kind.value for kind in FaultKind)

# What `value` is, for the kinds that have one, and its admissible range; None: any.
_VALUES: dict[str, tuple[str, tuple[float, float] | None]] = {
    FaultKind.WRONG: ("offset in the port's unit", None),
    FaultKind.SLOW: ("period in s", (0.01, 60.0)),
    FaultKind.DELAYED: ("delay in s", (0.001, LONGEST_DELAY)),
    FaultKind.INTERMITTENT: ("turn in s", (0.05, 60.0)),
}


@dataclass
class FaultScenario:
    """One fault.

    Attributes:
        at: when it begins, in the time of the simulation [s].
        target: signal, by its port's name; "supply" is all four drives' voltage at once,
            "posture_command" what the platform is asked to do.
        index: element of the port, counted from 0; -1 for all of them.
        kind: what happens, see `FaultKind`.
        duration: [s]; null: to the end.
        value: by its kind: offset of a wrong value (the port's unit), sampling period of a slow
            signal [s], delay of a delayed one [s], length of an intermittent one's turns, missing
            and good alike [s]; null: the target's or the kind's default. Others have none.
        scale: factor of a wrong value, likewise [-].
    """

    at: float = quantity(0.0, 0.0, 3600.0)
    target: str = choice("legs.extension", tuple(TARGETS))
    index: int = quantity(-1, -1, max(target.size for target in TARGETS.values()) - 1)
    kind: str = choice(FaultKind.OFF.value, KINDS)
    duration: float | None = quantity(None, 1e-3, 3600.0)
    value: float | None = quantity(None, -1e3, 1e3)
    scale: float | None = quantity(None, -1e3, 1e3)

    def __post_init__(self) -> None:
        if isinstance(self.kind, FaultKind):  # of which YAML knows nothing
            self.kind = self.kind.value


def check_faults(
    faults: Sequence[FaultScenario], seed: int = 0, key: str = "faults"
) -> dict[str, tuple[Fault, ...]]:
    """The faults of each port that has any, for its injector.

    Faults of the supply come after the drives' own in the result, so that they count.

    Args:
        faults: as in a scenario.
        seed: of garbage; faults with the same seed differ from each other.
        key: where the scenario has them, for messages.

    Raises:
        ScenarioError: an index that the port does not have, a value that the kind does not have,
            or anything that `check` refuses.
    """
    by_target: dict[str, list[Fault]] = {name: [] for name in TARGETS}
    for i, fault in enumerate(faults):
        where = f"{key}.{i}"
        Reader(FaultScenario, is_text=False).read(FaultScenario, plain(fault), where)
        _check_index(fault, f"{where}.index")
        for name in ("value", "scale"):
            _check_setting(fault, name, f"{where}.{name}")
        # The same for a fault whether or not others come after it.
        own_seed = int(np.random.SeedSequence((seed, i)).generate_state(1)[0])
        by_target[fault.target].append(_made(fault, own_seed))
    ports = dict.fromkeys(target.port for target in TARGETS.values())
    found = {
        port: tuple(f for name in TARGETS if TARGETS[name].port == port for f in by_target[name])
        for port in ports
    }
    return {port: made for port, made in found.items() if made}


def make_fault_injector(port: str, period: float, faults: Sequence[Fault] = ()) -> FaultInjector:
    """The injector of a port, of the targets' table.

    Args:
        port: its name; the supply's faults go to `legs.voltage`.
        period: of what reads it [s].
        faults: of this port, as `check_faults` gives them.
    """
    target = TARGETS[port]
    injector = FaultInjector(
        target.size,
        faults,
        period,
        off_value=target.off_value,
        span=(target.low, target.high),
        is_binary=target.is_binary,
    )
    injector.set_name(f"fault.{target.port}")
    return injector


def _made(scenario: FaultScenario, seed: int) -> Fault:
    value = scenario.value
    settings: dict[str, float] = {}
    if scenario.kind == FaultKind.WRONG:
        settings["scale"], settings["offset"] = TARGETS[scenario.target].wrong
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


def _check_index(fault: FaultScenario, key: str) -> None:
    target = TARGETS[fault.target]
    if fault.target == "supply" and fault.index != -1:
        raise ScenarioError(
            f"{key} = {fault.index} is not -1; supply is all {target.size} drives at once", key
        )
    if fault.index >= target.size:
        raise ScenarioError(
            f"{key} = {fault.index} is outside -1..{target.size - 1}; {fault.target} has elements "
            f"0..{target.size - 1}, -1 is all of them",
            key,
        )


def _check_setting(fault: FaultScenario, name: str, key: str) -> None:
    """Whether the kind has this setting, and its value is allowed."""
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
    if fault.kind == FaultKind.WRONG and TARGETS[fault.target].is_binary:
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
