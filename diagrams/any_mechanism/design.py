"""Design of a machine that a model file describes: file, drives, and the link that is led."""

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiControllerParams
from parapod.systems.actuators.pi_servo import PiServo
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.schema import Schema, Variant, choice, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.mechanism.coordinates import free_coordinates, last_link
from parapod.systems.mechanism.equations import part_rates, pose_vector
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.urdf import MODELS_DIR

_PACKAGE = "package://parapod/"
DEFAULT_MODEL = f"{_PACKAGE}any_mechanism/three_rps.urdf"
WELDED, GROUND = "welded", "ground"
# Largest speed of a motor where neither model nor scenario has one [m/s or rad/s].
_SPEED = 1.0
# Distance from a singular position below which no machine begins [-].
_SINGULAR = 1e-5
_FEWEST = 3  # feet on which something stands
# Distance from an end at which a joint is at it [m, rad].
AT_END = 1e-6
# Share by which a drive may exceed an acceleration that is met exactly [-].
_SLACK = 0.01


@dataclass
class Drives(Variant):
    """Root of the drives of a mechanism's motors, between which a tag chooses."""

    def make(self, motors: "Motors", period: float, time_step: float) -> PositionServo | PiServo:
        """The drives, at rest at the motors' positions at home.

        Args:
            motors: the motors that they drive.
            period: at which commands are taken [s].
            time_step: step of their lag [s].
        """
        raise NotImplementedError

    @property
    def acceleration(self) -> float:
        """Largest acceleration of a motor [m/s^2 or rad/s^2]."""
        raise NotImplementedError


@dataclass
class PositionServos(Drives):
    """Drives with position loops of their own, which are at their commands one period later.

    Attributes:
        max_acceleration: largest acceleration of a motor [m/s^2 or rad/s^2].
        time_constant_ms: lag of their velocity loops [ms].
        arrival_ms: time in which they are at a command [ms]; null: the period of the controller.
        resolution: one count of an encoder [m or rad]; 0: perfect ones.
    """

    max_acceleration: float = quantity(50.0, 1e-3, 1e6)
    time_constant_ms: float = quantity(3.0, 0.01, 1000.0)
    arrival_ms: float | None = quantity(None, 0.1, 1000.0)
    resolution: float = quantity(1e-6, 0.0, 1.0)

    @property
    def acceleration(self) -> float:
        """See `Drives`."""
        return self.max_acceleration

    def make(self, motors: "Motors", period: float, time_step: float) -> PositionServo:
        """See `Drives`."""
        params = VelocityServoParams(
            resolution=self.resolution,
            time_constant=1e-3 * self.time_constant_ms,
            max_velocity=max(motors.velocities),
            acceleration=self.max_acceleration * (1.0 + _SLACK),
            stop_min=motors.lower,
            stop_max=motors.upper,
        )
        count, step = len(motors.names), min(time_step, period)
        arrival = None if self.arrival_ms is None else 1e-3 * self.arrival_ms
        return PositionServo(params, count, period, step, motors.home, arrival)


@dataclass
class PiActuators(Drives):
    """Linear actuators with self-locking screws behind PI controllers: see `LinearActuator`.

    Attributes:
        motor_constant_N_V: force of a motor by its voltage [N/V, N m/V].
        viscous_friction_Ns_m: force by speed [N s/m, N m s/rad].
        inertia_kg: equivalent mass of rotor and gear [kg, kg m^2].
        coulomb_friction_N: friction without load [N, N m].
        supply_V: largest voltage either way [V].
        pole: p of the position controllers, Eq. (21) of the platform's paper [rad/s].
        resolution: one count of an encoder [m or rad]; 0: perfect ones.
    """

    motor_constant_N_V: float = quantity(2.0e3, 1e-3, 1e7)  # noqa: N815 (the unit's symbol)
    viscous_friction_Ns_m: float = quantity(5.0e4, 1e-3, 1e9)  # noqa: N815
    inertia_kg: float = quantity(500.0, 0.0, 1e7)
    coulomb_friction_N: float = quantity(100.0, 0.0, 1e6)  # noqa: N815
    supply_V: float = quantity(24.0, 0.1, 1e3)  # noqa: N815
    pole: float = quantity(30.0, 0.1, 500.0)
    resolution: float = quantity(1e-6, 0.0, 1.0)

    @property
    def acceleration(self) -> float:
        """See `Drives`; at rest and without load."""
        force = self.motor_constant_N_V * self.supply_V - self.coulomb_friction_N
        return force / self.inertia_kg if self.inertia_kg > 0.0 else math.inf

    def make(self, motors: "Motors", period: float, time_step: float) -> PiServo:
        """See `Drives`."""
        actuator = LinearActuatorParams(
            motor_constant=self.motor_constant_N_V,
            viscous_friction=self.viscous_friction_Ns_m,
            inertia=self.inertia_kg,
            coulomb_friction=self.coulomb_friction_N,
            supply_voltage=self.supply_V,
            stop_min=min(motors.lower),
            stop_max=max(motors.upper),
        )
        friction = self.coulomb_friction_N / self.motor_constant_N_V
        control = PiControllerParams(
            gain=actuator.gain,
            pole=self.pole,
            voltage_limit=self.supply_V,
            rate_feedforward=1.0,
            friction_feedforward=(friction, friction),
        )
        step = min(time_step, period)
        count = len(motors.names)
        return PiServo(actuator, control, count, period, step, self.resolution, motors.home)


@dataclass(frozen=True)
class Motors:
    """Motors of a mechanism, in the order of their ports.

    Attributes:
        names: names of their joints (n).
        units: "m" or "rad" of each.
        lower: their smallest positions [m, rad].
        upper: their largest positions [m, rad].
        velocities: their largest speeds [m/s, rad/s].
        forces: their largest forces [N, N m]; infinite without a limit.
        home: (n) positions with which the mechanism is at home [m, rad].
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocities: tuple[float, ...]
    forces: tuple[float, ...]
    home: Array


@dataclass
class MechanismDesign(Schema):
    """A machine that a model file describes; docs/your_own/mechanism.md says what is read.

    Attributes:
        file: URDF, SDFormat, MJCF (.xml) or model directives (.dmd.yaml); beside a scenario file
            its name is enough.
        loops: YAML file of its loops and motors; empty: the one beside it, of its name.
        motors: joints with motors, in place of those of the files; * and ? stand for any
            characters.
        frame: link or frame that is led; empty: the link that the motors govern most freely.
        coordinates: parts of its pose in which it is led, of x, y, z, roll, pitch and yaw; empty:
            those that the motors can set.
        home: positions of the motors at home, from where all ways are told [m or rad]; empty:
            those nearest to the file's with which all loops are closed.
        base: "welded" to the world, or standing on the "ground" with its feet, whatever the file
            says.
        feet_mm: feet with which it does, as points of its first link, of which the lowest is as
            high as the ground [mm].
        max_velocity: largest speeds of the motors [m/s or rad/s]; null: those of the model, and 1
            where it has none.
        max_force: largest forces of the motors [N or N m]; null: those of the model.
        zero_error: largest error of the encoders' zeros, drawn from the seed [m or rad].
        force_per_current_N_A: force of a motor by its current [N/A or N m/A].
        natural_frequency_Hz: frequency with which what a motor moves would swing on it alone, by
            which the stiffness of the multibody backend's drives follows [Hz].
        least_mass_kg: mass that lighter links are given: joints that close loops are the softer
            the lighter their links are [kg].
        idle_decay_Hz: rate with which joints come to rest that no motor governs, such as the spin
            of a rod between two ball joints [Hz].
        drives: see `PositionServos` and `PiActuators`.
    """

    file: str = DEFAULT_MODEL
    loops: str = ""
    motors: list[str] = field(default_factory=list)
    frame: str = ""
    coordinates: list[str] = field(default_factory=list)
    home: list[float] = field(default_factory=list)
    base: str = choice(WELDED, (WELDED, GROUND))
    feet_mm: list[list[float]] = field(default_factory=list)
    max_velocity: float | None = quantity(None, 1e-6, 1e3)
    max_force: float | None = quantity(None, 1e-6, 1e9)
    zero_error: float = quantity(1e-4, 0.0, 1.0)
    force_per_current_N_A: float = quantity(100.0, 1e-4, 1e6)  # noqa: N815
    natural_frequency_Hz: float = quantity(60.0, 1.0, 1000.0)  # noqa: N815
    least_mass_kg: float = quantity(0.0, 0.0, 1e5)
    idle_decay_Hz: float = quantity(1.0, 0.0, 1000.0)  # noqa: N815
    drives: Drives = field(default_factory=PositionServos)

    @property
    def path(self) -> Path:
        """The model's file."""
        if self.file.startswith(_PACKAGE):
            return MODELS_DIR / self.file.removeprefix(_PACKAGE)
        return Path(self.file)

    @property
    def loops_path(self) -> Path | None:
        """File of the loops, where one is named."""
        return Path(self.loops) if self.loops else None

    @property
    def built(self) -> "BuiltMechanism":
        """The mechanism, read once.

        Raises:
            ParapodError: a file that cannot be read, or motors, a frame or coordinates that do
                not fit.
        """
        stamps = tuple(
            path.stat().st_mtime_ns
            for path in (self.path, self.loops_path)
            if path is not None and path.is_file()
        )
        files = self.path, self.loops_path, tuple(self.motors)
        settings = self.frame, tuple(self.coordinates), self.max_velocity, self.max_force
        return _built(*files, *settings, tuple(self.home), self.least_mass_kg, stamps)

    @property
    def stiffnesses(self) -> Array:
        """Stiffness of each motor's drive (n) [N/m, N m/rad]."""
        return self.built.inertias * (2.0 * np.pi * self.natural_frequency_Hz) ** 2

    def check(self) -> None:
        """Refuses what makes no machine.

        Raises:
            ScenarioError: names the key.
        """
        _ = self.built
        if self.base == GROUND and len(self.feet_mm) < _FEWEST:
            raise ScenarioError(
                f"machine.feet_mm must have {_FEWEST} points or more where machine.base = "
                f"{GROUND}, not {len(self.feet_mm)}",
                "machine.feet_mm",
            )
        for i, foot in enumerate(self.feet_mm):
            if len(foot) != 3 or not np.isfinite(foot).all():
                key = f"machine.feet_mm.{i}"
                raise ScenarioError(f"{key} must be three numbers, not {foot}", key)


@dataclass(frozen=True, eq=False)
class BuiltMechanism:
    """A mechanism, and what is led of it.

    Attributes:
        mechanism: the mechanism.
        frame: name of the frame that is led.
        parts: parts of its pose in which it is led, by their places in `PARTS`.
        max_velocity: largest speeds of the motors [m/s or rad/s]; None: the model's.
        max_force: largest forces [N or N m]; None: the model's.
        q: (q) positions of all joints at home, all loops closed [m, rad].
    """

    mechanism: Mechanism
    frame: str
    parts: tuple[int, ...]
    max_velocity: float | None
    max_force: float | None
    q: Array

    @cached_property
    def motors(self) -> Motors:
        """Its motors."""
        of = self.mechanism
        names, units, ends, speeds, forces = [], [], [], [], []
        actuators = map(of.plant.get_joint_actuator, of.plant.GetJointActuatorIndices())
        efforts = {int(each.joint().index()): each.effort_limit() for each in actuators}
        for joint in of.motors:
            names.append(of.name(joint))
            units.append("m" if of.is_length[joint.velocity_start()] else "rad")
            ends.append((*joint.position_lower_limits(), *joint.position_upper_limits()))
            (speed,) = joint.velocity_upper_limits()
            if self.max_velocity is not None or not np.isfinite(speed):
                speed = self.max_velocity or _SPEED
            speeds.append(float(speed))
            force = efforts.get(int(joint.index()), np.inf)
            forces.append(float(self.max_force or force))
        lower, upper = (tuple(map(float, side)) for side in zip(*ends, strict=True))
        home = of.motor_positions(self.q)
        return Motors(tuple(names), tuple(units), lower, upper, tuple(speeds), tuple(forces), home)

    @property
    def scale(self) -> Array:
        """Lengths and angles by which ways of the motors are compared (n) [m, rad]."""
        is_length = self.mechanism.is_length[self.mechanism.motor_columns]
        return np.where(is_length, self.mechanism.size, 1.0)

    @cached_property
    def home(self) -> Array:
        """Parts of the pose at home (k) [m, rad]."""
        return self.parts_at(self.q)

    @cached_property
    def stopped(self) -> tuple[str, ...]:
        """Joints that are at an end of theirs at home."""
        of = self.mechanism
        names = []
        for joint in of.joints:
            first, count = joint.position_start(), joint.num_positions()
            q = self.q[first : first + count]
            ends = joint.position_lower_limits(), joint.position_upper_limits()
            if any((np.abs(q - end) < AT_END).any() for end in ends):
                names.append(of.name(joint))
        return tuple(names)

    def parts_at(self, q: Array) -> Array:
        """Parts of the pose (k) in positions (q) [m, rad]."""
        pose: Any = pose_vector(self.mechanism.pose(self.frame, q))
        return np.asarray(pose[list(self.parts)])

    def motor_rates(self, q: Array, rates: Array) -> Array:
        """Speeds of the motors (n) with which the coordinates change at rates (k)."""
        of = self.mechanism
        moves = part_rates(of.plant, of.frame(self.frame), q) @ of.velocity_map(q)
        return np.asarray(np.linalg.lstsq(moves[list(self.parts)], rates)[0])

    def speeds(self, share: float) -> Array:
        """Rates of the coordinates (k) at home, all at once, at a share of the motors' speeds.

        In any direction no motor is faster than that.
        """
        rates = [self.motor_rates(self.q, unit) for unit in np.eye(len(self.parts))]
        most = np.max(np.abs(rates) / self.motors.velocities, axis=1)
        return np.asarray(share / (len(self.parts) * most))

    @cached_property
    def inertias(self) -> Array:
        """Mass that each motor moves at home while the others stand (n) [kg, kg m^2]."""
        of = self.mechanism
        context: Context = of.plant.CreateDefaultContext()
        of.plant.SetPositions(context, self.q)
        by_motors = of.velocity_map(self.q)
        masses = by_motors.T @ of.plant.CalcMassMatrix(context) @ by_motors
        return np.diag(masses).copy()


@lru_cache(maxsize=8)
def _built(
    path: Path,
    loops: Path | None,
    motors: tuple[str, ...],
    frame: str,
    coordinates: tuple[str, ...],
    max_velocity: float | None,
    max_force: float | None,
    home: tuple[float, ...],
    least_mass: float,
    stamps: tuple[int, ...],
) -> BuiltMechanism:
    key = "machine"
    try:
        # Its own motions are those of a mechanism whose base stands, also on the ground.
        mechanism = Mechanism.load(path, loops, motors, False, least_mass)
        key = "machine.motors"
        mechanism.check_motors()
        for joint in mechanism.motors:
            if joint.num_positions() != 1:
                raise ScenarioError(f"the motor {mechanism.name(joint)} must have one freedom")
        key = "machine.home"
        q = _home(mechanism, home)
        key = "machine.frame"
        name = mechanism.frame(frame).name() if frame else last_link(mechanism)
        key = "machine.coordinates"
        parts = free_coordinates(mechanism, name, coordinates)
        if not parts:
            key = "machine.frame"
            raise ScenarioError(f"the motors set no part of the pose of {name} at home")
        part_rates(mechanism.plant, mechanism.frame(name), q)  # where its angles have rates
    except ParapodError as error:
        raise ScenarioError(f"{key}: {error}", key) from None
    return BuiltMechanism(mechanism, name, parts, max_velocity, max_force, q)


def _home(mechanism: Mechanism, home: tuple[float, ...]) -> Array:
    """Positions (q) at home.

    Raises:
        ParapodError: positions that the motors cannot take, or a singular position.
    """
    count = len(mechanism.motors)
    if home and len(home) != count:
        raise ScenarioError(f"there must be {count} numbers, one for each motor, not {len(home)}")
    q = mechanism.forward(home) if home else mechanism.home
    if beyond := mechanism.beyond_limits(q):
        name, far = next(iter(beyond.items()))
        raise ScenarioError(
            f"{name} is {far:.4g} beyond its limits there [m, rad]; give other positions of "
            f"{', '.join(map(mechanism.name, mechanism.motors))}"
        )
    held = mechanism.dexterity(q).held
    if held < _SINGULAR:
        names = ", ".join(map(mechanism.name, mechanism.motors))
        raise ScenarioError(
            f"it is next to a singular position ({held:.2g} of 1); give other positions of {names}"
        )
    return q
