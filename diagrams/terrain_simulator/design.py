"""Design of a terrain simulator: dimensions, bodies, drives; the paper's are the defaults.

What is null follows from the configuration: the paper has a bench with a pedal and one with a
treadmill.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from parapod.diagrams.bodies import Body, BodyScenario, body_of, in_si
from parapod.diagrams.terrain_simulator.model import masses_of
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.terrain_simulator.cells import CellsGeometry
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import slider_places
from parapod.systems.terrain_simulator.load_estimator import BenchMasses
from parapod.systems.terrain_simulator.path import PathLimits
from parapod.systems.terrain_simulator.ranges import holding_forces
from parapod.systems.terrain_simulator.workspace import rail_interval, workspace

# Smallest and largest length [mm].
_SHORT, _LONG = 0.1, 20_000.0
# Heights at which a level plate is looked for, and end of a rail that is long enough [m].
_LOOKS, _ENDLESS = 101, 1e3


class _Preset(NamedTuple):
    """Values of a configuration for keys that are null."""

    geometry: Callable[[], BenchGeometry]
    plate: float  # mass [kg]
    tread: float  # mass [kg]
    apart: float  # of the cells [mm]
    height: float  # of the plate's middle for a walk, by the length of a link [-]
    behind: float  # of the middle of the workspace, by the length of a link [-]


_PRESETS = {
    "pedal": _Preset(BenchGeometry.pedal, 0.4, 0.6, 50.0, 1.0, 0.0),
    "treadmill": _Preset(BenchGeometry.treadmill, 1.0, 7.0, 250.0, 19.0 / 30.0, 1.0 / 15.0),
}


@dataclass
class SliderScenario(Schema):
    """The sliders' position-controlled drives; all values are assumptions.

    Attributes:
        max_velocity_m_s: largest velocity of a slider [m/s].
        max_acceleration_m_s2: largest acceleration of a slider [m/s^2].
        max_force_N: largest force of a slider, both ways [N].
        force_per_current_N_A: force of a slider by the current of its motor [N/A].
        stiffness_N_um: stiffness of a slider with its screw or belt and drive [N/um].
        time_constant_ms: time constant of the drives' velocity loop [ms].
        arrival_ms: time in which a drive makes up for what is missing of a command [ms]; null: the
            controller's period.
        encoder_resolution_mm: one count of the encoders [mm]; 0 for perfect ones.
        least_sin_mu: least sine of the transmission angle between plate and strut [-].
    """

    max_velocity_m_s: float = quantity(3.5, 0.01, 50.0)
    max_acceleration_m_s2: float = quantity(110.0, 0.1, 2000.0)
    max_force_N: float = quantity(4000.0, 10.0, 1e6)  # noqa: N815 (the unit's symbol)
    force_per_current_N_A: float = quantity(100.0, 1.0, 1e5)  # noqa: N815
    stiffness_N_um: float = quantity(50.0, 0.1, 10_000.0)  # noqa: N815
    time_constant_ms: float = quantity(0.5, 0.05, 100.0)
    arrival_ms: float | None = quantity(None, 1.0, 1000.0)
    encoder_resolution_mm: float = quantity(0.001, 0.0, 0.1)
    least_sin_mu: float = quantity(0.25, 0.05, 0.9)

    @property
    def limits(self) -> PathLimits:
        """Limits of a path; its other ones are those of Table 1."""
        return PathLimits(
            sin_mu=self.least_sin_mu,
            slider_speed=self.max_velocity_m_s,
            slider_acceleration=self.max_acceleration_m_s2,
        )


@dataclass
class CellsScenario(Schema):
    """The force cells under the plate; all values are assumptions.

    Attributes:
        noise_N: standard deviation of a reading [N].
        apart_mm: distance of each of the two cells across the plate from its middle [mm]; null:
            50 of a pedal, 250 of a treadmill.
        capacity_N: largest force of a cell [N].
    """

    noise_N: float = quantity(1.0, 0.0, 1000.0)  # noqa: N815
    apart_mm: float | None = quantity(None, _SHORT, _LONG)
    capacity_N: float = quantity(3000.0, 1.0, 1e6)  # noqa: N815


@dataclass
class BenchDesign(Schema):
    """The bench: its dimensions are those of Table 2, its masses and drives assumptions.

    Attributes:
        configuration: "pedal" or "treadmill".
        link_mm: length of the two links from the sliders 1 and 2 to the pivot P [mm]; null: 300.
        strut_mm: length of the link from slider 3 to the pivot T [mm]; null: 420 of a pedal, 450
            of a treadmill.
        lever_mm: distance of the pivots P and T [mm]; null: 90 of a pedal, 600 of a treadmill.
        plate_mm: length of the plate [mm]; null: 120 of a pedal, 600 of a treadmill.
        offset_deg: angle of the plate against the line from P to T [deg]; null: 33 of a pedal, 0
            of a treadmill.
        strut_ahead: true if slider 3 is ahead of T; null: true of a pedal, false of a treadmill.
        slider_min_mm: place of each slider at the rear end of its rail [mm].
        slider_max_mm: place of each slider at the front end [mm].
        gap_mm: least distance of the sliders 1 and 2, which a stop keeps apart [mm].
        strut_gap_mm: least distance of the sliders 2 and 3 [mm]; 0: they pass each other, on rails
            of their own; null: 100 of a pedal, 0 of a treadmill.
        floor_mm: least height of the pivots P and T [mm].
        hip_min_mm: lowest height of the hip's slide [mm].
        hip_max_mm: greatest height of the hip's slide [mm].
        slider: each slider.
        link: each of the two links; its frame is in its slider, x along it.
        strut: link of slider 3; its frame is in T, x along it and away from the slider.
        plate: carrier of the tread; null: 0.4 kg of a pedal, 1 kg of a treadmill. Its frame is in
            P, x along the plate.
        tread: surface for the foot, borne by the cells; null: 0.6 kg of a pedal, 7 kg of a
            treadmill. Its frame is that of the plate.
        sliders: see `SliderScenario`.
        cells: see `CellsScenario`.
    """

    configuration: str = choice("pedal", tuple(_PRESETS))
    link_mm: float | None = quantity(None, _SHORT, _LONG)
    strut_mm: float | None = quantity(None, _SHORT, _LONG)
    lever_mm: float | None = quantity(None, _SHORT, _LONG)
    plate_mm: float | None = quantity(None, _SHORT, _LONG)
    offset_deg: float | None = quantity(None, -89.0, 89.0)
    strut_ahead: bool | None = None
    slider_min_mm: float = quantity(80.0, -_LONG, _LONG)
    slider_max_mm: float = quantity(1120.0, -_LONG, _LONG)
    gap_mm: float = quantity(100.0, _SHORT, _LONG)
    strut_gap_mm: float | None = quantity(None, 0.0, _LONG)
    floor_mm: float = quantity(20.0, _SHORT, _LONG)
    hip_min_mm: float = quantity(400.0, -_LONG, _LONG)
    hip_max_mm: float = quantity(1400.0, -_LONG, _LONG)
    slider: BodyScenario = body_of(2.0)
    link: BodyScenario = body_of(0.5)
    strut: BodyScenario = body_of(0.5)
    plate: BodyScenario | None = None
    tread: BodyScenario | None = None
    sliders: SliderScenario = field(default_factory=SliderScenario)
    cells: CellsScenario = field(default_factory=CellsScenario)

    @property
    def geometry(self) -> BenchGeometry:
        """Its dimensions in SI units.

        Raises:
            ScenarioError: dimensions that no bench has; names the key.
        """
        usual = _PRESETS[self.configuration].geometry()
        ahead, gap = self.strut_ahead, self.strut_gap_mm
        return in_si(
            self,
            BenchGeometry,
            usual=usual,
            strut_ahead=usual.strut_ahead if ahead is None else ahead,
            strut_gap=usual.strut_gap if gap is None else (gap / 1e3 or None),
            belt=usual.belt,
        )

    @property
    def bodies(self) -> dict[str, Body]:
        """Its links by their names in `parapod.urdf.terrain_simulator`."""
        usual = _PRESETS[self.configuration]
        bodies = {f"slider_{i}": self.slider.body for i in (1, 2, 3)}
        bodies |= dict.fromkeys(("link_1", "link_2"), self.link.body)
        bodies["strut"] = self.strut.body
        for name, mass in (("plate", usual.plate), ("tread", usual.tread)):
            body: BodyScenario | None = getattr(self, name)
            bodies[name] = Body(mass) if body is None else body.body
        return bodies

    @property
    def masses(self) -> BenchMasses:
        """Its masses, as the plant that is built has them.

        Raises:
            ScenarioError: as `geometry`.
        """
        return masses_of(self.geometry, tuple(self.bodies.items()))[0]

    @property
    def cells_geometry(self) -> CellsGeometry:
        """Its cells, and the tread that they bear, as the plant that is built has it.

        Raises:
            ScenarioError: as `geometry`.
        """
        apart = self.cells.apart_mm or _PRESETS[self.configuration].apart
        _, tread = masses_of(self.geometry, tuple(self.bodies.items()))
        return CellsGeometry(apart / 1e3, tread.mass, tread.inertia, tread.centre)

    def place(self, height: float | None = None) -> tuple[float, float]:
        """Place along the rail, and height, at which the plate walks over level ground [m].

        Args:
            height: height of the plate's middle [m]; None: one at which it works well.

        Returns:
            Place and height [m]; the place is the middle of what the level plate reaches there, to
            a millimetre.

        Raises:
            ScenarioError: the level plate reaches nothing at that height.
        """
        usual, geometry = _PRESETS[self.configuration], self.geometry
        z = usual.height * geometry.link if height is None else height
        rear, front = rail_interval(geometry, z, 0.0, self.sliders.least_sin_mu).tolist()
        if math.isnan(rear):
            raise ScenarioError(
                f"place.z_mm: at {1e3 * z:g} mm the level plate of this bench reaches no place",
                "place.z_mm",
            )
        return round(0.5 * (rear + front), 3) - usual.behind * geometry.link, z

    def check(self) -> None:
        """Refuses a bench whose links do not close, whose rail is too short, or that is too weak.

        Raises:
            ScenarioError: names the key, and the admissible values.
        """
        if not self.hip_min_mm < self.hip_max_mm:
            key = "machine.hip_max_mm"
            raise ScenarioError(
                f"{key} = {self.hip_max_mm:g} must be more than hip_min_mm = {self.hip_min_mm:g}",
                key,
            )
        geometry, least = self.geometry, self.sliders.least_sin_mu
        level = workspace(geometry, 0.0, least, _LOOKS)
        if level.is_empty:
            self._refuse_empty(geometry, least)
        middle = len(level.z) // 2
        pose = np.array((level.ends[middle].mean(), level.z[middle], 0.0))
        forces = holding_forces(geometry, self.masses, pose, np.zeros(3))
        largest, most = float(np.abs(forces).max()), self.sliders.max_force_N
        if largest > most:
            key = "machine.sliders.max_force_N"
            raise ScenarioError(
                f"{key} = {most:g}: it cannot lift its plate: a slider has to hold "
                f"{largest:.0f} N, {largest - most:.0f} N more; it must be at least "
                f"{math.ceil(largest)}",
                key,
            )

    def _refuse_empty(self, geometry: BenchGeometry, least: float) -> None:
        """Tells why a level plate can be nowhere: its links, or its rail."""
        endless = replace(geometry, slider_min=-_ENDLESS, slider_max=_ENDLESS)
        free = workspace(endless, 0.0, least, _LOOKS)
        if free.is_empty:
            key = "machine"
            raise ScenarioError(
                f"{key}: links of {1e3 * geometry.link:g} mm, a strut of "
                f"{1e3 * geometry.strut:g} mm and a lever of {1e3 * geometry.lever:g} mm hold a "
                f"level plate nowhere with sin mu of {least:g} or more; other lengths are needed",
                key,
            )
        poses = np.stack((0.0 * free.z, free.z, 0.0 * free.z), axis=-1)
        needed = 1e3 * float(np.ptp(slider_places(geometry, poses), axis=-1).min())
        key = "machine.slider_max_mm"
        raise ScenarioError(
            f"{key} = {self.slider_max_mm:g}: its rail of "
            f"{self.slider_max_mm - self.slider_min_mm:g} mm is too short for a level plate; it "
            f"must be more than {math.ceil(self.slider_min_mm + needed)}",
            key,
        )
