"""Pushes on any body of a simulated machine: both engines, statics, rows, and the mouse."""

from functools import partial

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.signal import welch

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.disturbances import Weight, Wind
from parapod.diagrams.machine import find_machine
from parapod.diagrams.pushes import places_of, push_bodies, push_mujoco, pushes_in
from parapod.diagrams.side_by_side import LoopRows
from parapod.diagrams.wiring import add
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.physics.mujoco.model import MujocoModel
from parapod.systems.physics.mujoco.plant import MujocoPlant
from parapod.systems.physics.wind import AIR_DENSITY, gusts, kaimal_density
from tests.sims.lab.test_poser import dragged

MACHINES = ("levelling_platform", "walking_chair", "machining_centre", "terrain_simulator")
# Machines that stand, from the beginning on.
STANDING = {
    "levelling_platform": (
        "plant={leg_model: reduced, time_step: 0.005}",
        "ground={roll_deg: 0, pitch_deg: 0}",
    ),
    "walking_chair": ("begin=60",),
    "machining_centre": ("begin=60",),
    "terrain_simulator": ("begin=60",),
}


def loop_of(name, disturbances, *settings, **options):
    machine = find_machine(name)
    overrides = (*STANDING[name], f"disturbances={disturbances}", *settings)
    return ClosedLoop(machine, load_scenario(machine.scenario, overrides=overrides), **options)


def shown(loop, times):
    """Recordings of the loop at times, by signal (n, size)."""
    simulator, values = loop.simulator(), []
    for time in times:
        simulator.AdvanceTo(time)
        context = loop.station.GetMyContextFromRoot(simulator.get_context())
        names = [port.name for port in loop.machine.truth]
        values.append(
            {name: loop.station.GetOutputPort(name).Eval(context).copy() for name in names}
        )
    return {name: np.array([each[name] for each in values]) for name in values[0]}


@pytest.mark.parametrize("backend", ["multibody", "mujoco"])
def test_feet_of_a_chair_bear_what_pushes_its_body_and_a_leg(backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    on_body = "!Push {at: 0.4, duration: 1.6, force_N: [0, 0, -200], place_mm: [100, 50, 200]}"
    on_leg = "!Push {at: 0.4, duration: 1.6, body: leg_1_ups_2_rod, force_N: [0, 0, -40]}"
    loop = loop_of("walking_chair", f"[{on_body}, {on_leg}]", f"backend={backend}")
    force = shown(loop, (0.4, 1.2, 2.2))["truth.contact_force"].reshape(3, -1).sum(axis=1)
    assert force[1] - force[0] == pytest.approx(240.0, rel=2e-3)
    assert force[2] == pytest.approx(force[0], rel=1e-3)


@pytest.mark.parametrize("backend", ["kinematic", "multibody", "mujoco"])
def test_a_platform_bears_a_mass_until_it_is_taken_off(backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    mass = "[!Weight {at: 0.2, duration: 0.2, until: 0.8, mass_kg: 5, place_mm: [50, 0, 0]}]"
    loop = loop_of("levelling_platform", mass, f"backend={backend}")
    force = shown(loop, (0.2, 0.7, 1.4))["truth.contact_force"].sum(axis=1)
    np.testing.assert_allclose(np.diff(force), (5.0 * GRAVITY, -5.0 * GRAVITY), rtol=2e-3)


@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_a_mass_that_is_put_on_is_a_body_welded_there(engine):
    """Two pendulums in a row, of which the last one bears a mass beside its axis."""
    if engine == "mujoco":
        pytest.importorskip("mujoco")
    at, mass = (0.1, -0.05, -0.3), 2.5
    states = []
    for welded in (True, False):
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        link = plant.world_body()
        for i in range(2):
            inertia = SpatialInertia.SolidBoxWithMass(1.0 + i, 0.1, 0.2, 0.4)
            child = plant.AddRigidBody(f"link_{i}", inertia)
            X_PF = RigidTransform((0.0, 0.0, -0.4))
            end = plant.AddFrame(FixedOffsetFrame(f"end_{i}", link.body_frame(), X_PF))
            axis = np.array((i, 1.0 - i, 0.0))
            plant.AddJoint(RevoluteJoint(f"joint_{i}", end, child.body_frame(), axis))
            link = child
        if welded:
            point = SpatialInertia.SolidSphereWithMass(mass, 1e-6)
            plant.WeldFrames(
                link.body_frame(),
                plant.AddRigidBody("point", point).body_frame(),
                RigidTransform(at),
            )
        plant.Finalize()
        x_mm, y_mm, z_mm = (1e3 * x for x in at)
        weight = Weight(at=0.0, duration=1e-3, mass_kg=mass, place_mm=[x_mm, y_mm, z_mm])
        pushed = pushes_in(builder, plant, [] if welded else [weight], link)
        if engine == "drake":
            weigh = push_bodies(builder, plant, scene_graph, pushed, None)
            bodies = plant
        else:
            model = MujocoModel(plant, scene_graph, ())
            bodies = add(builder, MujocoPlant(model, [], pushed=places_of(pushed)))
            push_mujoco(builder, bodies, pushed, None)
            weigh = None
        diagram = builder.Build()
        simulator = Simulator(diagram)
        context = simulator.get_mutable_context()
        start = plant.CreateDefaultContext()
        plant.SetPositions(start, (0.4, 0.3))
        if engine == "drake":
            plant.SetPositions(plant.GetMyMutableContextFromRoot(context), (0.4, 0.3))
        else:
            inner = bodies.GetMyMutableContextFromRoot(context)
            bodies.put(inner, start)
            bodies.GetInputPort("desired_state").FixValue(inner, np.zeros(0))
        # From the time on at which the whole mass is there.
        context.SetTime(2e-3)
        if weigh is not None:
            simulator.set_monitor(lambda root, weigh=weigh: weigh(root))
        simulator.AdvanceTo(1.0)
        port = bodies.GetOutputPort("state")
        states.append(port.Eval(bodies.GetMyContextFromRoot(context)).copy())
    np.testing.assert_allclose(*states, rtol=1e-6)
    assert np.abs(states[0]).max() > 0.1


def test_a_cable_holds_a_chair_until_it_breaks():
    cable = "[!Cable {at: 1.6, body: leg_2_foot, pull_N: [0, 0, 30]}]"
    force = shown(loop_of("walking_chair", cable), (1e-3, 1.5, 1.6, 2.2))["truth.contact_force"]
    pulled = np.diff(force.sum(axis=1))
    np.testing.assert_allclose(pulled[1:], (0.0, 30.0), atol=0.3)


def test_wind_blows_on_a_chair_for_its_time():
    wind = Wind(at=0.2, duration=2.0, speed_m_s=20.0, turbulence=0.0, area_m2=1.0)
    course = wind.course()
    pressure = 0.5 * AIR_DENSITY * 20.0**2
    assert wind.largest == pytest.approx(pressure)
    values = [course.value(time)[3, 0] for time in (0.1, 0.7, 1.2, 2.3, 9e6)]
    np.testing.assert_allclose(values, np.array((0.0, 0.5, 1.0, 0.0, 0.0)) * pressure, atol=1e-9)
    # It turns the chair about the feet on the lee side.
    force = shown(
        loop_of(
            "walking_chair",
            "[!Wind {at: 0.2, duration: 2.0, speed_m_s: 20, turbulence: 0, area_m2: 1}]",
        ),
        (0.2, 1.2),
    )["truth.contact_force"].reshape(2, 4, -1)
    change = np.diff(force.sum(axis=2), axis=0)[0]
    right, left = change[[1, 2]].sum(), change[[0, 3]].sum()
    assert right > 1.0
    assert left == pytest.approx(-right, abs=0.5)


def test_pushes_are_recorded_with_their_units():
    forces = (
        "!Push {at: 0, duration: 0.4, force_N: [30, 0, -60], moment_Nm: [0, 4, 0]}",
        "!Weight {at: 0, duration: 0.1, mass_kg: 2}",
    )
    loop = loop_of("levelling_platform", f"[{', '.join(forces)}]", "backend=kinematic")
    simulator = loop.simulator()
    simulator.AdvanceTo(0.2)
    recording = loop.recording(simulator.get_context())
    last = {name: recording.signals[f"truth.push_{name}"][-1] for name in ("force", "moment")}
    np.testing.assert_allclose(last["force"], (30.0, 0.0, -60.0, 0.0, 0.0, -2.0 * GRAVITY))
    np.testing.assert_allclose(last["moment"], (0.0, 4.0, 0.0, 0.0, 0.0, 0.0), atol=1e-12)
    assert recording.units["truth.push_force"] == "N"
    assert loop.machine.element_name("truth.push_force", 3) == "weight 2 x"


def test_gusts_have_the_spectrum_of_kaimal():
    count, period, speed, deviation, length = 2**15, 0.05, 10.0, 1.8, 8.5
    for seed in (0, 1):
        samples = gusts(count, period, speed, deviation, length, seed)
        frequency, density = welch(samples, 1.0 / period, nperseg=1024)
        expected = kaimal_density(frequency[1:], speed, deviation, length)
        for band in np.array_split(np.arange(4, expected.size - 40), 8):
            assert density[1:][band].mean() == pytest.approx(expected[band].mean(), rel=0.1)
    np.testing.assert_array_equal(samples, gusts(count, period, speed, deviation, length, 1))
    # The integral of the density is the variance.
    frequency = np.geomspace(1e-6, 1e6, 200_000)
    variance = np.trapezoid(kaimal_density(frequency, speed, deviation, length), frequency)
    assert variance == pytest.approx(deviation**2, rel=1e-3)


@pytest.mark.parametrize("backend", ["multibody", "mujoco"])
def test_a_place_beside_the_centre_turns_a_chair_as_a_moment_does(backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    at_place, by_moment, centred = (
        shown(
            loop_of(
                "walking_chair",
                f"[!Push {{at: 0.3, duration: 1.4, {push}}}]",
                f"backend={backend}",
            ),
            (1.0,),
        )["truth.contact_force"]
        for push in (
            "force_N: [0, 0, -100], place_mm: [200, 0, 0]",
            "force_N: [0, 0, -100], moment_Nm: [0, 20, 0]",
            "force_N: [0, 0, -100]",
        )
    )
    np.testing.assert_allclose(at_place, by_moment, rtol=1e-3, atol=0.05)
    assert np.abs(at_place - centred).max() > 3.0


def test_a_body_of_a_platform_is_pushed_as_the_platform_is():
    push = "at: 0.3, duration: 0.6, force_N: [30, 0, -60], place_mm: [50, 20, 0]"
    ways = [
        shown(loop_of("levelling_platform", f"[!Push {{{push}{body}}}]"), (0.4, 0.6, 1.0))
        for body in ("", ", body: base")
    ]
    for signal in ("truth.posture", "truth.extension", "truth.foot_height"):
        np.testing.assert_allclose(ways[0][signal], ways[1][signal], atol=2e-5)
    force = [way["truth.contact_force"].sum(axis=1) for way in ways]
    # One of them is held for a step of the plant.
    np.testing.assert_allclose(*force, atol=3.0)


def test_both_engines_push_a_link_of_a_leg_alike():
    pytest.importorskip("mujoco")
    push = "[!Push {at: 0.3, duration: 1.0, body: leg_2_roller, force_N: [0, 0, -50]}]"
    ways = [
        shown(loop_of("levelling_platform", push, f"backend={backend}"), (0.3, 0.8))
        for backend in ("multibody", "mujoco")
    ]
    rises = [np.diff(way["truth.contact_force"].sum(axis=1)) for way in ways]
    np.testing.assert_allclose(rises, 50.0, atol=0.2)


def test_legs_of_a_centre_take_the_work_of_a_push():
    push = "[!Push {at: 0.1, duration: 0.8, force_N: [0, 150, 0]}]"
    loop = loop_of("machining_centre", push, "process.thrust_N=0")
    at_rest, pushed = (shown(loop_of("machining_centre", p), (0.5,)) for p in ("[]", push))
    change = pushed["truth.leg_force"][0] - at_rest["truth.leg_force"][0]
    geometry = loop.scenario.machine.geometry
    pose, feet = loop.scenario.plan.beginning
    step = np.zeros_like(pose)
    step[1] = 1e-6
    ways = [np.ravel(leg_lengths(geometry, pose + s * step, feet)) for s in (0.5, -0.5)]
    work = change @ (ways[0] - ways[1]) / 1e-6
    assert abs(work) == pytest.approx(150.0, rel=0.02)


def test_sliders_of_a_bench_take_the_work_of_a_push():
    """Along the rail the plate moves as all sliders do."""
    push = "[!Push {at: 0.1, duration: 0.8, force_N: [80, 0, 0]}]"
    at_rest, pushed = (shown(loop_of("terrain_simulator", p), (0.5,)) for p in ("[]", push))
    change = pushed["truth.slider_force"][0] - at_rest["truth.slider_force"][0]
    assert abs(change.sum()) == pytest.approx(80.0, rel=0.03)


def test_rows_of_mujoco_are_pushed_as_its_runs():
    pytest.importorskip("mujoco")
    push = (
        "[!Push {at: 0.05, duration: 0.1, body: leg_3_foot, force_N: [5, -3, 20]}, !Push {at: 0}, "
        "!Weight {at: 0.02, duration: 0.1, mass_kg: 8, place_mm: [0, 100, 300]}, "
        "!Subsidence {at: 0.03, duration: 0.1, foot: 2, depth_mm: 3}]"
    )
    loop = loop_of("walking_chair", push, "backend=mujoco")
    rows = LoopRows(loop, [loop.scenario] * 2)
    rows.advance_to(0.2)
    assert not rows.errors
    simulator = loop.simulator()
    simulator.AdvanceTo(0.2)
    expected = loop.recording(simulator.get_context())
    for row in range(2):
        for name, samples in rows.recording(row).items():
            np.testing.assert_array_equal(samples, expected[name], err_msg=name)


@pytest.mark.parametrize(
    ("name", "backend", "path"),
    [
        ("levelling_platform", "kinematic", "base"),
        ("levelling_platform", "multibody", "base"),
        ("walking_chair", "multibody", "bodies"),
        ("walking_chair", "mujoco", "bodies"),
    ],
)
def test_an_arrow_is_there_while_a_force_acts(name, backend, path):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    meshcat = Meshcat()
    push = "[!Push {at: 0.1, duration: 0.2, force_N: [20, 0, 0]}]"
    simulator = loop_of(name, push, f"backend={backend}", meshcat=meshcat).simulator()
    shown_at = []
    for time in (0.05, 0.2, 0.4):
        simulator.AdvanceTo(time)
        # MessagePack ends with true as 0xc3.
        packed = meshcat._GetPackedProperty(f"/pushes/{path}/0", "visible")
        shown_at.append(packed.endswith(b"\xc3"))
    assert shown_at == [False, True, False]
    assert meshcat.HasPath(f"/pushes/{path}/0/arrow/head")


@pytest.mark.parametrize("name", MACHINES)
def test_the_mouse_pushes_bodies_and_the_loop_answers(name):
    meshcat = Meshcat()
    loop = loop_of(name, "[]", meshcat=meshcat)
    plant = loop.station.GetSubsystemByName("plant")
    body = {"levelling_platform": "base", "walking_chair": "body", "terrain_simulator": "plate"}
    pulled = plant.GetBodyByName(body.get(name, "platform"))
    model = plant.GetModelInstanceName(pulled.model_instance())
    simulator = loop.simulator()
    simulator.AdvanceTo(0.05)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    place = plant.EvalBodyPoseInWorld(context, pulled).translation()
    drag = partial(dragged, f"/any/{model}/{pulled.name()}", place)
    meshcat._InjectWebsocketMessage(drag(place + np.array((0.05, 0.0, 0.0))))
    port = plant.get_applied_spatial_force_input_port()
    simulator.AdvanceTo(0.1)
    pull = sum(f.F_Bq_W.translational() for f in port.Eval(context))
    assert pull[0] > 1.0
    meshcat._InjectWebsocketMessage(dragged("", (), ()))
    simulator.AdvanceTo(0.11)
    np.testing.assert_array_equal(sum(f.F_Bq_W.translational() for f in port.Eval(context)), 0.0)


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        (
            "walking_chair",
            ("disturbances=[!Push {body: leg_1_fot}]",),
            r"disturbances\.0\.body: the model has no body 'leg_1_fot' "
            r"\(did you mean leg_1_foot\?\)",
        ),
        (
            "walking_chair",
            ("backend=kinematic", "disturbances=[!Push {}]"),
            "disturbances must be empty with the backend 'kinematic': they act with multibody "
            "or mujoco",
        ),
        (
            "terrain_simulator",
            ("disturbances=[!Push {}, !Subsidence {}]",),
            r"disturbances\.1: !Subsidence does not act on this machine; admissible: !Push, !Wei",
        ),
        (
            "walking_chair",
            ("disturbances=[!Weight {at: 3, until: 3.5}]",),
            r"disturbances\.0\.until = 3\.5 s must be 4 s or later",
        ),
        (
            "levelling_platform",
            ("backend=kinematic", "disturbances=[!Push {body: base}]"),
            r"disturbances\.0\.body must be empty with the backend 'kinematic'",
        ),
        (
            "walking_chair",
            ("disturbances=[!Weight {mass_kg: -80}]",),
            r"disturbances: body, of \S+ kg, cannot lose 80 kg there",
        ),
        (
            "walking_chair",
            ("disturbances=[!Weight {body: passenger}]",),
            r"disturbances\.0\.body: the mass of passenger is that of another key; admissible: "
            "another body, such as body",
        ),
        (
            "terrain_simulator",
            ("disturbances=[!Push {force_N: [1, 2]}]",),
            r"disturbances\.0\.force_N must be a list of 3 numbers",
        ),
    ],
)
def test_pushes_that_do_not_fit_are_refused(name, settings, message):
    with pytest.raises(ScenarioError, match=message):
        loop_of(name, *[s.removeprefix("disturbances=") for s in settings[-1:]], *settings[:-1])
