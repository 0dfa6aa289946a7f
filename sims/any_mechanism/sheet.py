"""Data sheet of a mechanism of a model file: its freedoms, ways, speeds, forces."""

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.any_mechanism.design import BuiltMechanism
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.any_mechanism.track import farthest
from parapod.sims.sheet.sheet import Demonstration, Entry, Sheet, Table, entry
from parapod.systems.core.physics import GRAVITY
from parapod.systems.mechanism.coordinates import PARTS, joint_unit, part_unit
from parapod.systems.mechanism.mobility import Dexterity
from parapod.systems.mechanism.statics import motor_forces

# Force of a motor by a mass on the frame below which it bears nothing of it [N/kg, N m/kg].
_NOTHING = 1e-6

type Floats = NDArray[np.float64]


def _ways() -> Iterator[tuple[str, Any]]:
    """Entries of the ways along all coordinates."""
    for part, name in enumerate(PARTS):
        unit, factor = part_unit(part)

        def way(sheet: Any, part: int = part, factor: float = factor) -> float:
            return factor * float(sheet.ways[part])

        way.__doc__ = f"Way of the frame along {name} through home; 0 where it is not led"
        yield f"{name}_way_{unit}", Entry(way, "workspace", unit)


class MechanismSheet(Sheet[MechanismScenario, None, None]):
    """Sheet of a mechanism at home, and along each coordinate of its frame."""

    highlights = ("freedoms", "mass_kg", "payload_kg", "held_at_home")

    @cached_property
    def built(self) -> BuiltMechanism:
        """The mechanism."""
        return self.scenario.machine.built

    @cached_property
    def ways(self) -> Floats:
        """Ways of the frame along its coordinates through home (6) [m, rad]; 0: not led."""
        ways = np.zeros(len(PARTS))
        for i, part in enumerate(self.built.parts):
            ways[part] = sum(abs(farthest(self.built, i, sign)[0]) for sign in (1.0, -1.0))
        return ways

    @cached_property
    def _near(self) -> Dexterity:
        return self.built.mechanism.dexterity(self.built.q, self.built.frame)

    @entry("mechanism")
    def freedoms(self) -> float:
        """Degrees of freedom of the mechanism."""
        return self.built.mechanism.mobility.freedoms

    @entry("mechanism")
    def motors(self) -> float:
        """Number of its motors."""
        return len(self.built.mechanism.motors)

    @entry("mechanism")
    def loops(self) -> float:
        """Number of its closed loops."""
        return len(self.built.mechanism.loops)

    @entry("mechanism")
    def redundant_equations(self) -> float:
        """Number of equations of its loops that follow from all others."""
        of = self.built.mechanism.mobility
        return of.equations - of.rank

    @entry("mechanism", "kg")
    def mass_kg(self) -> float:
        """Mass of all its links."""
        plant = self.built.mechanism.plant
        return plant.CalcTotalMass(plant.CreateDefaultContext())

    @entry("mechanism", "mm")
    def size_mm(self) -> float:
        """Length by which lengths and angles are compared."""
        return 1e3 * self.built.mechanism.size

    locals().update(_ways())

    @entry("dexterity")
    def held_at_home(self) -> float:
        """Ratio of singular values with which the motors hold it at home; 0: singular."""
        return self._near.held

    @entry("dexterity")
    def moved_at_home(self) -> float:
        """Ratio of singular values with which the motors move the frame at home; 0: singular."""
        return self._near.moved

    @entry("velocity", "mm/s")
    def slowest_mm_s(self) -> float:
        """Least speed of the frame at home along a coordinate; 0 where its place is not led."""
        rates = self.built.speeds(1.0) * len(self.built.parts)
        lengths = [rate for part, rate in zip(self.built.parts, rates, strict=True) if part < 3]
        return 1e3 * float(min(lengths, default=0.0))

    @cached_property
    def _loads(self) -> tuple[Floats, Floats, Floats]:
        """Forces of the motors at home alone, those of a kilogram on the frame, and the limits."""
        of, frame = self.built.mechanism, self.built.frame
        alone = motor_forces(of, self.built.q).forces
        weight = {frame: (0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)}
        loaded = motor_forces(of, self.built.q, wrenches=weight).forces
        return alone, loaded - alone, np.array(self.built.motors.forces)

    @entry("forces")
    def weight_share(self) -> float:
        """Largest share of its limit with which a motor holds the weight; 0 without limits."""
        alone, _, limits = self._loads
        return float((np.abs(alone) / limits).max())

    @entry("forces", "kg")
    def payload_kg(self) -> float:
        """Largest mass that the frame carries at home; 0 where no motor has a limit."""
        return largest_mass(*self._loads)

    @entry("stiffness", "mm")
    def deflection_mm(self) -> float:
        """Way by which the wrench pushes the frame at home, motors alone giving way."""
        return 1e3 * float(np.linalg.norm(self._deflection[3:]))

    @entry("stiffness", "deg")
    def turn_deg(self) -> float:
        """Angle by which the wrench turns the frame at home, motors alone giving way."""
        return round(float(np.degrees(np.linalg.norm(self._deflection[:3]))), 9)

    @cached_property
    def _deflection(self) -> Floats:
        moves = self.built.mechanism.frame_jacobian(self.built.frame, self.built.q)
        force, moment = self.wrench[:3], self.wrench[3:]
        pushed = moves.T @ np.array((*moment, *force)) / self.scenario.machine.stiffnesses
        return np.asarray(moves @ pushed)

    def demonstrations(self) -> Iterator[Demonstration]:
        """A tour of the coordinates."""
        yield Demonstration("held_at_home", {"track.share": 0.9}, "a tour, nine tenths of the way")

    def tables(self) -> Iterator[Table]:
        """The motors."""
        of, rows = self.built.mechanism, []
        motors = self.built.motors
        for i, joint in enumerate(of.motors):
            unit, factor = joint_unit(of, joint)
            per = "N" if unit == "mm" else "N m"
            numbers = motors.lower[i], motors.upper[i], motors.velocities[i]
            low, high, speed = (f"{factor * number:.5g}" for number in numbers)
            force = motors.forces[i]
            limit = f"{force:.5g} {per}" if np.isfinite(force) else "none"
            ends = f"{low} {unit}", f"{high} {unit}"
            rows.append((motors.names[i], *ends, f"{speed} {unit}/s", limit))
        yield Table("Motors", ("motor", "from", "to", "speed", "force"), rows)


def largest_mass(alone: Floats, per_kg: Floats, limits: Floats) -> float:
    """Largest mass with which no motor exceeds its limit [kg]; infinite where none limits it.

    Args:
        alone: forces of the motors without it (n) [N, N m].
        per_kg: forces by mass (n).
        limits: largest forces (n).
    """
    bears = np.abs(per_kg) > _NOTHING
    ends = np.where(per_kg > 0.0, limits - alone, -limits - alone)
    return max(0.0, float((ends[bears] / per_kg[bears]).min(initial=np.inf)))
