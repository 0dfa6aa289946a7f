"""Measure which poses the frame of a mechanism reaches, as far as its motors and loops let it.

A grid of poses is flooded from home: a cell counts where the frame gets to its middle from a
neighbour's pose, within all limits and away from singular positions. So all of it is reached
without taking the mechanism apart. The error is half the cells at its border.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.any_mechanism.design import BuiltMechanism, MechanismDesign
from parapod.diagrams.any_mechanism.machine import MECHANISM
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.any_mechanism.track import farthest
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.progress import waiting
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.mechanism.coordinates import PARTS, part_unit
from parapod.systems.mechanism.reach import Reach, reach

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Way of the first grid beyond what is reached along each coordinate alone [-], by how much it
# grows where that is not enough, and how often.
_BEYOND, _GROWS, _TRIES = 1.3, 1.5, 6
_MOST = 3  # coordinates of a grid
# Poses whose loops are looked at, and the bound of their gaps, by the mechanism's size [-].
_LOOKED_AT, _CLOSED = 500, 1e-8


@dataclass
class MechanismWorkspaceScenario(Schema):
    """Poses of a mechanism's frame.

    Attributes:
        backend: method: "exact", loops closed numerically.
        seed: seed, which changes nothing: nothing is random.
        machine: see `MechanismDesign`; or a file: `!File my_machine.yaml`.
        coordinates: parts of the pose along which it is looked for, three at most; others stay as
            they are at home; empty: the first three in which the frame is led.
        cells: number of cells along each.
        least_held: least distance from a singular position, by that at home [-].
        asked_percent: largest error of the workspace's size [%].
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: MechanismDesign = field(default_factory=MechanismDesign)
    coordinates: list[str] = field(default_factory=list)
    cells: int = quantity(32, 2, 200)
    least_held: float = quantity(0.1, 0.0, 10.0)
    asked_percent: float = quantity(20.0, 0.0, 100.0)

    def parts(self) -> tuple[int, ...]:
        """Coordinates of the grid, by their places in `PARTS`.

        Raises:
            ScenarioError: coordinates in which the frame is not led, or too many.
        """
        parts = self.machine.built.parts
        if not self.coordinates:
            return parts[:_MOST]
        names, key = [PARTS[part] for part in parts], "coordinates"
        for name in self.coordinates:
            if name not in names:
                raise ScenarioError(f"{key}: '{name}' is not one of {', '.join(names)}", key)
        if len(set(self.coordinates)) > _MOST:
            raise ScenarioError(f"{key} must be {_MOST} at most, not {len(self.coordinates)}", key)
        return tuple(sorted({PARTS.index(name) for name in self.coordinates}))


class MechanismWorkspace(Experiment[MechanismWorkspaceScenario, Reach]):
    """Floods a grid of poses."""

    schema = MechanismWorkspaceScenario
    machine = MECHANISM
    backends = ("exact",)
    takes = "10 s"

    def check(self, scenario: MechanismWorkspaceScenario) -> None:
        """Refuses coordinates in which the frame is not led."""
        scenario.parts()

    def machine_scenario(self, scenario: MechanismWorkspaceScenario) -> MechanismScenario:
        """The mechanism at home."""
        return MechanismScenario(machine=scenario.machine)

    def run(self, scenario: MechanismWorkspaceScenario, runner: Runner) -> Reach:
        """Floods a grid that is large enough.

        Raises:
            ParapodError: no pose around home is reached.
        """
        built, parts = scenario.machine.built, scenario.parts()
        home = built.mechanism.dexterity(built.q, built.frame).held
        ranges = dict(_ranges(built, parts))
        fixed = {
            part: float(value)
            for part, value in zip(built.parts, built.home, strict=True)
            if part not in parts
        }
        with waiting(runner.console, self.name):
            for _ in range(_TRIES):
                grid = {part: (*ends, scenario.cells) for part, ends in ranges.items()}
                least = scenario.least_held * home
                flooded = reach(built.mechanism, built.frame, grid, fixed, built.q, least)
                if not flooded.cut_off:
                    break
                ranges = {part: _wider(part, ends) for part, ends in ranges.items()}
        if not flooded.volume:
            stopped = f"; at an end there: {', '.join(built.stopped)}" if built.stopped else ""
            raise ParapodError(
                f"{built.frame} reaches no pose around its home{stopped}; give another home"
            )
        return flooded

    def measure(self, scenario: MechanismWorkspaceScenario, data: Reach) -> Iterator[Metric]:
        """Size and extents of the workspace, and gaps of its poses."""
        built = scenario.machine.built
        unit, factor = _unit(data.parts)
        yield Metric(
            "workspace", factor * data.volume, unit, meaning="volume of the poses that are reached"
        )
        yield Metric(
            "workspace_error_percent",
            100.0 * data.error / data.volume,
            "%",
            scenario.asked_percent,
            meaning="error of that volume at most, half the cells at its border",
        )
        for axis, part in enumerate(data.parts):
            name, (each, factor) = PARTS[part], part_unit(part)
            cells = np.flatnonzero(
                data.is_reached.any(axis=tuple(i for i in range(len(data.parts)) if i != axis))
            )
            width = data.axes[axis][1] - data.axes[axis][0]
            yield Metric(
                f"{name}_extent_{each}",
                factor * float(width * (cells[-1] - cells[0] + 1)),
                each,
                meaning=f"extent of them along {name}",
            )
        yield Metric(
            "cut_off",
            float(data.cut_off),
            bound=0.0,
            meaning="share of grids that do not hold the whole workspace",
        )
        gap = _largest_gap(built, data)
        yield Metric(
            "loop_error_um",
            1e6 * gap,
            "um",
            1e6 * _CLOSED * built.mechanism.size,
            meaning="largest gap in a closed loop of these poses",
        )
        held = [built.mechanism.dexterity(q, built.frame).held for q in _some(data)]
        home = built.mechanism.dexterity(built.q, built.frame).held
        yield Metric(
            "least_held",
            min(held) / home,
            at_least=scenario.least_held,
            meaning="smallest distance from a singular position, by that at home",
        )

    def details(self, scenario: MechanismWorkspaceScenario, data: Reach) -> Mapping[str, Any]:
        """The grid's axes, and how many cells are reached."""
        axes = {
            PARTS[part]: axis.tolist() for part, axis in zip(data.parts, data.axes, strict=True)
        }
        return {"axes": axes, "cells_reached": int(data.is_reached.sum())}

    def draw(self, scenario: MechanismWorkspaceScenario, data: Reach) -> Iterable[Figure]:
        """The workspace, from the side of each pair of coordinates."""
        pairs = list(combinations(range(len(data.parts)), 2))
        if not pairs:
            return
        yield Figure(
            "mechanism_workspace",
            "Poses that a frame reaches",
            "Extent of the workspace across each pair of coordinates: the darker, the farther it "
            "goes along the third. White is not reached.",
            partial(_draw, scenario.machine.built, data, pairs),
            (3.4 * len(pairs), 3.2),
        )


def _ranges(
    built: BuiltMechanism, parts: tuple[int, ...]
) -> Iterator[tuple[int, tuple[float, float]]]:
    """Ends of the first grid along each coordinate [m, rad]."""
    for i, part in enumerate(built.parts):
        if part in parts:
            ways = [_BEYOND * farthest(built, i, sign)[0] for sign in (-1.0, 1.0)]
            yield part, (float(built.home[i] + ways[0]), float(built.home[i] + ways[1]))


def _wider(part: int, ends: tuple[float, float]) -> tuple[float, float]:
    """Ends of a larger grid; angles go round at most."""
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * _GROWS * (ends[1] - ends[0])
    if part >= 3:
        half = min(half, math.pi)
    return middle - half, middle + half


def _unit(parts: tuple[int, ...]) -> tuple[str, float]:
    """Unit of a volume for people, and its factor."""
    lengths = sum(part < 3 for part in parts)
    names = [
        name if power == 1 else f"{name}^{power}"
        for name, power in (("m", lengths), ("deg", len(parts) - lengths))
        if power
    ]
    return " ".join(names), math.degrees(1.0) ** (len(parts) - lengths)


def _some(data: Reach) -> Any:
    """Positions of some cells, spread over all."""
    return data.positions[:: max(1, len(data.positions) // _LOOKED_AT)]


def _largest_gap(built: BuiltMechanism, data: Reach) -> float:
    gaps = (gap.length for q in _some(data) for gap in built.mechanism.gaps(q))
    return max(gaps, default=0.0)


def _draw(
    built: BuiltMechanism, data: Reach, pairs: list[tuple[int, int]], canvas: "Canvas"
) -> None:
    panels: Any = canvas.subplots(1, len(pairs), squeeze=False)[0]
    for panel, (across, up) in zip(panels, pairs, strict=True):
        others = tuple(i for i in range(len(data.parts)) if i not in (across, up))
        depth = data.is_reached.sum(axis=others).T.astype(float)
        depth[depth == 0.0] = np.nan
        units = [part_unit(data.parts[i]) for i in (across, up)]
        edges = [
            factor * np.append(axis - 0.5 * step, axis[-1] + 0.5 * step)
            for axis, step, (_, factor) in (
                (data.axes[i], data.axes[i][1] - data.axes[i][0], unit)
                for i, unit in zip((across, up), units, strict=True)
            )
        ]
        panel.pcolormesh(*edges, depth, cmap="Blues", vmin=0.0, rasterized=True)
        home = [
            factor * built.home[built.parts.index(data.parts[i])]
            for i, (_, factor) in zip((across, up), units, strict=True)
        ]
        panel.plot(*home, "+", color="0.2")
        panel.set_xlabel(f"{PARTS[data.parts[across]]} [{units[0][0]}]")
        panel.set_ylabel(f"{PARTS[data.parts[up]]} [{units[1][0]}]")
