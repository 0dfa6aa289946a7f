"""Units of the levelling platform's signals, for logs."""

from collections.abc import Mapping

from numpy.typing import ArrayLike

from parapod.diagrams.levelling_platform.ports import INPUTS, OUTPUTS, TRUTH_OUTPUTS

_UNITS = {spec.name: spec.unit for spec in (*INPUTS, *OUTPUTS, *TRUTH_OUTPUTS)} | {
    # Of the controller.
    "posture_command": "rad, rad, m",
    "posture_desired_state": "rad, rad, m, and their rates",
    "extension_desired_state": "m, m/s",
    "ground_estimated": "rad",
    "ground_valid": "0/1",
    "foot_offsets_estimated": "m",
    "attitude_estimated": "rad",
    # Of the supervision and the operator.
    "phase": "-",
    "findings": "0/1",
    "severity": "-",
    "refusal": "-",
    "arm_command": "rad",
    "arm_refused": "0/1",
    "arm_margin": "m",
    "stability_margin": "m",
    "operator": "-",
    "drive_request": "m/s, rad/s",
    "posture_request": "rad, rad, m",
    "arm_request": "rad",
    "steps_done": "-",
}


def unit_of(name: str) -> str:
    """Unit of a signal, by the name of its port."""
    if name.startswith("fault."):
        return "s" if name.endswith(".extra_age") else "0/1"
    return _UNITS[name]


def with_units[T: ArrayLike](signals: Mapping[str, T]) -> dict[str, tuple[T, str]]:
    """The signals, each with its unit."""
    return {name: (samples, unit_of(name)) for name, samples in signals.items()}
