"""Public problems with closed loops: their exact motions, and the errors of both engines."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def benchmarks():
    """The modules of the problems and of the engines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        from benchmarks import __main__, closed_loops, linkage, references

        yield references, closed_loops, linkage, __main__
        for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
            del sys.modules[name]


@pytest.fixture(scope="module")
def references(benchmarks):
    return benchmarks[0]


@pytest.fixture(scope="module")
def closed_loops(benchmarks):
    return benchmarks[1]


@pytest.fixture(scope="module")
def brief(references):
    """Bricard's six-bar for one second, in which P3 moves a metre."""
    return replace(references.BRICARD, end=1.0, samples=10)


def test_exact_motion_reproduces_the_published_digits_of_andrews(references):
    problem = references.ANDREWS
    exact, names = problem.exact, [link.name for link in problem.linkage.links]
    begin = exact.accelerations(*exact.start)
    np.testing.assert_allclose(begin[:2], references.ANDREWS_ACCELERATIONS, rtol=1e-10)
    assert np.abs(begin[2:]).max() < 1e-8
    motion = problem.exact_motion
    angles = [references.ANDREWS_END[name] for name in names]
    rates = [references.ANDREWS_RATES[name] for name in names]
    # Nine digits of the rod that has turned 2.5 times, and as many of the others.
    np.testing.assert_allclose(motion.q[-1], angles, rtol=1e-9)
    np.testing.assert_allclose(motion.v[-1], rates, rtol=1e-7)
    # What the motor spends is in the motion and in the spring.
    assert np.abs(problem.energies(motion)).max() < 1e-10
    assert max(map(exact.gap, motion.q)) < 1e-14


def test_exact_motion_with_a_redundant_constraint_converges_and_conserves_energy(references):
    problem = references.BRICARD
    motion = problem.exact_motion
    rough = problem.exact.integrate(problem.times, 1e-10)
    assert np.abs(motion.q - rough.q).max() < 1e-9
    assert np.abs(problem.energies(motion)).max() < 1e-9
    assert max(map(problem.exact.gap, motion.q)) < 1e-14


def test_a_block_that_slides_on_a_link_that_turns_conserves_energy(benchmarks):
    """A quick-return: Coriolis' force acts on what slides along what turns."""
    linkage = benchmarks[2]
    normal, along = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    body = (1.0, (0.1, 0.05, 0.0), (0.01, 0.01, 0.02))
    arm = linkage.Link("arm", "", (0.0, 0.0, 0.0), normal, *body, position=0.3)
    block = linkage.Link("block", "arm", (0.0, 0.0, 0.0), along, *body, slides=True, position=0.3)
    crank = linkage.Link("crank", "", (0.3, 0.0, 0.0), normal, *body, position=1.5, rate=20.0)
    pin = (linkage.Point("block", (0.0, 0.0, 0.0)), linkage.Point("crank", (0.1, 0.0, 0.0)))
    gravity = (0.0, -9.81, 0.0)
    exact = linkage.ExactMotion(
        linkage.Linkage("quick-return", (arm, block, crank), (pin,), gravity=gravity)
    )
    motion = exact.integrate(np.linspace(0.0, 0.5, 6)[1:])
    energies = [exact.energy(q, v) for q, v in zip(motion.q, motion.v, strict=True)]
    # It turns, and the block slides to and fro.
    assert motion.q[-1, 2] > 6.0
    np.testing.assert_allclose(energies, exact.energy(*exact.start), rtol=1e-10)


@pytest.mark.parametrize("number", range(4))
def test_masses_forces_and_energies_of_the_open_tree_are_those_of_drakes_plant(references, number):
    problem = references.PROBLEMS[number]
    exact, links = problem.exact, problem.linkage.links
    # Drake knows neither what motors do nor springs that are drives.
    torques = np.array([link.torque for link in links])
    stiffness = np.array([link.stiffness for link in links])
    plant, random = MultibodyPlant(0.0), np.random.default_rng(number)
    problem.linkage.place(plant)
    context, forces = plant.CreateDefaultContext(), MultibodyForces(plant)
    energies = []
    for _ in range(3):
        q, v = random.uniform(-1.0, 1.0, (2, plant.num_positions()))
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        mass, force = exact.open_tree(q, v)
        np.testing.assert_allclose(mass, plant.CalcMassMatrix(context), rtol=1e-9, atol=1e-12)
        plant.CalcForceElementsContribution(context, forces)
        drake = -plant.CalcInverseDynamics(context, np.zeros_like(v), forces)
        drake += torques - stiffness * q
        np.testing.assert_allclose(force, drake, rtol=1e-9, atol=1e-12)
        drake = plant.EvalPotentialEnergy(context) + plant.EvalKineticEnergy(context)
        drake += 0.5 * stiffness @ q**2 - torques @ q
        energies.append((exact.energy(q, v), drake))
    own, theirs = np.array(energies).T
    np.testing.assert_allclose(own - own[0], theirs - theirs[0], rtol=1e-9, atol=1e-12)


def test_the_four_bars_closed_form_conserves_energy_in_all_positions(references):
    problem = references.FOUR_BAR
    t = np.linspace(0.0, 10.0, 201)
    angle = references.four_bar_angle(t)
    rate = references.four_bar_rate(angle)
    h = 1e-5
    ahead, behind = references.four_bar_angle(t + h), references.four_bar_angle(t - h)
    np.testing.assert_allclose((ahead - behind) / (2.0 * h), rate, rtol=1e-7)
    assert (angle[0], rate[0]) == pytest.approx((0.0, 1.0), abs=1e-9)
    # Five turns, each through both singular positions.
    assert angle[-1] > 10.0 * np.pi
    signs = np.array((-1.0, 1.0, -1.0))
    pairs = zip(np.outer(angle, signs), np.outer(rate, signs), strict=True)
    energies = [problem.exact.energy(q, v) for q, v in pairs]
    assert np.ptp(energies) < 1e-11
    assert max(problem.exact.gap(signs * a) for a in angle) < 1e-14


def test_the_four_bars_closed_form_is_the_exact_motion_up_to_the_singular_position(references):
    t = np.linspace(0.0, 0.6, 7)[1:]
    motion = references.FOUR_BAR.exact.integrate(t)
    np.testing.assert_allclose(-motion.q[:, 0], references.four_bar_angle(t), rtol=1e-9)


@pytest.mark.slow
def test_lumps_bend_as_the_published_beam_but_for_three_per_cent(references):
    problem = references.CRANK
    motion = problem.exact.integrate(problem.times, 1e-6)
    deflection = problem.measured(motion)[:, 0]
    largest = np.abs(deflection).max()
    assert abs(deflection[-1] - references.CRANK_DEFLECTION) < 0.03 * largest
    # The flywheel keeps the rate that the published problem prescribes.
    assert motion.q[-1, 0] == pytest.approx(15.0, abs=1e-5)


@pytest.mark.parametrize(
    ("engine", "settings", "ratios"),
    [
        ("SAP", (2e-3, 1e-3), (1.8, 2.2)),
        ("DISCRETE", (2e-3, 1e-3), (1.8, 2.2)),
        ("ORDER_FOUR", (2e-3, 1e-3), (3.5, 4.5)),
        # The error goes with the step, and the step with the root of the accuracy.
        ("CENIC", (1e-4, 1e-6), (5.0, 20.0)),
    ],
)
def test_errors_shrink_with_the_step_by_the_order_of_the_method(
    closed_loops, brief, engine, settings, ratios
):
    chosen = getattr(closed_loops, engine)
    errors = []
    for setting in settings:
        runner = chosen.make(brief, setting)
        motion = runner.motion()
        errors.append(brief.error(motion))
        if not chosen.is_controlled:
            assert runner.steps() == round(1.0 / setting)
        assert max(map(brief.exact.gap, motion.q)) < 1e-4
    assert ratios[0] < errors[0] / errors[1] < ratios[1]


def test_springs_that_mujoco_takes_implicitly_cost_accuracy(references, closed_loops):
    """The same spring as a force, as Drake takes it, leaves a hundredth of the error."""
    problem, step = references.ANDREWS, 5e-5
    errors = []
    for is_explicit in (False, True):
        runner = closed_loops.DISCRETE.make(problem, step)
        if is_explicit:
            _take_the_spring_as_a_force(runner, problem.linkage.spring)
        errors.append(problem.error(runner.motion()))
    assert 100.0 * errors[1] < errors[0]


def _take_the_spring_as_a_force(runner, spring):
    mujoco, step = runner._mujoco, runner._mujoco.mj_step
    runner._model.tendon_stiffness[:] = 0.0

    class Mujoco:
        """MuJoCo, whose steps begin with the force of the spring."""

        def __getattr__(self, name):
            return getattr(mujoco, name)

        @staticmethod
        def mj_step(model, data, count):
            for _ in range(count):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_tendon(model, data)
                pull = -spring.stiffness * (data.ten_length[0] - spring.length)
                arm = np.zeros(model.nv)
                arm[model.ten_J_colind] = data.ten_J
                data.qfrc_applied[:] = pull * arm
                step(model, data)

    runner._mujoco = Mujoco()


def test_energies_and_gaps_of_a_case_are_those_of_its_motion(closed_loops, brief):
    case = closed_loops.measure(brief, closed_loops.DISCRETE, 5e-3)
    assert case.rate == 200.0
    assert 0.0 < case.error < 0.05
    assert abs(case.drift) < 2.0 * case.energy
    assert 0.0 < case.gap < 1e-3


def test_a_motion_that_breaks_down_has_an_infinite_error(references, closed_loops):
    runner = closed_loops.ORDER_FOUR.make(references.CRANK, 5e-4)
    assert references.CRANK.error(runner.motion()) == np.inf


def test_all_engines_are_drawn_and_tabulated_those_that_break_down_too(
    references, closed_loops, tmp_path, monkeypatch
):
    def case(problem, engine, setting):
        error = np.inf if engine is closed_loops.DEFAULTS else setting
        return closed_loops.Case(
            problem, engine, setting, 1.0 / setting, setting, error, coupler=0.0
        )

    class Console:
        def __init__(self):
            self.lines = []

        def print(self, line, **_):
            self.lines.append(line)

    monkeypatch.setattr(closed_loops, "measure", case)
    console, picture = Console(), tmp_path / "loops.svg"
    results = closed_loops.run(console, picture)
    drawing = picture.read_text()
    for name in [each.name for each in (*closed_loops.ENGINES, *references.PROBLEMS)]:
        assert name in drawing
    tables = [line for line in console.lines if hasattr(line, "columns")]
    assert len(tables) == len(references.PROBLEMS) + 1
    assert "breaks down" in list(tables[0].columns[4].cells)
    # The largest step is the fastest here, and its error the step; the defaults have none.
    fastest = list(tables[-1].columns[1].cells)
    assert fastest[0] == "0.2 ms: 0.0002 x"
    assert fastest[3] == "none"
    assert {result.verdict for result in results} >= {"ok"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["accuracy", "--out", "loops.txt"], "ends in one of .svg"),
        (["scale", "--out", "loops.svg"], "accuracy, which is not asked for"),
    ],
)
def test_a_picture_that_cannot_be_is_refused(benchmarks, arguments, words, capsys):
    with pytest.raises(SystemExit) as refusal:
        benchmarks[3].main(arguments)
    assert refusal.value.code == 2
    assert words in capsys.readouterr().err
