"""Every number that the levelling platform's paper prints, and the same number here."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.levelling_platform.ports import PORTS
from parapod.sims.levelling_platform.slip.scenario import SwingScenario
from parapod.sims.report.chapter import Claim, Numbers, Relation
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiControllerParams
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics, posture_jacobian
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.wheels import WHEEL_GEAR
from parapod.systems.levelling_platform.workspace import CENTRE, SURFACE_COUNT, ArmGeometry

_PLATFORM = PlatformGeometry()
_LEVEL = (0.0, 0.0)
_TABLE_2 = ((1, 1, -1, -1), (-1, 1, 1, -1), (1, 1, 1, 1))
_YAWS = (-49.0, 49.0, 180.0 - 49.0, 180.0 + 49.0)
_PROTOTYPE = "no prototype here: a plant whose legs are off by up to .5 mm and .2 deg"


def _constant(value: float) -> Callable[[Numbers], float]:
    return lambda _: value


def _of(part: str, key: str, scale: float = 1.0) -> Callable[[Numbers], float]:
    return lambda numbers: scale * numbers(part, key)


def _used(where: str, what: str, printed: float, unit: str, value: float) -> Claim:
    return Claim(where, what, printed, unit, _constant(value), Relation.USED)


def _error(
    where: str,
    what: str,
    printed: float,
    unit: str,
    part: str,
    key: str,
    is_measured: bool = False,
) -> Claim:
    here = _of(part, key)
    return Claim(where, what, printed, unit, here, Relation.AT_MOST, is_measured=is_measured)


def _dimensions() -> tuple[Claim, ...]:
    """Tables 1 and 2, and the angles below them."""
    lengths = {
        "l_c1": (400.0, _PLATFORM.l_c1),
        "l_c2": (170.0, _PLATFORM.l_c2),
        "l_c3": (113.0, _PLATFORM.l_c3),
        "l_2, l_3": (80.0, _PLATFORM.l_3),
        "l_4, l_5": (440.0, _PLATFORM.l_4),
        "l_6": (165.0, _PLATFORM.l_6),
        "l_7": (205.0, _PLATFORM.l_7),
    }
    angles = {"α": (61.0, _PLATFORM.alpha), "β": (49.0, _PLATFORM.beta)}
    legs = _PLATFORM.legs
    signs = [[math.copysign(1.0, getattr(leg, name)) for leg in legs] for name in _NAMES]
    yaws = [math.degrees(leg.beta) for leg in legs]
    return (
        *(_used("Table 1", n, mm, "mm", 1e3 * here) for n, (mm, here) in lengths.items()),
        *(_used("Table 1", n, deg, "deg", math.degrees(a)) for n, (deg, a) in angles.items()),
        Claim(
            "Table 2",
            "signs of l_x, l_y, l_z of legs 1 to 4",
            "++--, -++-, ++++",
            here=_constant(float(np.abs(np.subtract(signs, _TABLE_2)).max())),
            relation=Relation.USED,
            show=lambda _: ", ".join(
                "".join("+" if sign > 0 else "-" for sign in row) for row in signs
            ),
        ),
        Claim(
            "section 3",
            "β_1 to β_4: -β, β, π - β, π + β",
            "-49, 49, 131, 229 deg",
            here=_constant(float(np.abs(np.subtract(yaws, _YAWS)).max())),
            relation=Relation.USED,
            show=lambda _: ", ".join(f"{yaw:.0f}" for yaw in yaws) + " deg",
        ),
    )


_NAMES = ("l_x", "l_y", "l_z")


@cache
def _masses() -> tuple[float, float]:
    """Masses of the machine without its arm, and of the arm with its camera [kg]."""
    plant = MultibodyPlant(1e-3)
    scene_graph = SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(plant)
    arm = plant.GetBodyByName("link", model.arm).default_mass()
    ground = plant.GetBodyByName("ground").default_mass()
    return plant.CalcTotalMass(plant.CreateDefaultContext()) - ground - arm, arm


def _mass(which: int) -> Callable[[Numbers], float]:
    return lambda _: _masses()[which]


def _size(port: str) -> float:
    return float({spec.name: spec.size for spec in PORTS}[port])


def _machine() -> tuple[Claim, ...]:
    """Sections 2 and 3: what the machine consists of, and how it moves."""
    jacobian = posture_jacobian(_PLATFORM, [0.0, 0.0, 0.477], _LEVEL)
    stroke = (_PLATFORM.extension_min, _PLATFORM.extension_max)
    feet = np.array([foot_to_centre(_PLATFORM.legs[0], d) for d in np.linspace(*stroke, 301)])
    sideways, upwards = np.ptp(np.hypot(feet[:, 0], feet[:, 1])), np.ptp(feet[:, 2])
    return (
        _used("section 2.1", "linear actuators, with encoders", 4, "", _size("legs.extension")),
        _used("section 2.1", "limit switches", 12, "", _size("legs.limits")),
        _used("section 2.1", "wheel motors with encoders", 4, "", _size("wheels.position")),
        _used("section 2.1", "reduction n of the wheels' gears", 26, "", WHEEL_GEAR),
        _used("section 2.1", "axes of gyroscope, accelerometer", 3, "", _size("imu.gyro")),
        Claim(
            "section 2.1",
            "slots, channels and currents of the controller (8; 32, 4, 48), drives (25 A) and "
            "positioning controllers (24/5)",
            "as listed",
            relation=Relation.MISSING,
            remark="the devices are driven through the ports; the spare channels are not used",
        ),
        Claim(
            "section 3",
            "degrees of freedom on four legs",
            3,
            here=_constant(float(np.linalg.matrix_rank(jacobian))),
        ),
        Claim(
            "Fig. 6",
            "p_x moves much less than p_z",
            "“much smaller”",
            here=_constant(float(sideways / upwards)),
            tolerance=0.1,
            show=lambda _: f"{1e3 * sideways:.1f} against {1e3 * upwards:.0f} mm",
        ),
        Claim("section 5.2", "mass of the platform", 50.0, "kg", _mass(0), Relation.USED),
        Claim("section 7", "mass of the arm with camera", 1.0, "kg", _mass(1), Relation.USED),
        _used("section 4", "length L of the arm", 2.02, "m", ArmGeometry().length),
        Claim(
            "section 4",
            "mass m of the arm without camera",
            0.27,
            "kg",
            relation=Relation.MISSING,
            remark="the arm is one rigid body of 1 kg, camera included, as in section 7",
        ),
        _used("section 4", "shortest actuator", 390.0, "mm", 1e3 * stroke[0]),
        _used("section 4", "longest actuator", 420.0, "mm", 1e3 * stroke[1]),
    )


def _validation() -> tuple[Claim, ...]:
    """Section 3.3: the kinematic model beside co-simulation and prototype."""
    part = "validate-kinematics"
    simulated, measured = "section 3.3.1, Figs. 8, 9", "section 3.3.2, Figs. 10, 11"
    height = "largest error of the height"
    pitch, roll = "largest error of the pitch", "largest error of the roll"
    slope = ", ground at 5 deg"
    floor = ", prototype, floor at -.3 and .1 deg"
    parts_list = (
        (height + floor, 1.0, "mm", "perturbed_height_error_mm"),
        (pitch + floor, 0.1, "deg", "perturbed_pitch_error_deg"),
        (roll + floor, 0.2, "deg", "perturbed_roll_error_deg"),
    )
    return (
        _error(simulated, height + slope, 0.3, "mm", part, "height_error_mm"),
        _error(simulated, pitch + slope, 0.07, "deg", part, "pitch_error_deg"),
        _error(simulated, roll + slope, 0.07, "deg", part, "roll_error_deg"),
        *(
            Claim(
                measured,
                what,
                printed,
                unit,
                _of(part, key),
                Relation.ALIKE,
                tolerance=10.0,
                remark=_PROTOTYPE,
                spread=(part, key),
            )
            for what, printed, unit, key in parts_list
        ),
    )


def _workspace() -> tuple[Claim, ...]:
    """Section 4."""
    low = forward_kinematics(_PLATFORM, [_PLATFORM.extension_max] * LEG_COUNT, _LEVEL)[2]
    x, y, _ = foot_to_centre(_PLATFORM.legs[1], _PLATFORM.extension_max)
    where = "section 4"
    fitted = "the arm's base is fitted: Eq. (13) is lost"
    near = "of the platform's centre in its lowest pose"
    return (
        Claim(where, "faces of the workspace", 8, here=_constant(float(SURFACE_COUNT))),
        *(
            Claim(where, f"{name} of the workspace", 1e3 * printed, "mm", _constant(1e3 * here),
                  tolerance=0.03, remark=near)
            for name, printed, here in zip(("x_c", "y_c", "z_c"), CENTRE, (x, y, low), strict=True)
        ),
        Claim(
            where,
            "share of the workspace inside the eight surfaces",
            97.0,
            "%",
            _of("workspace", "inside_fraction", 100.0),
            Relation.AT_LEAST,
            remark=fitted,
        ),
        Claim(
            where,
            "share of what they enclose that is out of reach",
            0.0,
            "%",
            _of("workspace", "unreachable_fraction", 100.0),
            tolerance=1e-3,
            remark="see E9",
        ),
        Claim(
            "Eq. (14)",
            "tip on inclined ground against the rotated workspace",
            0.0,
            "mm",
            _of("workspace", "inclined_difference_mm"),
            tolerance=1e-3,
            remark="on 3 and 5 deg; see E10",
        ),
    )  # fmt: skip


def _actuators() -> tuple[Claim, ...]:
    """Section 5."""
    part, design = "identify-actuators", PiControllerParams()
    gain = "gain K, mean of ten steps, "
    largest = "largest deviation of a step's K from .01, "
    return (
        Claim("section 5.2", gain + "legs lifted", 0.01, "(m/s)/V", _of(part, "gain_unloaded"),
              tolerance=0.15, remark="within the printed 15 %"),
        Claim("section 5.2", gain + "under load", 0.01, "(m/s)/V", _of(part, "gain_loaded"),
              tolerance=0.15, remark="within the printed 15 %"),
        _error("Fig. 15", largest + "legs lifted", 15.0, "%", part,
               "step_deviation_unloaded_percent", is_measured=True),
        _error("Fig. 15", largest + "under load", 15.0, "%", part,
               "step_deviation_loaded_percent", is_measured=True),
        Claim("section 5.2", "effect of the load on K", "“very little”", "",
              _of(part, "load_effect_percent"), tolerance=15.0,
              show=lambda numbers: f"{numbers(part, 'load_effect_percent'):.1f} %"),
        _used("Eq. (18)", "K of the design", 0.01, "(m/s)/V", LinearActuatorParams().gain),
        _used("section 6.4", "p", 10.0, "rad/s", design.pole),
        Claim("Eq. (32)", "K_v", 2000.0, "V/m", _constant(design.k_v)),
        Claim("Eq. (32)", "K_p", 10000.0, "V/(m s)", _constant(design.k_p)),
    )  # fmt: skip


def _control() -> tuple[Claim, ...]:
    """Sections 6.4 and 7."""
    part, where = "track-posture", "section 6.4, Figs. 20, 21"
    return (
        _error(where, "largest error of the height at rest", 2.0, "mm", part,
               "perturbed_height_error_mm", is_measured=True),
        _error(where, "largest error of the pitch at rest", 0.2, "deg", part,
               "perturbed_pitch_error_deg", is_measured=True),
        _error(where, "largest error of the roll at rest", 0.2, "deg", part,
               "perturbed_roll_error_deg", is_measured=True),
        Claim("Fig. 22b", "an extension against its reference", "“almost perfect”", "",
              _of(part, "extension_error_mm"), tolerance=0.5,
              show=lambda numbers: f"{numbers(part, 'extension_error_mm'):.2g} mm"),
        _used("section 7", "swing of the arm", 45.0, "deg", SwingScenario().angle_deg),
        _used("section 7", "duration of the swing", 1.0, "s", SwingScenario().duration),
        _error("section 7, Fig. 23", "slip of a foot while the arm swings", 0.01, "mm", "slip",
               "arm_slip_mm"),
        Claim("section 7, Fig. 23", "slip of a foot while the actuators move", 3.0, "mm",
              _of("slip", "actuator_slip_mm"), Relation.ALIKE, 2.0,
              remark="the lift's height is not printed; here 410 mm extension to 520 mm height"),
    )  # fmt: skip


CLAIMS = (
    *_validation(),
    *_workspace(),
    *_actuators(),
    *_control(),
    *_machine(),
    *_dimensions(),
)
