"""Controllers of a user's own: functions that a scenario names, and the ports of their systems."""

import importlib
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from pydrake.systems.framework import Diagram, PortDataType, System

from parapod.diagrams.wiring import inputs_of, leaf_systems, outputs_of
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.quoting import quoted_path, show

OWN = "control.controller"  # key of the function that makes a controller


def own_name(scenario: object) -> str:
    """The function that a scenario's `control.controller` names; "" for none."""
    name: str = getattr(getattr(scenario, "control", None), "controller", "")
    return name


def own_system(key: str, name: str, *arguments: object, outputs: Iterable[str]) -> System:
    """System that a function of a user's own makes.

    Args:
        key: key of the scenario that names the function.
        name: the function, as "file.py:function" or "package.module:function".
        arguments: arguments that it is called with.
        outputs: names of the outputs that the system must have.

    Raises:
        ScenarioError: the function cannot be loaded or fails, or returns anything but a system
            with these outputs, all of whose ports are vectors.
    """
    title = f"{key} = {quoted_path(name)}"
    make = _function(key, name)
    try:
        system = make(*arguments)
    except ParapodError as error:
        raise ScenarioError(f"{title}: {error}", key) from error
    except Exception as error:
        raise ScenarioError(f"{title} has failed: {_cause(error)}", key) from error
    if not isinstance(system, System):
        raise ScenarioError(
            f"{title} must return a LeafSystem or Diagram, not {show(system)}", key
        )
    ports = outputs_of(system)
    if missing := [output for output in outputs if output not in ports]:
        has = ", ".join(ports) or "none"
        raise ScenarioError(f"{title} lacks the output {', '.join(missing)}; it has: {has}", key)
    every_port: list[Any] = [*inputs_of(system).values(), *ports.values()]
    for port in every_port:
        if port.get_data_type() != PortDataType.kVectorValued:
            raise ScenarioError(f"{title}: the port '{port.get_name()}' must be a vector", key)
    return system


def check_period(key: str, name: str, system: System, period: float) -> None:
    """Refuses a system that is sampled between the instants of its machine.

    Args:
        key: key of the scenario that names its function.
        name: the function.
        system: the system.
        period: period of the machine's controllers [s]; whole multiples are admissible.

    Raises:
        ScenarioError: tells both periods.
    """
    for leaf in leaf_systems(system) if isinstance(system, Diagram) else (system,):
        timing = leaf.GetUniquePeriodicDiscreteUpdateAttribute()
        if timing is None:
            continue
        for words, seconds in (("period", timing.period_sec()), ("offset", timing.offset_sec())):
            ticks = seconds / period
            if abs(ticks - round(ticks)) > 1e-6 * max(1.0, ticks):
                leaf_name = leaf.get_name() or type(leaf).__name__
                raise ScenarioError(
                    f"{key} = {quoted_path(name)}: '{leaf_name}' has a {words} of "
                    f"{seconds:g} s, but it must be a multiple of control.period = {period:g} s",
                    key,
                )


def _function(key: str, name: str) -> Callable[..., object]:
    """Function that a text names; the code of a file is run anew for each system.

    Raises:
        ScenarioError: there is none.
    """
    title = f"{key} = {quoted_path(name)}"
    place, colon, attribute = name.rpartition(":")
    if not (colon and place and attribute):
        raise ScenarioError(f"{title} must be FILE.py:FUNCTION or PACKAGE.MODULE:FUNCTION", key)
    if place.endswith(".py") and not Path(place).is_file():
        raise ScenarioError(f"{title}: there is no such file", key)
    try:
        if place.endswith(".py"):
            path = str(Path(place).resolve())
            # Known by its path, which no other module has as its name: dataclasses look there.
            module = sys.modules[path] = ModuleType(path)
            module.__file__ = path
            exec(compile(Path(path).read_bytes(), path, "exec"), module.__dict__)
        else:
            module = importlib.import_module(place)
    except Exception as error:
        raise ScenarioError(f"{title} cannot be loaded: {_cause(error)}", key) from error
    function: Callable[..., object] | None = getattr(module, attribute, None)
    if not callable(function):
        raise ScenarioError(f"{title}: there is no function '{attribute}' in {place}", key)
    return function


def _cause(error: Exception) -> str:
    """Kind and words of an error, and the line in which it was raised."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    words = f"{type(error).__name__}: {error}".removesuffix(": ")
    if frame.filename == __file__ or isinstance(error, SyntaxError | ImportError):
        return words
    return f"{words} ({Path(frame.filename).name}, line {frame.lineno})"
