"""Measure which points the tip of a rod that bends reaches, what the legs add, and its sag.

Section 4 of the paper continued: arm and turntable carry the tip, the legs move their base, and
the rod bends under its weight. Nothing is simulated. The reach is filled with vertical columns
(`TipColumns`), whose ends the legs' strokes, the joints' limits, the ground, the platform's base
and its stability margin set; a volume is the sum of columns by their areas. It is worked out again
with half as many columns in each direction and half as many attitudes.

With the legs at rest the tip comes to a surface only. The height of the level platform makes it a
shell, whose volume a quadrature over its radius gives as well. Attitudes make the shell thicker,
most at its rim: there the rod is horizontal, and the platform inclines it to below that.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.geometry import Meshcat

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.pointing import carried_arm
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.panel import Panel, Row
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.options import RunOptions
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.levelling_platform.carried_arm import CarriedArm
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.tip_columns import TipColumns, largest_swing

# Largest difference of a volume to that at half the resolution, of that of the level platform to
# its quadrature, and of the horizontal rod's sag to beam theory.
_RESOLUTION_BOUND, _LEVEL_BOUND, _SAG_BOUND = 0.02, 0.01, 1e-9
# Parts that move the tip, by the names of the reaches.
_REACHES = {
    "level": "arm, turntable and height of the level platform",
    "tilting": "arm, turntable and all postures",
    "locked": "arm and all postures, turntable locked",
}
# Columns in each direction by the steps of an attitude from zero to its end.
_COLUMNS_BY_STEPS = 4
# Leans and radii of a quadrature, and turns at which ground, base and stability are looked at.
_SAMPLES, _TURNS = 2001, 8
# Leans of which a note tells the sag [deg].
_LEANS = 30.0


@dataclass
class ArmWorkspaceScenario(Schema):
    """Questions about the points that the tip of an arm that bends reaches, on level ground.

    Attributes:
        backend: method: "exact", closed forms and Newton's method.
        seed: nothing is random.
        resolution: number of columns in each of two directions.
        machine: see `PlatformDesign`; its arm must be `!Rod` or `!FlexibleRod`.
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    resolution: int = quantity(16, 16, 96)
    machine: PlatformDesign = field(default_factory=PlatformDesign)

    @property
    def carried(self) -> CarriedArm:
        """Platform and arm as one chain."""
        return carried_arm(LevellingScenario(machine=self.machine))


@dataclass(frozen=True)
class Reaches:
    """Volumes of the tip's reach by what moves it [m^3].

    Attributes:
        fine: at the resolution.
        coarse: at half of it.
        rigid: the latter of a rigid rod; empty where the rod is rigid.
    """

    fine: dict[str, float]
    coarse: dict[str, float]
    rigid: dict[str, float]


class ArmWorkspace(Experiment[ArmWorkspaceScenario, Reaches]):
    """Measures reach and sag of the arm's tip."""

    schema = ArmWorkspaceScenario
    backends = ("exact",)
    takes = "20 s"

    def check(self, scenario: ArmWorkspaceScenario) -> None:
        """Refuses an arm other than a rod on a turntable.

        Raises:
            ScenarioError: names the key.
        """
        super().check(scenario)
        if scenario.machine.arm.length is None:
            raise ScenarioError(
                "machine.arm must be !Rod or !FlexibleRod, a rod on a turntable", "machine.arm"
            )

    def run(self, scenario: ArmWorkspaceScenario, runner: Runner) -> Reaches:
        """Works out the volumes."""
        carried, resolution = scenario.carried, scenario.resolution
        rigid = replace(carried, rod=None)
        with runner.console.status("") as status:

            def volumes(each: CarriedArm, count: int, which: str = "") -> dict[str, float]:
                by_name = {}
                for name, how in _REACHES.items():
                    status.update(f"filling the reach by {how}{which}")
                    steps = 0 if name == "level" else max(1, count // _COLUMNS_BY_STEPS)
                    by_name[name] = TipColumns(each, steps, name == "locked").volume(count)
                return by_name

            return Reaches(
                volumes(carried, resolution),
                volumes(carried, resolution // 2, ", at half the resolution"),
                {} if carried.rod is None else volumes(rigid, resolution // 2, ", rigid rod"),
            )

    def measure(self, scenario: ArmWorkspaceScenario, data: Reaches) -> Iterator[Metric]:
        """Sag, beside beam theory; volumes, beside those of half the resolution."""
        carried = scenario.carried
        sags = level_sag(carried, np.linspace(0.0, largest_swing(carried), _SAMPLES))
        yield Metric(
            "largest_sag_mm",
            1e3 * float(sags.max()),
            "mm",
            meaning="largest distance of the tip from where a rigid rod has it, platform level",
        )
        if carried.rod is not None:
            yield Metric(
                "horizontal_sag_error",
                horizontal_sag_error(carried),
                "",
                _SAG_BOUND,
                meaning="difference of the horizontal rod's sag to a clamped beam's, by that",
            )
        for name, how in _REACHES.items():
            volume = data.fine[name]
            meaning = f"volume that the tip reaches by {how}"
            yield Metric(f"{name}_volume_m3", volume, "m^3", meaning=meaning)
            if data.rigid:
                ratio = data.coarse[name] / data.rigid[name]
                meaning = f"ratio of the volume by {how} to that of a rigid rod's tip"
                yield Metric(f"{name}_by_rigid", ratio, meaning=meaning)
            yield Metric(
                f"{name}_resolution_error",
                abs(data.coarse[name] / volume - 1.0),
                "",
                _RESOLUTION_BOUND,
                meaning=f"relative change, from half the resolution, of the volume by {how}",
            )
        shell = level_volume(carried)
        if shell is not None:
            yield Metric(
                "level_volume_error",
                abs(data.fine["level"] / shell - 1.0),
                "",
                _LEVEL_BOUND,
                meaning="difference of the level platform's volume to a quadrature over the "
                "radius, by that",
            )

    def note(self, scenario: ArmWorkspaceScenario, data: Reaches) -> Iterator[str]:
        """The sag of the leaning arm."""
        carried = scenario.carried
        if carried.rod is not None:
            most = math.degrees(largest_swing(carried))
            leans = np.append(np.arange(_LEANS, most - 1.0, _LEANS), most)
            sags = 1e3 * level_sag(carried, np.radians(leans))
            parts = (f"{s:.1f} mm at {a:.0f} deg" for s, a in zip(sags, leans, strict=True))
            yield f"On the level platform the tip of the leaning arm sags by {', '.join(parts)}."

    def draw(self, scenario: ArmWorkspaceScenario, data: Reaches) -> Iterator[Figure]:
        """The sag by turntable and arm, and sections of the reach."""
        from parapod.sims.levelling_platform.reach import figures

        yield from figures(scenario.carried)

    def scene(self, scenario: ArmWorkspaceScenario) -> Meshcat:
        """The platform in the middle of its stroke in its reach, which is cut open."""
        from parapod.sims.levelling_platform.reach import draw

        return draw(scenario.machine, scenario.carried)

    def afterwards(
        self, scenario: ArmWorkspaceScenario, data: Reaches, options: RunOptions
    ) -> Callable[[], None] | None:
        """Draws the reach for the browser; what is left to do is to wait for its viewers."""
        if not options.meshcat:
            return None
        from parapod.sims.levelling_platform.solid import present

        volumes = data.fine.items()
        rows = [
            Row(f"volume, {name}", true=each, unit="m^3", decimals=2) for name, each in volumes
        ]
        panel = Panel(self.scene(scenario), f"{self.name}: reach and sag of the arm's tip")
        return present(panel, "the reach", rows, options)


def level_sag(carried: CarriedArm, leans: Array) -> Array:
    """Distances (n) of the tip from where a rigid rod has it, platform level [m].

    Args:
        carried: platform and arm.
        leans: leans of the arm (n) [rad].
    """
    joints = np.column_stack([np.zeros_like(leans), leans])
    return np.asarray(np.linalg.norm(carried.deflection(carried.postures[0], joints), axis=-1))


def horizontal_sag_error(carried: CarriedArm) -> float:
    """Relative difference of the horizontal rod's sag to that of a clamped beam.

    Args:
        carried: platform and arm, whose rod bends.
    """
    rod = carried.rod
    assert rod is not None
    load = carried.params.gravity * (rod.tip_mass / 3.0 + rod.mass / 8.0)
    theory = load * rod.length**3 / rod.bending_stiffness[0]
    params = replace(carried.params, arm=carried.params.arm.stiff)
    stiff = replace(carried, params=params)
    down = -stiff.deflection(stiff.postures[0], (0.0, 0.5 * math.pi))[2]
    return abs(float(down) / theory - 1.0)


def level_volume(carried: CarriedArm) -> float | None:
    """Volume of the level platform's reach by a quadrature over the radius [m^3].

    Heights of the platform lift a curve that the turntable turns. Over a radius it has one point
    or two, above and below the horizontal.

    Args:
        carried: platform and arm.

    Returns:
        The volume; None where the reach has other limits as well: a turntable without a whole
        turn, the ground, the platform's base or its stability.
    """
    low, high = height_range(carried.geometry, (0.0, 0.0), (0.0, 0.0)).tolist()
    turntable, swings = carried.arm.joints[0], np.linspace(0.0, largest_swing(carried), _SAMPLES)
    turns = 2.0 * math.pi * np.arange(_TURNS)[:, np.newaxis] / _TURNS
    joints = np.stack(np.broadcast_arrays(turns, swings), axis=-1)
    is_whole = turntable.upper - turntable.lower >= 2.0 * math.pi
    if not (is_whole and carried.admits((0.0, 0.0, low), joints).all()):
        return None
    tips = carried.tip_position((0.0, 0.0, low), joints[0])
    radius, z = np.hypot(*(tips - tips[0])[:, :2].T), tips[:, 2]
    turning = int(radius.argmax())
    r = float(radius[turning]) * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    above = np.interp(r, radius[: turning + 1], z[: turning + 1])
    below = np.interp(r, radius[turning:][::-1], z[turning:][::-1], left=math.nan)
    apart = np.nan_to_num(np.minimum(above - below, high - low))
    return float(2.0 * math.pi * r @ (high - low + apart) * radius[turning] / _SAMPLES)
