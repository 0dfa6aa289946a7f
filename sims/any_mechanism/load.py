"""Put a mass on the frame of a mechanism, and compare its motors' forces with statics.

Statics project the inverse dynamics of the open tree onto the motions that loops let. Rigid bodies
with constraints do not know of that: both prove each other. Over the ends of a tour it is told
which mass the motors could carry, and where they are weakest.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.any_mechanism.design import BuiltMechanism, MechanismDesign
from parapod.diagrams.any_mechanism.scenario import (
    MULTIBODY,
    MechanismPlantScenario,
    MechanismScenario,
)
from parapod.diagrams.any_mechanism.track import TrackScenario, Waypoint, farthest
from parapod.diagrams.disturbances import Weight
from parapod.diagrams.machine import ControlScenario
from parapod.sims.any_mechanism.sheet import largest_mass
from parapod.sims.any_mechanism.track import MechanismExperiment
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.mechanism.coordinates import PARTS
from parapod.systems.mechanism.statics import motor_forces

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

type Floats = NDArray[np.float64]

# Time at which the mass is put on, in which it comes to bear, and at which the run ends [s].
_AT, _TAKES, _END = 0.5, 0.5, 2.5
# Largest mass that is put on where none is given [kg].
_MOST = 5.0
# Bound of the difference between bodies and statics, by the largest force [%].
_SAME = 1.0


@dataclass
class MechanismLoadScenario(Schema):
    """A mass on the frame of a mechanism.

    Attributes:
        backend: plant: "multibody" (rigid bodies with constraints).
        seed: seed of the errors of the encoders' zeros.
        machine: see `MechanismDesign`; or a file: `!File my_machine.yaml`.
        mass_kg: mass that is put on the frame [kg]; null: as much as the links weigh, 5 kg at
            most.
        place_mm: its place in the frame's link, by that link's axes [mm].
        plant: see `MechanismPlantScenario`.
        control: see `ControlScenario`.
    """

    backend: str = choice(MULTIBODY, (MULTIBODY,))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: MechanismDesign = field(default_factory=MechanismDesign)
    mass_kg: float | None = quantity(None, 0.0, 1e5)
    place_mm: list[float] = quantity([0.0] * 3, -1e5, 1e5, length=3)
    plant: MechanismPlantScenario = field(default_factory=MechanismPlantScenario)
    control: ControlScenario = field(default_factory=ControlScenario)

    @property
    def mass(self) -> float:
        """The mass [kg]."""
        if self.mass_kg is not None:
            return self.mass_kg
        plant = self.machine.built.mechanism.plant
        return min(_MOST, float(plant.CalcTotalMass(plant.CreateDefaultContext())))


class MechanismLoad(MechanismExperiment[MechanismLoadScenario]):
    """Puts the mass on, and takes the forces once it is at rest."""

    schema = MechanismLoadScenario
    backends = (MULTIBODY,)
    signals = ("motors.position", "truth.motor_force", "truth.pose", "truth.loop_error")
    takes = "5 s"

    def machine_scenario(self, scenario: MechanismLoadScenario) -> MechanismScenario:
        """The mechanism, which stands at home."""
        weight = Weight(
            at=_AT,
            duration=_TAKES,
            mass_kg=scenario.mass,
            place_mm=list(scenario.place_mm),
        )
        return MechanismScenario(
            backend=scenario.backend,
            seed=scenario.seed,
            machine=scenario.machine,
            track=TrackScenario(waypoints=[Waypoint(time=_AT + _TAKES)], begin=0.1, end=1.0),
            plant=scenario.plant,
            control=scenario.control,
            disturbances=[weight],
        )

    def check(self, scenario: MechanismLoadScenario) -> None:
        """Refuses a home in which an end of a joint would bear a part of the mass.

        Raises:
            ScenarioError: names the joints.
        """
        super().check(scenario)
        if stopped := scenario.machine.built.stopped:
            key = "machine.home"
            raise ScenarioError(
                f"{key}: joints at an end would bear a part of the mass: {', '.join(stopped)}; "
                "give another one",
                key,
            )

    def duration(self, scenario: MechanismLoadScenario) -> float:
        """Until all is at rest [s]."""
        return _END

    def measure(self, scenario: MechanismLoadScenario, run: Run) -> Iterator[Metric]:
        """Forces of bodies and of statics, and the mass that could be carried."""
        built = scenario.machine.built
        statics = forces_at(scenario, built.q, scenario.mass)
        bodies = run["truth.motor_force"][-1]
        scale = float(np.abs(statics).max()) or 1.0
        yield Metric(
            "force_error_percent",
            100.0 * float(np.abs(bodies - statics).max()) / scale,
            "%",
            _SAME,
            meaning="difference of the motors' forces between bodies and statics, by the largest",
        )
        before = run["truth.pose"][round(_AT / scenario.control.period)]
        sag = run["truth.pose"][-1] - before
        yield Metric(
            "sag_mm",
            1e3 * float(np.linalg.norm(sag[:3])),
            "mm",
            meaning="way of the frame under the mass",
        )
        limits = np.array(built.motors.forces)
        if np.isfinite(limits).any():
            yield Metric(
                "force_share",
                float((np.abs(bodies) / limits).max()),
                bound=1.0,
                meaning="share of its largest force with which a motor holds the mass",
            )
            masses = [mass for _, mass in masses_at_ends(scenario)]
            for name, mass, where in (
                ("home_payload_kg", masses[0], "at home"),
                ("least_payload_kg", min(masses), "at the ends of a tour, where it is least"),
            ):
                if np.isfinite(mass):
                    yield Metric(name, mass, "kg", meaning=f"mass that the motors carry {where}")
        yield realtime_metric(run)

    def note(self, scenario: MechanismLoadScenario, run: Run) -> Iterable[str]:
        """The pose in which the motors are weakest."""
        name, mass = min(masses_at_ends(scenario), key=lambda each: each[1])
        if np.isfinite(mass):
            yield f"weakest {name}: {mass:.4g} kg"

    def draw(self, scenario: MechanismLoadScenario, run: Run) -> Iterator[Figure]:
        """Forces while the mass comes, beside those of statics."""
        yield Figure(
            "mechanism_load",
            "A mass on the frame",
            "Forces of the motors while the mass comes to bear; dotted, those of statics without "
            "it and with it.",
            partial(_draw, scenario, run),
        )


def forces_at(scenario: MechanismLoadScenario, q: Floats, mass: float) -> Floats:
    """Forces of the motors (n) with a mass on the frame, by statics [N, N m].

    Args:
        scenario: its machine and the mass's place are taken.
        q: (q) positions, all loops closed.
        mass: the mass [kg].
    """
    built = scenario.machine.built
    body = built.mechanism.frame(built.frame).body()
    turned = built.mechanism.pose(body.name(), q).rotation().matrix()
    weight = np.array((0.0, 0.0, -GRAVITY * mass))
    moment = np.cross(turned @ (1e-3 * np.array(scenario.place_mm)), weight)
    wrench = {body.name(): np.concatenate((moment, weight))}
    return motor_forces(built.mechanism, q, wrenches=wrench).forces


def masses_at_ends(scenario: MechanismLoadScenario) -> list[tuple[str, float]]:
    """Poses by their names, and the largest mass there [kg]; infinite where nothing limits it."""
    built = scenario.machine.built
    limits = np.array(built.motors.forces)
    masses = []
    for name, q in _ends(built):
        alone = forces_at(scenario, q, 0.0)
        masses.append((name, largest_mass(alone, forces_at(scenario, q, 1.0) - alone, limits)))
    return masses


def _ends(built: BuiltMechanism) -> Iterator[tuple[str, Floats]]:
    """Poses at home, and at the ends of the ways along each coordinate."""
    yield "at home", built.q
    for i, part in enumerate(built.parts):
        for sign, word in ((1.0, "high"), (-1.0, "low")):
            yield f"where {PARTS[part]} is {word}", farthest(built, i, sign)[1]


def _draw(scenario: MechanismLoadScenario, run: Run, canvas: "Canvas") -> None:
    built = scenario.machine.built
    axes: Any = canvas.add_subplot()
    forces = run["truth.motor_force"]
    for i, name in enumerate(built.motors.names):
        axes.plot(run.time[1:], forces[1:, i], label=name)
    axes.set_prop_cycle(None)
    for mass, ends in ((0.0, (0.0, _AT)), (scenario.mass, (_AT + _TAKES, _END))):
        for force in forces_at(scenario, built.q, mass):
            axes.plot(ends, [force, force], linestyle="dotted", color="0.3")
    units = {"N" if unit == "m" else "N m" for unit in built.motors.units}
    axes.set_ylabel(f"force [{' or '.join(sorted(units))}]")
    axes.set_xlabel("time [s]")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
