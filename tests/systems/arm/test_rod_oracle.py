"""The rod in Exudyn, by cables of absolute nodal coordinates: an oracle that is installed by hand.

`pip install exudyn` beside parapod; without it these tests are skipped.
"""

import math

import numpy as np
import pytest

from tests.systems.arm.rod_chain import (
    GRAVITY,
    HORIZONTAL,
    Chain,
    Rod,
    base_wrench_and_tip,
    beam_frequencies,
    beam_sag,
    swing_of,
)

exudyn = pytest.importorskip("exudyn", reason="needs exudyn: pip install exudyn")
beams, items = map(pytest.importorskip, ("exudyn.beams", "exudyn.itemInterface"))

ROD = Rod()
_ELEMENTS = 8
# Stiff enough that the rod gets longer by less than a micrometre [N].
_AXIAL_STIFFNESS = 1e7


class Cable:
    """A rod in the plane of Exudyn's x and y, gravity against y.

    Attributes:
        system: the assembled system.
        tip: number of the tip's node.
    """

    def __init__(self, attitude, swing=None, gravity=GRAVITY):
        """Makes the system.

        Args:
            attitude: turn of the rod from y to x [rad].
            swing: a polynomial of that turn, which the base follows from zero; None: clamped.
            gravity: acceleration of gravity [m/s2].
        """
        self._container = exudyn.SystemContainer()
        system = self.system = self._container.AddSystem()
        direction = np.array((math.sin(attitude), math.cos(attitude), 0.0))
        cable = items.Cable2D(
            massPerLength=ROD.density,
            bendingStiffness=ROD.stiffness[0],
            axialStiffness=_AXIAL_STIFFNESS,
        )
        created = beams.GenerateBeamElementsAlongLine(
            system,
            [0.0, 0.0, 0.0],
            (ROD.length * direction).tolist(),
            _ELEMENTS,
            beamTemplate=cable,
            gravity=[0.0, -gravity, 0.0],
            groundConstraintsStart=[True] * 4 if swing is None else None,
        )
        first, self.tip = created["nodes"][0], created["nodes"][-1]

        def marker(node, coordinate):
            return system.AddMarker(
                items.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate)
            )

        # The tip mass has a node of its own, which goes with that of the cable.
        place = (ROD.length * direction[:2]).tolist()
        mass = system.AddNode(items.NodePoint2D(referenceCoordinates=place))
        system.AddObject(items.MassPoint2D(mass=ROD.tip_mass, nodeNumber=mass))
        load = items.Force(
            markerNumber=system.AddMarker(items.MarkerNodePosition(nodeNumber=mass)),
            loadVector=[0.0, -ROD.tip_mass * gravity, 0.0],
        )
        system.AddLoad(load)
        for coordinate in range(2):
            pair = [marker(self.tip, coordinate), marker(mass, coordinate)]
            system.AddObject(items.CoordinateConstraint(markerNumbers=pair))
        if swing is not None:
            ground = marker(system.AddNode(items.NodePointGround()), 0)
            # Place and slope of the clamp, by those at the beginning.
            slopes = (
                lambda system, t, item, offset: math.sin(swing.value(t).item()),
                lambda system, t, item, offset: math.cos(swing.value(t).item()) - 1.0,
            )
            for coordinate in range(4):
                constraint = items.CoordinateConstraint(
                    markerNumbers=[ground, marker(first, coordinate)],
                    **({"offsetUserFunction": slopes[coordinate - 2]} if coordinate > 1 else {}),
                )
                system.AddObject(constraint)
        system.Assemble()

    def frequencies(self, count):
        """Natural frequencies [rad/s]."""
        squares, _ = self.system.ComputeODE2Eigenvalues()
        return np.sqrt(squares[:count])

    def static_displacement(self):
        """Displacement (2) of the tip at rest [m]."""
        settings = exudyn.SimulationSettings()
        settings.solutionSettings.writeSolutionToFile = False
        settings.staticSolver.newton.relativeTolerance = 1e-10
        self.system.SolveStatic(settings)
        return self.system.GetNodeOutput(self.tip, exudyn.OutputVariableType.Displacement)[:2]

    def positions(self, end, spacing, step):
        """Times (n) [s] and places (n, 2) of the tip [m] during a motion."""
        settings = exudyn.SimulationSettings()
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = spacing
        settings.timeIntegration.endTime = end
        settings.timeIntegration.numberOfSteps = round(end / step)
        settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
        sensor = items.SensorNode(
            nodeNumber=self.tip,
            storeInternal=True,
            writeToFile=False,
            outputVariableType=exudyn.OutputVariableType.Position,
        )
        number = self.system.AddSensor(sensor)
        self.system.Assemble()
        self.system.SolveDynamic(settings)
        samples = self.system.GetSensorStoredData(number)
        return samples[:, 0], samples[:, 1:3]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_exudyn_the_beam_and_the_chain_have_the_same_frequencies():
    shown = Cable(HORIZONTAL, gravity=0.0).frequencies(2)
    np.testing.assert_allclose(shown, beam_frequencies(ROD), rtol=2e-4)
    np.testing.assert_allclose(shown, Chain(gravity=0.0).frequencies()[::2], rtol=4e-4)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_exudyn_the_beam_and_the_chain_have_the_same_sag():
    along, across = Cable(HORIZONTAL).static_displacement()
    assert -across == pytest.approx(beam_sag(ROD), rel=1e-3)
    chain = Chain(attitude=HORIZONTAL)
    chain.set_rest()
    sag, _, shortening = chain.deflection()
    assert -across == pytest.approx(sag, rel=1e-5)
    assert along == pytest.approx(shortening, rel=1e-2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_exudyn_and_the_chain_have_the_same_deflection_in_a_swing():
    """45 deg in 1 s, and 1 s after that."""
    swing = swing_of()
    times, places = Cable(0.0, swing).positions(2.0, 0.02, 5e-4)
    sine, cosine = np.array([(math.sin(a), math.cos(a)) for a in swing.vector_values(times)[0]]).T
    x, y = places.T
    shown = np.stack((x * cosine - y * sine, x * sine + y * cosine - ROD.length), axis=-1)
    chain = base_wrench_and_tip(spacing=0.02, hinges=12)
    expected = chain.tip[np.round(times / 0.02).astype(int)]
    largest = np.abs(chain.tip).max()
    assert len(times) == len(chain.time)
    np.testing.assert_allclose(shown, expected[:, ::2], rtol=0.0, atol=1e-3 * largest)
