"""Recorded poses of a standing levelling platform: what calibration is made of."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.systems.levelling_platform.geometry import LEG_COUNT

type Floats = NDArray[np.float64]

_COLUMNS = ("extension", "attitude", "height", "contact", "ground", "reference", "heading")


@dataclass(frozen=True)
class MeasurementNoise:
    """Standard deviations of recorded values; independent from pose to pose.

    Attributes:
        extension: deviation of the actuators' encoders [m].
        attitude: deviation of the inertial sensor's roll and pitch, beside its bias [rad].
        height: deviation of the height [m].
        reference: deviation of the reference's roll and pitch [rad].
    """

    extension: float
    attitude: float
    height: float
    reference: float = np.radians(0.01)

    def __post_init__(self) -> None:
        if not min(self.extension, self.attitude, self.height, self.reference) > 0.0:
            raise ValueError(f"standard deviations must be positive, not {self}")


@dataclass(frozen=True, eq=False)
class PoseRecording:
    """Poses of a platform that stood still in each of them.

    Attributes:
        extension: (n, 4) of the actuators, as the encoders say [m].
        attitude: (n, 2) roll and pitch, as the inertial sensor says [rad].
        height: (n) of the platform's centre F above the ground's plane [m]; None if it was not
            measured.
        contact: (n, 4) which feet stand; one in the air says nothing.
        noise: deviations of these.
        ground: (n, 2) roll and pitch of the ground in the platform's heading [rad]; None for
            one unknown plane, which is then identified too.
        reference: (n, 2) roll and pitch by an instrument that has no bias against the platform's
            frame, such as the optical tracker of Appendix B [rad]; NaN where it did not measure,
            None if it never did.
        heading: (n) by how much the platform was turned about the vertical [rad]; says
            something only of unknown ground.
    """

    extension: Floats
    attitude: Floats
    height: Floats | None
    contact: NDArray[np.bool_]
    noise: MeasurementNoise
    ground: Floats | None = None
    reference: Floats | None = None
    heading: Floats | None = None

    def __post_init__(self) -> None:
        n = len(self.extension)
        if not n:
            raise ValueError("there are no poses")
        shapes = {
            "extension": (n, LEG_COUNT),
            "attitude": (n, 2),
            "height": (n,),
            "contact": (n, LEG_COUNT),
            "ground": (n, 2),
            "reference": (n, 2),
            "heading": (n,),
        }
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values is None:
                continue
            if np.shape(values) != shape:
                raise ValueError(f"{name} must be {shape}, not {np.shape(values)}")
            usable = np.isfinite(values)
            if name == "reference":
                usable |= np.isnan(values).all(axis=1, keepdims=True)
            if not usable.all():
                pose = int(np.argwhere(~usable)[0][0]) + 1
                raise ValueError(f"{name} of pose {pose} is not finite")

    def __len__(self) -> int:
        return len(self.extension)

    @property
    def turned(self) -> Floats:
        """The heading (n), zero if none was recorded [rad]."""
        return np.zeros(len(self)) if self.heading is None else self.heading

    @property
    def referenced(self) -> NDArray[np.bool_]:
        """In which poses (n) the reference measured."""
        if self.reference is None:
            return np.zeros(len(self), dtype=bool)
        return np.isfinite(self.reference).all(axis=1)

    def __getitem__(
        self, poses: "slice | NDArray[np.intp] | NDArray[np.bool_]"
    ) -> "PoseRecording":
        """The recording of some of the poses."""
        columns: dict[str, Any] = {}
        for name in _COLUMNS:
            column = getattr(self, name)
            columns[name] = None if column is None else column[poses]
        return replace(self, **columns)
