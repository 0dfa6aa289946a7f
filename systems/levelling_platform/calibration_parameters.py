"""What calibration asks of the levelling platform: 36 numbers, and how far each may be off.

Of a leg's nine dimensions and its encoder's offset, ten numbers, eight act on its foot. The vector
from the foot to F is a constant c minus the long side l_4 turned by psi, and l_6 and l_7 occur in
c only (`LegGeometry.p_MF`):

    c = (l_x + l_6 cos alpha cos beta, l_y + l_6 cos alpha sin beta, l_z + l_7 + l_6 sin alpha).

A wrong l_7 is therefore the same as a wrong l_z, and a wrong l_6 the same as wrong l_x, l_y and
l_z, exactly and in every pose. Here l_6 and l_7 keep their nominal values, and l_x, l_y and l_z
answer for them: what is identified is where the foot is, not which part is off.

Parameters are arrays (36): for each leg `LEG_PARAMETERS`, then bias and ground, roll and pitch.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from parapod.systems.levelling_platform.geometry import (
    ANGLES,
    LEG_COUNT,
    LegDeviation,
    PlatformGeometry,
)

type Floats = NDArray[np.float64]

# A leg's dimensions that act differently on its foot; l_6 and l_7 do not (see above).
IDENTIFIABLE = ("l_x", "l_y", "l_z", "beta", "l_3", "l_4", "alpha")
LEG_PARAMETERS = (*IDENTIFIABLE, "offset")
LEG_WIDTH = len(LEG_PARAMETERS)
_LEGS_END = LEG_COUNT * LEG_WIDTH
# Where the bias of roll and pitch, and the ground's roll and pitch, stand among the parameters.
BIAS = slice(_LEGS_END, _LEGS_END + 2)
GROUND = slice(_LEGS_END + 2, _LEGS_END + 4)
PARAMETER_COUNT = GROUND.stop


@dataclass(frozen=True)
class Tolerances:
    """How far a parameter may be from nominal, either way; uniform within.

    Attributes:
        length: of the legs' lengths [m].
        angle: of the legs' angles [rad].
        offset: of the encoders [m].
        bias: of the inertial sensor's roll and pitch [rad]; 1 mg of accelerometer bias is 1 mrad.
        ground: of unknown ground from what the nominal legs make of it [rad].
    """

    length: float = 0.5e-3
    angle: float = np.radians(0.2)
    offset: float = 0.3e-3
    bias: float = 5e-3
    ground: float = np.radians(10.0)

    def of_parameters(self, nominal: PlatformGeometry) -> Floats:
        """The tolerance of each parameter (36), in the order of `parameter_names`.

        Those of l_x, l_y and l_z are larger than a single length's, because these answer for
        l_6 and l_7 too; the variances add.
        """
        rows = []
        for leg in nominal.legs:
            (ca, sa), (cb, sb) = leg.e_a, leg.e_b
            shares = {"l_x": (ca * cb,), "l_y": (ca * sb,), "l_z": (sa, 1.0)}
            for name in IDENTIFIABLE:
                single = self.angle if name in ANGLES else self.length
                rows.append(single * float(np.hypot.reduce((1.0, *shares.get(name, ())))))
            rows.append(self.offset)
        return np.array([*rows, self.bias, self.bias, self.ground, self.ground])


def parameter_names() -> tuple[str, ...]:
    """What the parameters (36) are called in words."""
    legs = [f"leg {i + 1}: {name}" for i in range(LEG_COUNT) for name in LEG_PARAMETERS]
    axes = ("roll", "pitch")
    bias = [f"accelerometer bias in {axis}" for axis in axes]
    return (*legs, *bias, *(f"the ground's {axis}" for axis in axes))


def deviated(nominal: PlatformGeometry, parameters: Floats) -> PlatformGeometry:
    """The geometry whose legs differ from nominal by the parameters (36)."""
    before = nominal.deviations or (LegDeviation(),) * LEG_COUNT
    rows = parameters[:_LEGS_END].reshape(LEG_COUNT, LEG_WIDTH)[:, : len(IDENTIFIABLE)].tolist()
    deviations = []
    for deviation, row in zip(before, rows, strict=True):
        moved = {
            name: getattr(deviation, name) + change
            for name, change in zip(IDENTIFIABLE, row, strict=True)
        }
        deviations.append(replace(deviation, **moved))
    return replace(nominal, deviations=tuple(deviations))


def offsets_of(parameters: Floats) -> Floats:
    """The encoders' offsets (4) among the parameters (36) [m]."""
    return parameters[:_LEGS_END].reshape(LEG_COUNT, LEG_WIDTH)[:, -1]


def equivalent_parameters(
    geometry: PlatformGeometry, nominal: PlatformGeometry, offsets: Floats, bias: Floats
) -> Floats:
    """The parameters (36) that act as a geometry whose every dimension differs from nominal.

    Args:
        geometry: the machine as built.
        nominal: what the parameters count from.
        offsets: (4) what is added to the encoders' extensions [m].
        bias: (2) error of roll and pitch [rad].

    Returns:
        The parameters; those of the ground are zero.
    """
    rows = []
    for built, drawn, offset in zip(geometry.legs, nominal.legs, offsets, strict=True):
        # l_x, l_y, l_z that bring about the same c with the nominal l_6 and l_7.
        same = replace(built, l_6=drawn.l_6, l_7=drawn.l_7)
        moved = np.subtract(built.p_MF, same.p_MF)
        lengths = np.add([built.l_x, built.l_y, built.l_z], moved)
        values = dict(zip(("l_x", "l_y", "l_z"), lengths.tolist(), strict=True))
        rows += [values.get(k, getattr(built, k)) - getattr(drawn, k) for k in IDENTIFIABLE]
        rows.append(float(offset))
    return np.array([*rows, *bias, 0.0, 0.0])
