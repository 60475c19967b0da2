"""The whole configuration as frozen dataclasses: defaults (the paper's), units, legal values, and loading from YAML.

Every value lives here once; the profiles in config/, the README's parameter table and the ROS parameters derive
from it.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, Optional, Sequence, Tuple

from embodied_active_learning.errors import ConfigError
from embodied_active_learning.files import FileReader
from embodied_active_learning.workspace import STATE_NAMES, Workspace

_PROFILE_READER = FileReader(
    ConfigError, "give the path of a profile, sections of keys as in config/paper.yaml", follow=True
)
_FRANKA_LENGTHS = {
    "camera_position": 3,
    "camera_rotation": 3,
    "torque_limits": 7,
    "force_limits": 6,
    "load_centre": 3,
    "load_inertia": 3,
}
_LONGEST_KEY = 80  # characters of an unknown key that are looked at and told
EXPLORERS = ("ergodic", "random_walk", "uniform", "uniform_ergodic")
SIMULATED, REAL, RECORDED = ROBOTS = ("pybullet", "franka", "recording")


def setting(
    default: Any,
    meaning: str,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    choices: Sequence[str] = (),
) -> Any:
    """A dataclass field that knows its unit, meaning and legal values. Numbers must lie in [low, high]."""
    metadata = {"meaning": meaning, "unit": unit, "low": low, "high": high, "choices": tuple(choices)}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class WorkspaceConfig:
    """Where the camera may go, in the base frame."""

    x: Tuple[float, ...] = setting((0.325, 0.625), "limits of the camera's x", "m", -2.0, 2.0)
    y: Tuple[float, ...] = setting((-0.15, 0.15), "limits of the camera's y", "m", -2.0, 2.0)
    theta: Tuple[float, ...] = setting((-2.0, 2.0), "limits of the camera's yaw", "rad", -math.pi, math.pi)

    def box(self) -> Workspace:
        """The limits as a Workspace. Raises ConfigError when they are out of order."""
        limits = (self.x, self.y, self.theta)
        for name, pair in zip(STATE_NAMES, limits):
            if len(pair) != 2:
                raise ConfigError(f"workspace/{name} has {len(pair)} numbers: give [lower, upper]")
        return Workspace(lower=tuple(pair[0] for pair in limits), upper=tuple(pair[1] for pair in limits))


@dataclass(frozen=True)
class CameraConfig:
    """The wrist camera: what an image must look like, and where it is taken from."""

    width: int = setting(180, "image width", "px", 8, 4096)
    height: int = setting(180, "image height", "px", 8, 4096)
    field_of_view: float = setting(30.0, "vertical field of view", "deg", 1.0, 150.0)
    distance: float = setting(0.3, "height of the camera above the table", "m", 0.05, 2.0)
    max_age: float = setting(
        1.0,
        "time without a new image, and age of image or pose, beyond which the arm is held still",
        "s",
        0.05,
        60.0,
    )
    allow_featureless: bool = setting(
        False, "accept images of one single colour, as of a plain table without noise; else the arm is held still"
    )


@dataclass(frozen=True)
class ArmConfig:
    """Which arm it is, and the limits that the node in front of it keeps, whoever commands it."""

    robot: str = setting(
        SIMULATED,
        "whose images and poses these are: the simulated arm's, a Panda's under franka_ros, or recorded ones",
        "",
        choices=ROBOTS,
    )
    max_speed: float = setting(0.15, "limit of the camera's speed along each of x and y", "m/s", 0.001, 1.0)
    max_turn_rate: float = setting(1.5, "limit of the camera's yaw rate", "rad/s", 0.001, 2.6)
    # So much on every axis at once takes four fifths of what a Panda's second joint can do (7.5 rad/s^2), and less of
    # the others', all over the default workspace. Top speed is reached, and lost, within 0.15 s.
    max_acceleration: float = setting(
        1.2, "limit of the change of the camera's speed along each of x and y", "m/s^2", 0.1, 13.0
    )
    max_turn_acceleration: float = setting(10.0, "limit of the change of the camera's yaw rate", "rad/s^2", 0.1, 25.0)
    max_duration: float = setting(1.0, "longest time that one velocity may be held", "s", 0.01, 10.0)
    commander_timeout: float = setting(
        5.0, "wall time after its last sign of life for which a commander keeps the arm to itself", "s", 0.1, 600.0
    )
    retries: int = setting(
        5, "how often in a row commands that fail are tried again, with growing pauses, before giving up", "", 0, 100
    )


@dataclass(frozen=True)
class ModelConfig:
    """The conditional variational autoencoder (paper, Table 2)."""

    latent_size: int = setting(16, "number of latent variables", "", 1, 1024)
    hidden_sizes: Tuple[int, ...] = setting(
        (512, 256), "encoder's fully connected layers; the decoder mirrors them", "", 1, 8192
    )
    channels: Tuple[int, ...] = setting((10, 10, 20), "filters of the convolutions", "", 1, 512)
    kernels: Tuple[int, ...] = setting((3, 3, 5), "kernel sizes of the convolutions", "px", 1, 31)
    strides: Tuple[int, ...] = setting((2, 2, 3), "strides of the convolutions", "px", 1, 31)


@dataclass(frozen=True)
class ObjectiveConfig:
    """The loss and the schedule of its weights (paper, Sec. 4, loss formulation, and Alg. 1)."""

    chi: float = setting(
        4.0, "scale of the latent regularisation: log10 beta = -log10(min h / max h) - chi", "", 0.0, 20.0
    )
    beta_max: float = setting(0.01, "upper clamp of beta", "", 0.0, 1e6)
    gamma_weight: float = setting(
        0.1, "gamma is this times the workspace coverage k; 0 switches the term off", "", 0.0, 100.0
    )
    schedule_every: int = setting(25, "updates between two evaluations of beta and gamma", "updates", 1, 100000)
    schedule_window: int = setting(25, "evaluations over which beta and gamma are averaged", "", 1, 100000)


@dataclass(frozen=True)
class TrainingConfig:
    """Online training (paper, appendix)."""

    batch_size: int = setting(64, "observations of a mini-batch", "", 1, 65536)
    learning_rate: float = setting(1e-3, "learning rate of Adam", "", 1e-8, 1.0)
    first_update_at: int = setting(64, "observations before learning starts", "", 1, 1000000)
    start_at_mean_colour: bool = setting(
        True, "the decoder starts at the first observations' mean colour instead of black, and learns sooner"
    )
    updates_per_observation: int = setting(3, "model updates for each observation", "", 0, 1000)
    max_lag: int = setting(
        0,
        "updates that the trainer may be behind before the planner waits; at 0 one seed gives one result",
        "updates",
        0,
        1000000,
    )
    device: str = setting("auto", "where the model lives", "", choices=("auto", "cpu", "cuda"))
    threads: int = setting(0, "CPU threads of the trainer; 0 takes every core", "", 0, 1024)
    active_unit_threshold: float = setting(
        0.01, "variance of a latent mean above which the unit is active", "", 0.0, 100.0
    )
    evaluate_every: int = setting(300, "updates between two evaluations on a fixed subset", "updates", 1, 1000000)
    evaluation_size: int = setting(256, "observations of the fixed subset", "", 2, 65536)
    checkpoint_every: int = setting(600, "updates between two checkpoints", "updates", 1, 1000000)
    checkpoints_kept: int = setting(2, "checkpoints kept", "", 1, 1000)


@dataclass(frozen=True)
class ExplorationConfig:
    """What is explored, for how long, and against which samples coverage is measured."""

    explorer: str = setting("ergodic", "how the arm explores", "", choices=EXPLORERS)
    steps: int = setting(3000, "exploration steps, one observation each", "", 1, 1000000)
    seed: int = setting(0, "seed of every random draw", "", 0, 2**31 - 1)
    step_duration: float = setting(0.2, "time between two observations", "s", 0.01, 10.0)
    samples: int = setting(1000, "workspace samples S", "", 10, 100000)
    fresh_samples: int = setting(100, "samples drawn anew at each step", "", 0, 100000)
    sample_box: float = setting(
        1.0, "size of the box the samples are drawn in, in workspaces; the authors take 1.15", "", 1.0, 2.0
    )
    kernel_variance: float = setting(
        0.0,
        "variance of the coverage kernel in normalised units; 0 takes the authors' rule, 0.0576 for S = 1000",
        "",
        0.0,
        4.0,
    )
    authors_coverage: bool = setting(
        False, "workspace coverage as the authors' controller has it: divided by its maximum, 1 outside the workspace"
    )


@dataclass(frozen=True)
class PlannerConfig:
    """KL-ergodic receding-horizon control (paper, Sec. 2.3)."""

    horizon: int = setting(10, "planned steps", "", 2, 200)
    iterations: int = setting(3, "improvements of the plan per step", "", 1, 100)
    control_weight: float = setting(10.0, "weight R of the control in the adjoint update", "", 1e-6, 1e9)
    acceleration_limit: float = setting(1.0, "limit of the control, in velocity units per second", "", 1e-3, 100.0)
    velocity_limits: Tuple[float, ...] = setting(
        (1.25, 1.25, 0.625),
        "velocity of each axis, in the controller's units, at the arm's highest speed",
        "",
        1e-3,
        100.0,
    )
    barrier_weight: float = setting(5.0, "weight of the barrier", "", 0.0, 1e6)
    barrier_power: float = setting(4.0, "power of the barrier", "", 1.0, 10.0)
    barrier_margin: float = setting(0.1, "distance from a limit at which the barrier begins, normalised", "", 0.0, 0.9)
    random_candidates: int = setting(8, "random two-segment plans compared at each step", "", 0, 1000)
    normalise_kernels: bool = setting(
        True, "divide each kernel by its mass inside the workspace, so that parking in a corner costs"
    )
    measured_velocity_weight: float = setting(
        0.5, "how much of the velocity tracking error the plan takes over", "", 0.0, 1.0
    )


@dataclass(frozen=True)
class FingerprintConfig:
    """How learned objects are found in the conditional entropy, and looked at (paper, appendix)."""

    clustering: str = setting(
        "table",
        "what is clustered: points of the table that stand out in the views that are hard to predict, or, as in the "
        "paper, the camera's own positions; those need a bandwidth of 0.09 m",
        "",
        choices=("table", "camera"),
    )
    latents: int = setting(10, "latents over which the predicted standard deviation is averaged", "", 1, 1000)
    samples: int = setting(1000, "importance samples of the conditional entropy", "", 50, 100000)
    exponent: float = setting(3.0, "power of the standard deviation in the weight of a sample", "", 0.1, 20.0)
    bandwidth: float = setting(0.045, "bandwidth of mean-shift clustering", "m", 0.005, 0.5)
    min_share: float = setting(0.05, "share of the samples that a cluster needs to be an object", "", 0.0, 1.0)
    merge_distance: float = setting(0.05, "distance below which two centres are one object", "m", 0.0, 0.5)
    min_contrast: float = setting(
        2.0, "largest over smallest predicted standard deviation below which there is nothing to find", "", 1.0, 100.0
    )
    views: int = setting(50, "views of each object", "", 2, 1000)
    view_std: float = setting(0.015, "standard deviation of the views around the centre, in x and in y", "m", 1e-3, 0.5)
    view_yaw_std: float = setting(2.8, "standard deviation of the views' yaw", "rad", 0.01, 100.0)
    view_box: float = setting(0.06, "farthest that a view is from the centre, in x and in y", "m", 0.005, 0.5)
    steps_per_view: int = setting(3, "steps of the arm for each view that is kept", "", 1, 100)
    min_view_distance: float = setting(
        0.002, "a view is a duplicate when another one is closer than this and turned less than ...", "m", 0.0, 0.1
    )
    min_view_turn: float = setting(0.05, "... this", "rad", 0.0, 3.0)


@dataclass(frozen=True)
class IdentificationConfig:
    """How fingerprints are found again (paper, appendix), and when one counts as found."""

    features: str = setting(
        "latents",
        "what stored and new views are compared by; pixels, 30 x 30, is the baseline without a model",
        "",
        choices=("latents", "pixels"),
    )
    decision: str = setting(
        "verified",
        "when a fingerprint is found: verified asks the views of each candidate whether they agree; belief asks that "
        "the mean belief exceeds min_belief",
        "",
        choices=("verified", "belief"),
    )
    evidence: str = setting(
        "tempered",
        "weight of an image: tempered shares it among the images from one place; counted takes each as independent",
        "",
        choices=("tempered", "counted"),
    )
    independence_distance: float = setting(0.01, "distance over which two images are nearly the same", "m", 1e-4, 1.0)
    independence_turn: float = setting(0.2, "turn over which two images are nearly the same", "rad", 1e-3, 10.0)
    near_variance: float = setting(0.156, "variance of a measurement at the place it points to", "", 1e-6, 1e6)
    far_pull: float = setting(
        0.02,
        "information of a measurement about cells far from the place it points to, relative to that place; it draws "
        "unseen cells to the mean of all measurements",
        "",
        1e-6,
        1.0,
    )
    kernel_std: float = setting(0.042, "standard deviation of a measurement's footprint, in x and in y", "m", 1e-3, 0.5)
    kernel_yaw_std: float = setting(0.56, "standard deviation of a measurement's footprint in yaw", "rad", 0.01, 10.0)
    cells: Tuple[int, ...] = setting((40, 40, 18), "cells of a belief grid in x, y and yaw", "", 4, 500)
    margin: float = setting(0.0225, "how far the belief grid reaches beyond the workspace", "m", 0.0, 0.5)
    candidates: int = setting(12, "peaks of a belief that are looked at", "", 1, 1000)
    separation: float = setting(0.06, "closest that two objects are taken to lie", "m", 0.005, 1.0)
    min_belief: float = setting(0.5, "mean belief that the decision 'belief' asks for", "", 0.0, 1.0)
    residual_limit: float = setting(
        0.065, "largest residual, either way, of a view that agrees with the fingerprint; 1 is white", "", 0.0, 1.0
    )
    agreement_distance: float = setting(
        0.02, "farthest from the candidate that a view that agrees may point to", "m", 0.001, 0.5
    )
    min_agreement: float = setting(0.55, "share of the compared views that must agree", "", 0.0, 1.0)
    min_prominence: float = setting(
        0.01,
        "how far the belief at an object must rise above the median of its grid: over bare table it hardly does",
        "",
        0.0,
        1.0,
    )
    object_radius: float = setting(0.045, "part of the table around a candidate that is compared", "m", 0.005, 0.5)
    view_distance: float = setting(0.04, "farthest that a view of a candidate is from it", "m", 0.005, 0.5)
    views: int = setting(30, "views of a candidate that are compared, at most", "", 1, 1000)
    min_views: int = setting(5, "views of a candidate without which nothing is decided", "", 1, 1000)


@dataclass(frozen=True)
class SessionConfig:
    """Where the run is kept."""

    name: str = setting("", "name of the session folder; empty makes one of world, explorer, seed and time")
    root: str = setting("~/.ros/embodied_active_learning", "folder that holds the sessions")
    resume: bool = setting(False, "continue the session of that name")


@dataclass(frozen=True)
class SimulationConfig:
    """The PyBullet stand-in."""

    world: str = setting("diagonal", "name of a world in worlds/, or the path of a YAML file")
    physics_rate: int = setting(240, "physics steps per second", "Hz", 60, 2000)
    start: Tuple[float, ...] = setting((0.475, 0.0, 0.0), "pose at the start: x, y, theta", "m, m, rad", -4.0, 4.0)


@dataclass(frozen=True)
class FrankaConfig:
    """A real Panda under franka_ros: what differs from lab to lab, and what the arm may feel and do by itself."""

    table_height: float = setting(0.0, "height of the table's surface in the base frame", "m", -1.0, 1.0)
    camera_position: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "optical centre of the camera in the robot's end effector frame (EE)", "m", -0.5, 0.5
    )
    camera_rotation: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "camera_optical_frame in the end effector frame: roll, pitch, yaw about fixed axes",
        "rad",
        -math.pi,
        math.pi,
    )
    rate: float = setting(100.0, "set-points per second that are sent to the impedance controller", "Hz", 20.0, 500.0)
    max_lead: float = setting(
        0.05, "farthest that a set-point is ahead of the measured pose, along each of x, y and z", "m", 0.005, 0.1
    )
    max_turn_lead: float = setting(0.3, "farthest that a set-point is turned ahead of it", "rad", 0.02, 0.6)
    max_height_error: float = setting(
        0.03, "farthest that the camera may be above or below its height when motion begins", "m", 0.001, 0.2
    )
    max_tilt: float = setting(
        0.15, "farthest that the camera may look away from straight down when motion begins", "rad", 0.005, 0.5
    )
    max_outside: float = setting(
        0.1, "farthest outside of the workspace, along x or y, from where the camera is led back into it", "m", 0.0, 1.0
    )
    max_turn_outside: float = setting(0.5, "farthest outside of the workspace in yaw", "rad", 0.0, math.pi)
    tolerance: float = setting(
        0.015, "farthest that the camera may come to rest from where it was to go; friction is why", "m", 0.001, 0.1
    )
    turn_tolerance: float = setting(
        0.1, "farthest in yaw that it may come to rest from where it was to go", "rad", 0.005, 0.5
    )
    stiffness: float = setting(200.0, "translational stiffness of the impedance controller", "N/m", 50.0, 400.0)
    turn_stiffness: float = setting(10.0, "rotational stiffness of the impedance controller", "Nm/rad", 2.0, 30.0)
    state_max_age: float = setting(
        0.2, "age of the robot's state beyond which the arm is held where it was seen last", "s", 0.02, 2.0
    )
    coast: float = setting(
        0.2, "time after a move for which its velocity is kept for the next one, before the arm brakes", "s", 0.0, 1.0
    )
    recoveries: int = setting(
        3,
        "reflexes in a row after which the arm recovers by itself; then a person has to call /arm/recover",
        "",
        0,
        100,
    )
    torque_limits: Tuple[float, ...] = setting(
        (20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0),
        "external torque of each joint above which a collision reflex stops the arm",
        "Nm",
        1.0,
        100.0,
    )
    force_limits: Tuple[float, ...] = setting(
        (20.0, 20.0, 20.0, 25.0, 25.0, 25.0),
        "external force (3) and torque (3) at the end effector above which a collision reflex stops the arm",
        "N, Nm",
        1.0,
        100.0,
    )
    load_mass: float = setting(0.0, "mass of camera and mount, if Desk does not know it yet", "kg", 0.0, 3.0)
    load_centre: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "centre of mass of that load in the flange frame", "m", -0.5, 0.5
    )
    load_inertia: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "moments of inertia of that load about its centre: Ixx, Iyy, Izz", "kg m^2", 0.0, 1.0
    )


@dataclass(frozen=True)
class Config:
    """Everything that a run depends on."""

    workspace: WorkspaceConfig = field(default_factory=WorkspaceConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    arm: ArmConfig = field(default_factory=ArmConfig)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    franka: FrankaConfig = field(default_factory=FrankaConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    exploration: ExplorationConfig = field(default_factory=ExplorationConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    fingerprint: FingerprintConfig = field(default_factory=FingerprintConfig)
    identification: IdentificationConfig = field(default_factory=IdentificationConfig)
    session: SessionConfig = field(default_factory=SessionConfig)

    def __post_init__(self) -> None:
        """Check what no single value can: limits against each other."""
        box = self.workspace.box()
        start = self.simulation.start
        if self.arm.robot == SIMULATED and (len(start) != box.size or not box.contains(start)):
            raise ConfigError(
                f"simulation/start {list(start)} lies outside the workspace: move it, or "
                "enlarge workspace/x, workspace/y, workspace/theta"
            )
        for key, count in _FRANKA_LENGTHS.items():
            given = len(getattr(self.franka, key))
            if given != count:
                raise ConfigError(f"franka/{key} has {given} numbers: give {count}")
        if len(self.identification.cells) != box.size:
            raise ConfigError(
                f"identification/cells needs {box.size} numbers, one for each of {', '.join(STATE_NAMES)}"
            )
        if self.identification.min_views > self.identification.views:
            raise ConfigError("identification/min_views is larger than identification/views: nothing would be found")
        if len(self.planner.velocity_limits) != box.size:
            raise ConfigError(
                f"planner/velocity_limits needs {box.size} numbers, one for each of {', '.join(STATE_NAMES)}"
            )
        if self.exploration.step_duration > self.arm.max_duration:
            raise ConfigError(
                "exploration/step_duration is longer than arm/max_duration: the arm would refuse each command"
            )
        if self.exploration.fresh_samples > self.exploration.samples:
            raise ConfigError("exploration/fresh_samples is larger than exploration/samples: only as many can be new")
        if self.training.batch_size > self.training.first_update_at:
            raise ConfigError(
                "training/batch_size is larger than training/first_update_at: the first batch could not be filled"
            )
        if self.training.updates_per_observation and self.exploration.steps < self.training.first_update_at:
            raise ConfigError(
                f"exploration/steps is {self.exploration.steps}, fewer than training/first_update_at "
                f"({self.training.first_update_at}): nothing would be learned"
            )
        layers = {len(self.model.channels), len(self.model.kernels), len(self.model.strides)}
        if len(layers) != 1:
            raise ConfigError(
                "model/channels, model/kernels and model/strides differ in length: give one number a convolution"
            )

    @property
    def updates_planned(self) -> int:
        """Model updates of the whole run."""
        return self.training.updates_per_observation * self.exploration.steps

    def observations_needed(self, update: int) -> int:
        """Observations that update number `update`, from 0, draws its batches from: all so far when it may be made.

        A function of the update alone, so that what is learned does not depend on how fast anything else goes.
        """
        training, steps = self.training, self.exploration.steps
        ratio = training.updates_per_observation
        proportional = ratio * (steps - training.first_update_at)
        return steps if update >= proportional else training.first_update_at + update // ratio

    def updates_due(self, observations: int) -> int:
        """Model updates that so many observations call for: none before learning starts, all when exploring is over."""
        training = self.training
        if observations >= self.exploration.steps:
            return self.updates_planned
        return training.updates_per_observation * max(0, observations + 1 - training.first_update_at)

    def updates_awaited(self, observations: int) -> int:
        """Model updates that the planner waits for with so many observations, less training/max_lag.

        What the newest observation calls for is learned while the arm moves on; when exploring is over, all of it.
        """
        return self.updates_due(observations if observations >= self.exploration.steps else observations - 1)

    @classmethod
    def from_dict(cls, values: Dict[str, Any]) -> Config:
        """Sections of keys -> Config. Raises ConfigError naming the key, the value and what is legal."""
        if not isinstance(values, dict):
            raise ConfigError(f"the configuration is {type(values).__name__}, not sections of keys")
        sections = {section.name: section.default_factory for section in dataclasses.fields(cls)}
        _refuse_unknown(values, sections, "section")
        return cls(**{name: _build_section(sections[name], name, keys) for name, keys in values.items()})

    def to_dict(self) -> Dict[str, Any]:
        """Plain sections of keys, ready for YAML; tuples become lists."""
        return {
            name: {key: list(value) if isinstance(value, tuple) else value for key, value in section.items()}
            for name, section in dataclasses.asdict(self).items()
        }


def load_profile(path: Path) -> Dict[str, Any]:
    """Sections of keys that a YAML profile sets. Raises ConfigError when the file is missing or is no such thing."""
    values = _PROFILE_READER.read_yaml(Path(path))
    return {section: {} if keys is None else keys for section, keys in values.items()}


def merge(base: Dict[str, Any], overrides: Dict[str, Any]) -> Dict[str, Any]:
    """Sections of keys in which the overrides win; neither argument is changed."""
    merged = dict(base)
    for name, keys in overrides.items():
        below = merged.get(name, {})
        merged[name] = {**below, **keys} if isinstance(below, dict) and isinstance(keys, dict) else keys
    return merged


def settings(config_class: type = Config) -> Iterator[Tuple[str, dataclasses.Field]]:
    """Every (section, field) in the order of declaration: what the parameter table is made of."""
    for section in dataclasses.fields(config_class):
        for item in dataclasses.fields(section.default_factory):
            yield section.name, item


def legal_values(item: dataclasses.Field) -> str:
    """The legal values of a field in words; empty when everything of its type is legal."""
    low, high, choices = item.metadata["low"], item.metadata["high"], item.metadata["choices"]
    if choices:
        return " | ".join(choices)
    if math.isinf(low) and math.isinf(high):
        return ""
    return f"{low:g} .. {high:g}"


def _refuse_unknown(given: Dict[str, Any], known: Dict[str, Any], kind: str, section: str = "") -> None:
    for key in given:
        if key not in known:
            text = str(key)[:_LONGEST_KEY]
            nearest = difflib.get_close_matches(text, list(known), n=1, cutoff=0.4)
            hint = f"did you mean {section}{nearest[0]}?" if nearest else f"known: {', '.join(known)}"
            raise ConfigError(f"unknown {kind} {section}{text}: {hint}")


def _build_section(section_class: type, name: str, keys: Any) -> Any:
    if not isinstance(keys, dict):
        raise ConfigError(f"section {name} is {keys!r}: give keys and values")
    known = {item.name: item for item in dataclasses.fields(section_class)}
    _refuse_unknown(keys, known, "key", f"{name}/")
    return section_class(**{key: _check(f"{name}/{key}", known[key], value) for key, value in keys.items()})


def _check(key: str, item: dataclasses.Field, value: Any) -> Any:
    """The value in the field's own type, or ConfigError."""
    default = item.default
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or not value:
            raise ConfigError(f"{key} is {value!r}: give a list of numbers")
        return tuple(_check_number(key, item, part, type(default[0])) for part in value)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{key} is {value!r}: give true or false")
        return value
    if isinstance(default, str):
        return _check_text(key, item, value)
    return _check_number(key, item, value, type(default))


def _check_text(key: str, item: dataclasses.Field, value: Any) -> str:
    if not isinstance(value, str):
        raise ConfigError(f"{key} is {value!r}: give a text")
    choices = item.metadata["choices"]
    if choices and value not in choices:
        nearest = difflib.get_close_matches(value, choices, n=1)
        hint = f"did you mean {nearest[0]}? " if nearest else ""
        raise ConfigError(f"{key} is {value!r}: {hint}legal are {', '.join(choices)}")
    return value


def _check_number(key: str, item: dataclasses.Field, value: Any, kind: type) -> Any:
    whole = kind is int
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float))
        or not math.isfinite(value)
        or (whole and value != int(value))
    ):
        raise ConfigError(f"{key} is {value!r}: give a {'whole ' if whole else ''}number")
    low, high = item.metadata["low"], item.metadata["high"]
    if not low <= value <= high:
        unit = f" {item.metadata['unit']}" if item.metadata["unit"] else ""
        raise ConfigError(f"{key} is {value!r}: legal is {low:g} to {high:g}{unit}")
    return kind(value)


def find_profile(name_or_path: str, folder: Optional[Path]) -> Path:
    """A profile by name in the given folder, or by path. Raises ConfigError listing what there is."""
    path = Path(os.path.expanduser(name_or_path))
    if path.suffix in (".yaml", ".yml"):
        return path
    known = sorted(candidate.stem for candidate in folder.glob("*.yaml")) if folder else []
    if name_or_path not in known:
        raise ConfigError(
            f"unknown profile {name_or_path!r}: there are {', '.join(known)}; or give the path of a YAML file"
        )
    return folder / f"{name_or_path}.yaml"
