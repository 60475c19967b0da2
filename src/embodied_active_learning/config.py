"""The configuration of a run as frozen dataclasses, and the profiles that fill them.

Units, ranges, legal values and defaults are declared here only: config/default.yaml, docs/parameters.md and the ROS
parameters derive from this module.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Dict, Optional, Tuple

from embodied_active_learning.errors import ConfigError
from embodied_active_learning.files import FileReader
from embodied_active_learning.hardware_config import (
    FRANKA,
    REAL_ROBOTS,
    RECORDED,
    SIMULATED,
    VELOCITY_SERVICE,
    ArmConfig,
    CameraConfig,
    FrankaConfig,
    SimulationConfig,
    WorkspaceConfig,
)
from embodied_active_learning.registry import EXPLORERS, INFORMATION_MEASURES
from embodied_active_learning.schema import build, check_keys, setting, suggestion, to_plain
from embodied_active_learning.update_plan import UpdatePlan
from embodied_active_learning.workspace import STATE_NAMES

__all__ = [
    "FRANKA",
    "REAL_ROBOTS",
    "RECORDED",
    "SIMULATED",
    "VELOCITY_SERVICE",
    "ArmConfig",
    "CameraConfig",
    "FrankaConfig",
    "WorkspaceConfig",
]
CONFIG_VERSION = 6
"""Version of the configuration in sessions, records and bags. Raise it if a key is renamed or removed; a new key needs
no other version, because it gets its default."""
# Choices of settings: fingerprint/clustering, and identification/features, decision, evidence and candidates_from.
TABLE, CAMERA = CLUSTERINGS = ("table", "camera")
LATENTS, PIXELS = FEATURES = ("latents", "pixels")
VERIFIED, BELIEF = DECISIONS = ("verified", "belief")
TEMPERED, COUNTED = EVIDENCE = ("tempered", "counted")
FROM_IMAGES, FROM_BELIEF = CANDIDATE_SOURCES = ("images", "belief")
_DIMENSIONS = len(STATE_NAMES)
_PROFILE_READER = FileReader(ConfigError, "a profile has sections of keys as in config/default.yaml", follow=True)


@dataclass(frozen=True)
class ModelConfig:
    """The conditional variational autoencoder (paper, Table 2)."""

    latent_size: int = setting(16, "number of latent variables", "", 1, 1024, fixed=True)
    hidden_sizes: Tuple[int, ...] = setting(
        (512, 256), "fully connected layers of the encoder, mirrored by the decoder", "", 1, 8192, fixed=True
    )
    channels: Tuple[int, ...] = setting((10, 10, 20), "filters of the convolutions", "", 1, 512, fixed=True)
    kernels: Tuple[int, ...] = setting((3, 3, 5), "kernel sizes of the convolutions", "px", 1, 31, fixed=True)
    strides: Tuple[int, ...] = setting((2, 2, 3), "strides of the convolutions", "px", 1, 31, fixed=True)

    def __post_init__(self) -> None:
        """Check that each convolution has filters, a kernel and a stride, and uses all pixels."""
        if not len(self.channels) == len(self.kernels) == len(self.strides):
            raise ConfigError("channels, kernels and strides differ in length: give one number per convolution")
        for kernel, stride in zip(self.kernels, self.strides):
            if stride > kernel:
                raise ConfigError(
                    f"stride {stride} is larger than kernel {kernel}: the convolution skips pixels; use a smaller one"
                )


@dataclass(frozen=True)
class ObjectiveConfig:
    """The loss and its weights beta and gamma (paper, Sec. 4, loss formulation, and Alg. 1)."""

    chi: float = setting(
        4.0, "scale of the latent regularisation: log10 beta = -log10(min h / max h) - chi", "", 0.0, 20.0
    )
    beta_max: float = setting(0.01, "upper limit of beta", "", 0.0, 1e6)
    gamma_weight: float = setting(0.1, "gamma divided by the workspace coverage k; 0 disables the term", "", 0.0, 100.0)
    schedule_every: int = setting(25, "interval between evaluations of beta and gamma", "updates", 1, 100000)
    schedule_window: int = setting(25, "evaluations in the moving average of beta and gamma", "", 1, 100000)


@dataclass(frozen=True)
class TrainingConfig:
    """Online training (paper, appendix)."""

    batch_size: int = setting(64, "observations in a mini-batch", "", 2, 65536)
    learning_rate: float = setting(1e-3, "learning rate of Adam", "", 1e-8, 1.0)
    first_update_at: int = setting(64, "observations before the first update", "", 1, 1000000)
    start_at_mean_colour: bool = setting(
        True, "initialise the decoder's output with the mean colour of the first observations instead of black"
    )
    updates_per_observation: int = setting(3, "model updates per observation", "", 0, 1000)
    max_lag: int = setting(
        0, "pending updates up to which the planner does not wait for the trainer; 0 is lock-step", "updates", 0, 10**6
    )
    device: str = setting("auto", "device of the model", choices=("auto", "cpu", "cuda"))
    threads: int = setting(
        0, "CPU threads of each trainer; 0 uses all cores, or an equal share of them with several trainers", "", 0, 1024
    )
    trainers: int = setting(1, "trainers that share the updates; all but the first are workers", "", 1, 64)
    updates_per_round: int = setting(
        25, "updates that each of several trainers makes before their weights are averaged", "updates", 1, 10000
    )
    worker_timeout: float = setting(
        30.0, "time that a round waits for a worker after the trainer's own updates", "s", 0.1, 3600.0
    )
    evaluate_every: int = setting(
        300, "interval between evaluations on a random subset of the observations", "updates", 1, 1000000
    )
    evaluation_size: int = setting(256, "observations in the subset", "", 2, 65536)
    checkpoint_every: int = setting(600, "interval between checkpoints", "updates", 1, 1000000)
    checkpoints_kept: int = setting(2, "number of checkpoints kept", "", 1, 1000)


@dataclass(frozen=True)
class ExplorationConfig:
    """The exploration, and the samples that measure coverage."""

    explorer: str = setting("ergodic", "exploration strategy, or module:Class", choices=EXPLORERS, fixed=True)
    measure: str = setting(
        "conditional_entropy",
        "information measure that becomes the target, or module:function",
        choices=INFORMATION_MEASURES,
    )
    steps: int = setting(
        3000, "exploration steps, one observation each; an upper limit with stop: stable", "", 1, 1000000
    )
    stop: str = setting(
        "fixed",
        "when exploration ends: after all steps (fixed), or as soon as the learned objects no longer change (stable)",
        choices=("fixed", "stable"),
    )
    seed: int = setting(0, "random seed", "", 0, 2**31 - 1, fixed=True)
    step_duration: float = setting(0.2, "time between observations", "s", 0.01, 10.0)
    samples: int = setting(1000, "workspace samples S", "", 10, 100000)
    fresh_samples: int = setting(100, "samples redrawn at each step, at most all", "", 0, 100000)
    sample_box: float = setting(1.0, "size of the sampled box, relative to the workspace", "", 1.0, 2.0)
    kernel_variance: float = setting(
        0.0,
        "variance of the coverage kernel, normalised units; 0: rule of the authors' code, 0.0576 at S = 1000",
        "",
        0,
        4,
    )
    authors_coverage: bool = setting(
        False, "coverage as in the authors' controller: divided by its maximum, 1 outside the workspace"
    )


@dataclass(frozen=True)
class PlannerConfig:
    """KL-ergodic receding-horizon control (paper, Sec. 2.3)."""

    horizon: int = setting(10, "planned steps", "", 2, 200)
    iterations: int = setting(3, "plan improvements per step", "", 1, 100)
    control_weight: float = setting(10.0, "control weight R in the adjoint update", "", 1e-6, 1e9)
    acceleration_limit: float = setting(1.0, "control limit, velocity units per second", "", 1e-3, 100.0)
    velocity_limits: Tuple[float, ...] = setting(
        (1.25, 1.25, 0.625),
        "velocity of each axis at the arm's top speed, in the controller's units",
        "",
        1e-3,
        100.0,
        length=_DIMENSIONS,
    )
    barrier_weight: float = setting(5.0, "weight of the barrier", "", 0.0, 1e6)
    barrier_power: float = setting(4.0, "power of the barrier", "", 1.0, 10.0)
    barrier_margin: float = setting(0.1, "normalised distance from a limit where the barrier begins", "", 0.0, 0.9)
    random_candidates: int = setting(8, "random two-segment plans that compete at each step", "", 0, 1000)
    normalise_kernels: bool = setting(True, "divide each kernel by its mass inside the workspace")
    measured_velocity_weight: float = setting(
        0.5, "share of the velocity tracking error that is fed back into the plan", "", 0.0, 1.0
    )


@dataclass(frozen=True)
class FingerprintConfig:
    """Detection of learned objects in the conditional entropy, and their views (paper, appendix)."""

    clustering: str = setting(
        TABLE,
        "what is clustered: salient table points, or camera positions (paper; needs a bandwidth near 0.09 m)",
        choices=CLUSTERINGS,
    )
    latents: int = setting(10, "latents over which the predicted standard deviation is averaged", "", 1, 1000)
    samples: int = setting(1000, "importance samples of the conditional entropy", "", 50, 100000)
    exponent: float = setting(3.0, "exponent of the standard deviation in the sample weights", "", 0.1, 20.0)
    bandwidth: float = setting(0.045, "bandwidth of mean-shift clustering", "m", 0.005, 0.5)
    min_share: float = setting(0.005, "smallest share of the clustered points in an object's cluster", "", 0.0, 1.0)
    merge_distance: float = setting(0.05, "distance below which two centres are merged", "m", 0.0, 0.5)
    prints: bool = setting(False, "whether things in the plane of the table, such as prints and cards, are objects")
    min_contrast: float = setting(
        1.2, "smallest ratio of largest to smallest predicted standard deviation with objects", "", 1.0, 100.0
    )
    views: int = setting(20, "views of each object", "", 2, 1000)
    view_std: float = setting(0.03, "standard deviation of the views around the centre, in x and y", "m", 1e-3, 0.5)
    view_yaw_std: float = setting(2.8, "standard deviation of the views' yaw", "rad", 0.01, 100.0)
    view_box: float = setting(0.06, "largest distance of a view from the centre, in x and y", "m", 0.005, 0.5)
    steps_per_view: int = setting(3, "arm steps per view kept", "", 1, 100)
    min_view_distance: float = setting(
        0.012, "views closer than this, and than min_view_turn, are duplicates", "m", 0.0, 0.1
    )
    min_view_turn: float = setting(0.8, "smallest yaw between two views at one place", "rad", 0.0, 3.0)
    trials: int = setting(39, "simulated places and look-alikes from which a fingerprint sets its limits", "", 1, 10000)


@dataclass(frozen=True)
class IdentificationConfig:
    """Search for fingerprints in new images (paper, appendix), and the decision whether one is found."""

    features: str = setting(
        LATENTS,
        "features that are compared: latents of the model, or 30 x 30 pixels as a baseline without a model",
        choices=FEATURES,
    )
    decision: str = setting(
        VERIFIED,
        "criterion: views of each candidate, with limits set by the fingerprint (verified), or min_belief (belief)",
        choices=DECISIONS,
    )
    evidence: str = setting(
        TEMPERED,
        "weight of an image: shared among the images from one place (tempered), or 1 each (counted)",
        choices=EVIDENCE,
    )
    independence_distance: float = setting(0.01, "distance at which two images count as independent", "m", 1e-4, 1.0)
    independence_turn: float = setting(0.2, "yaw at which two images count as independent", "rad", 1e-3, 10.0)
    near_variance: float = setting(0.156, "variance of a measurement at the place it refers to", "", 1e-6, 1e6)
    far_pull: float = setting(
        0.02,
        "information of a measurement about distant cells, relative to its own place; pulls unseen cells to the mean",
        "",
        1e-6,
        1.0,
    )
    kernel_std: float = setting(0.042, "standard deviation of a measurement's footprint in x and y", "m", 1e-3, 0.5)
    kernel_yaw_std: float = setting(0.56, "standard deviation of a measurement's footprint in yaw", "rad", 0.01, 10.0)
    cells: Tuple[int, ...] = setting(
        (40, 40, 18), "cells of a belief grid in x, y and yaw", "", 4, 500, length=_DIMENSIONS
    )
    margin: float = setting(0.0225, "extent of the searched area beyond the workspace", "m", 0.0, 0.5)
    candidates_from: str = setting(
        FROM_IMAGES,
        "candidates of decision verified: places that look like the object (images), or peaks of the belief (belief)",
        choices=CANDIDATE_SOURCES,
    )
    candidates: int = setting(8, "largest number of candidates", "", 1, 1000)
    separation: float = setting(0.06, "smallest distance between two objects", "m", 0.005, 1.0)
    min_belief: float = setting(0.5, "smallest mean belief of an object found by decision: belief", "", 0.0, 1.0)
    error_rate: float = setting(
        0.05, "accepted rate of errors: objects missed, and look-alikes taken for the object", "", 0.001, 0.5
    )
    view_distance: float = setting(0.045, "largest distance of a compared view from the candidate", "m", 0.005, 0.5)
    views: int = setting(5, "largest number of compared views of a candidate", "", 3, 1000)
    min_coverage: float = setting(
        0.95, "share of the workspace that must be seen before an object is reported as absent", "", 0.0, 1.0
    )
    stop_when_decided: bool = setting(
        True, "process no more images once they would change no decision (decision verified only)"
    )
    visit: bool = setting(False, "at the end, drive to every found, undecided and unknown object and take a picture")


@dataclass(frozen=True)
class SessionConfig:
    """The folder of the run."""

    name: str = setting("", "name of the session folder; empty: made of world, explorer, seed and time")
    root: str = setting("~/.ros/embodied_active_learning", "folder of all sessions")
    resume: bool = setting(False, "continue the session of that name")
    pdf_figures: bool = setting(False, "write each figure as PDF too")


@dataclass(frozen=True)
class Config:
    """The configuration of a run."""

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
        """Check relations between settings. Raises ConfigError."""
        box, training, steps = self.workspace.box(), self.training, self.exploration.steps
        start = list(self.simulation.start)
        physics_steps = self.exploration.step_duration * self.simulation.physics_rate
        problems = (
            (
                self.arm.robot == SIMULATED and not box.contains(start),
                f"simulation/start {start} is outside the workspace: move it, or enlarge the workspace",
            ),
            (
                self.arm.robot == SIMULATED and self.camera.latency > 0.0,
                f"camera/latency is {self.camera.latency:g} s, but the simulated camera has none: set it to 0",
            ),
            (
                self.arm.robot == SIMULATED and not _is_whole(physics_steps),
                f"exploration/step_duration is {self.exploration.step_duration:g} s, {physics_steps:g} physics steps "
                f"(simulation/physics_rate {self.simulation.physics_rate}): set it to a whole number of steps",
            ),
            (
                self.exploration.step_duration > self.arm.max_duration,
                "exploration/step_duration is longer than arm/max_duration: the arm would reject every command",
            ),
            (
                training.batch_size > training.first_update_at,
                "training/batch_size is larger than training/first_update_at: the first batch could not be filled",
            ),
            (
                training.updates_per_observation > 0 and steps < training.first_update_at,
                f"exploration/steps is {steps}, fewer than training/first_update_at ({training.first_update_at}): "
                "nothing would be learned",
            ),
        )
        for wrong, message in problems:
            if wrong:
                raise ConfigError(message)

    @property
    def may_stop_early(self) -> bool:
        """Whether the run ends before its last step if the learned objects are stable."""
        return self.exploration.stop == "stable" and self.training.updates_per_observation > 0

    def with_steps(self, steps: int) -> Config:
        """Return this configuration with another number of steps."""
        return replace(self, exploration=replace(self.exploration, steps=steps))

    @property
    def update_plan(self) -> UpdatePlan:
        """When the updates of the model are due."""
        training = self.training
        several = training.trainers > 1 and training.updates_per_observation > 0
        return UpdatePlan(
            steps=self.exploration.steps,
            first_update_at=training.first_update_at,
            per_observation=training.updates_per_observation,
            per_refresh=training.trainers * training.updates_per_round if several else training.updates_per_observation,
        )

    @classmethod
    def from_dict(cls, values: Dict[str, Any], subject: Any = "", stored: bool = False) -> Config:
        """Build a configuration from sections of keys.

        Args:
            values: Sections of keys.
            subject: Origin of the values for messages, usually a path.
            stored: The values are of an earlier run, whose explorer and the like need not be registered now.

        Raises:
            ConfigError: Names subject, key and legal values.
        """
        return build(cls, values, subject, stored=stored)

    def to_dict(self) -> Dict[str, Any]:
        """Return sections of keys as plain data; tuples become lists."""
        return to_plain(self)

    def portable(self) -> Dict[str, Any]:
        """Return sections of keys without this computer's paths: no section session, the world by name."""
        sections = self.to_dict()
        del sections["session"]
        sections["simulation"]["world"] = Path(self.simulation.world).stem
        return sections


def _is_whole(number: float) -> bool:
    """Return whether a positive number is whole, up to rounding, and at least 1."""
    return round(number) >= 1 and abs(number - round(number)) <= 1e-6 * number


def load_profile(path: Path) -> Dict[str, Any]:
    """Read the sections of keys that a YAML profile sets. Raises ConfigError naming the file and the key."""
    values = _PROFILE_READER.read_yaml(Path(path))
    sections = {name: {} if keys is None else keys for name, keys in values.items()}
    return check_keys(Config, sections, path)


def find_profile(name_or_path: str, folder: Optional[Path]) -> Path:
    """Return the path of a profile given by name in a folder, or by path. Raises ConfigError listing the names."""
    path = Path(os.path.expanduser(name_or_path))
    if path.suffix in (".yaml", ".yml"):
        return path
    known = sorted(candidate.stem for candidate in folder.glob("*.yaml")) if folder else []
    if folder is None or name_or_path not in known:
        raise ConfigError(
            f"unknown profile {name_or_path!r}: {suggestion(name_or_path, known)}; or give the path of a YAML file"
        )
    return folder / f"{name_or_path}.yaml"


def merge(base: Dict[str, Any], overrides: Dict[str, Any]) -> Dict[str, Any]:
    """Return sections of keys in which the overrides take precedence; the arguments are not modified."""
    merged = dict(base)
    for name, keys in overrides.items():
        below = merged.get(name, {})
        merged[name] = {**below, **keys} if isinstance(below, dict) and isinstance(keys, dict) else keys
    return merged
