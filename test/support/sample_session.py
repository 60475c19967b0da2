"""A small session with one of every file that the package writes, and of every file that users write (in user/)."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Callable, Dict, NamedTuple, Type

import cv2
import numpy as np
import torch
import yaml

from embodied_active_learning.config import Config, load_profile
from embodied_active_learning.errors import ConfigError, CorruptFileError, EmbodiedActiveLearningError, WorldError
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.learner_state import NETWORK
from embodied_active_learning.objects.fingerprint import OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.limits import Calibration
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.session.arm_states import ArmStates
from embodied_active_learning.session.checkpoints import load_latest, save_checkpoint, save_model
from embodied_active_learning.session.conclusion import summarise
from embodied_active_learning.session.fingerprints import load_fingerprints, save_fingerprints
from embodied_active_learning.session.identifications import (
    load_beliefs,
    load_identification,
    load_trace,
    save_identification,
)
from embodied_active_learning.session.planner_state import PlannerState, load_planner_state, save_planner_state
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model
from embodied_active_learning.session.summary import read_summary, write_summary
from embodied_active_learning.simulation.table_picture import TablePicture
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.state_dict import add_prefix

NAME = "sample"
OBSERVATIONS = 4
VALUES = {
    "camera": {"width": 12, "height": 12},
    "model": {"latent_size": 2, "hidden_sizes": [4], "channels": [2], "kernels": [3], "strides": [3]},
    "training": {"batch_size": 2, "first_update_at": 2},
    "exploration": {"steps": OBSERVATIONS, "samples": 20, "fresh_samples": 2},
    "fingerprint": {"trials": 3},
    "identification": {"cells": [4, 4, 4]},
}


class Kind(NamedTuple):
    """One kind of file: its path below the sample, how it is read, and the error if it is invalid."""

    path: str
    read: Callable[[Path], Any]  # of the sample's folder; returns comparable values
    remedy: str = ""  # in every error message about it
    limit: int = 2**18  # largest file that is read [bytes]
    error: Type[EmbodiedActiveLearningError] = CorruptFileError
    checked: bool = True  # whether changed content is detected; users' files have no checksum


def configuration(root: Path, **session: Any) -> Config:
    """Return the configuration of the sample."""
    return Config.from_dict({**VALUES, "session": {"root": str(root), "name": NAME, **session}})


def observation(index: int) -> tuple:
    """Return index, stamp, state and image of an observation."""
    random = np.random.default_rng(index)
    state = random.uniform((0.33, -0.14, -1.9), (0.62, 0.14, 1.9))
    return index, 0.2 * index, state, random.integers(0, 256, (12, 12, 3), dtype=np.uint8)


def network(config: Config) -> ConditionalVAE:
    """Return the network of a configuration."""
    torch.manual_seed(3)
    return ConditionalVAE((config.camera.height, config.camera.width), 3, config.model)


def fingerprints(config: Config, number: int = 1) -> FingerprintSet:
    """Return a set of one fingerprint with two views."""
    random = np.random.default_rng(number)
    item = Fingerprint(
        name="object-1",
        kind=OBJECT,
        centre=np.array([0.5, 0.0, 0.0]),
        states=random.uniform((0.4, -0.1, -1.0), (0.5, 0.1, 1.0), (2, 3)),
        images=random.integers(0, 256, (2, 12, 12, 3), dtype=np.uint8),
        latent_means=random.normal(size=(2, 2)).astype(np.float32),
        latent_stds=np.ones((2, 2), np.float32),
        importance=0.5,
        calibration=Calibration(np.linspace(0.3, 0.7, 5), np.linspace(-0.1, 0.5, 5)),
    )
    weights = network(config).state_dict()
    return FingerprintSet(NAME, number, OBSERVATIONS, "2026-11-22T12:45:00Z", config, weights, (item,))


def make_sample(root: Path) -> Path:
    """Write the sample below a folder; return the session's folder."""
    config = configuration(root)
    weights = network(config).state_dict()
    with Session.open_for_writing(config) as session:
        with session.open_observations() as store:
            for index in range(OBSERVATIONS):
                store.append(*observation(index))
            states, images = store.raw_states, store.images
        for name, column in (("exploration", "step"), ("training", "update"), ("evaluation", "update")):
            with session.open_table(name) as table:
                for number in range(1, 4):
                    table.append({column: number, "coverage": number / 7} if name != "evaluation" else {column: number})
        tensors = add_prefix(NETWORK, weights)
        save_checkpoint(session.paths.checkpoints, 3, OBSERVATIONS, tensors, {"updates": 3})
        save_model(session.paths.model, weights, {"updates": 3, "observations": OBSERVATIONS})
        save_fingerprints(session.paths.path, fingerprints(config))
        search = Identification([fingerprints(config)], config.workspace.box(), config.camera, config.identification)
        search.observe(states, images)
        save_identification(session.paths.path, "first", search, search.decide(states, images))
        run = ExplorationRun(config).state_dict()
        save_planner_state(session.paths.path / "planner.safetensors", _planner_state(run))
        _write_arm_states(session.paths.arm_states)
        write_summary(session.paths.summary, summarise(session, True, 1.5))
    _write_user_files(session.paths.path / "user")
    return session.paths.path


def _planner_state(run: Dict[str, np.ndarray]) -> PlannerState:
    return PlannerState(2, (1, 5), np.array([0.4, 0.1, 0.2]), np.zeros(3), run)


def _write_arm_states(path: Path) -> None:
    states = ArmStates(path)
    for second in range(3):
        states.add((second, 5), {"steps": np.array([second / 7.0]), "joints": np.arange(7.0) / 7.0})
    states.write()


def _arm_states(path: Path) -> Any:
    states = ArmStates(path / "arm_states.safetensors")
    states.load()
    return [_plain(states.at((second, 5))) for second in range(3)] if states.stamps else None


def _write_user_files(folder: Path) -> None:
    folder.mkdir()
    mesh = "".join(f"v {x} {y} {z}\n" for x in (0, 0.01) for y in (0, 0.01) for z in (0, 0.01)) + "f 2 6 8\n"
    (folder / "thing.obj").write_text(mesh)
    visual = '<visual><geometry><mesh filename="thing.obj"/></geometry></visual>'
    (folder / "thing.urdf").write_text(f'<robot name="a"><link name="a">{visual}</link></robot>\n')
    cv2.imwrite(str(folder / "table.png"), np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    world = {"table": {"texture": "table.png"}, "objects": {"a": {"urdf": "thing.urdf", "position": [0.45, 0.0]}}}
    (folder / "world.yaml").write_text(yaml.safe_dump(world))
    (folder / "profile.yaml").write_text(yaml.safe_dump(VALUES))


def _plain(value: Any) -> Any:
    """Return arrays and tensors as bytes, which can be compared."""
    if dataclasses.is_dataclass(value):
        value = vars(value)
    if isinstance(value, torch.Tensor):
        value = value.numpy()
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value


def _observations(path: Path) -> Any:
    with Session.open_read_only(path).open_observations() as store:
        return [_plain([array[index] for array in store.snapshot()]) for index in range(len(store))]


def _checkpoint(path: Path) -> Any:
    found = load_latest(path / "checkpoints")
    return found and (found.updates, found.counters, _plain(found.tensors))


def _stored_planner_state(path: Path) -> Any:
    found = load_planner_state(path / "planner.safetensors")
    return found and _plain(found)


def _set(path: Path) -> Any:
    found = load_fingerprints(path)
    return found.session, found.updates, found.created, _plain(found.weights), _plain(found.fingerprints)


def _world(path: Path) -> Any:
    world = load_world(str(path / "user" / "world.yaml"), Config().workspace.box())
    return repr(world.objects), repr(world.disturbances), _plain(TablePicture(world.table)._texture)


def _decisions(path: Path) -> Any:
    found = load_identification(path, "first")
    return found.name, found.session, found.images, _plain(found.decisions)


def _table(name: str) -> Callable[[Path], Any]:
    return lambda path: _plain(Session.open_read_only(path).read_table(name))


_GENERATION = "fingerprints/000001"
_FIRST = "identification/first"
_TRAIN = "restore the file, or train again"
_FINGERPRINT = "restore it, or fingerprint the session again"
_IDENTIFY = "identify again"
_OTHER_SESSION = "choose another session"
KINDS = (
    Kind("config.yaml", lambda path: Session.open_read_only(path).config.to_dict(), f"restore it, or {_OTHER_SESSION}"),
    Kind("summary.yaml", lambda path: vars(read_summary(path / "summary.yaml")), "resume the run"),
    Kind("observations/format.json", _observations, f"restore the file, or {_OTHER_SESSION}", 2**16),
    Kind("observations/observations.bin", _observations, "restore the file, or start a new session"),
    Kind("exploration.csv", _table("exploration"), _OTHER_SESSION, 2**28, checked=False),
    Kind("training.csv", _table("training"), _OTHER_SESSION, 2**28, checked=False),
    Kind("evaluation.csv", _table("evaluation"), _OTHER_SESSION, 2**28, checked=False),
    Kind("checkpoints/checkpoint_000000003.safetensors", _checkpoint, _TRAIN, 2**32),
    Kind(
        "model.safetensors",
        lambda path: _plain(load_session_model(Session.open_read_only(path)).weights),
        _TRAIN,
        2**32,
    ),
    Kind(
        "planner.safetensors",
        _stored_planner_state,
        "delete it; the planner then resumes from the stored observations",
        2**30,
    ),
    Kind("arm_states.safetensors", _arm_states, "delete it; the arm then cannot return to states before", 2**24),
    Kind(f"{_GENERATION}/set.yaml", _set, _FINGERPRINT),
    Kind(f"{_GENERATION}/model.safetensors", _set, _FINGERPRINT, 2**32),
    Kind(f"{_GENERATION}/object-1/fingerprint.safetensors", _set, _FINGERPRINT, 2**30),
    Kind(f"{_GENERATION}/object-1/calibration.safetensors", _set, _FINGERPRINT),
    Kind(f"{_FIRST}/decisions.yaml", _decisions, _IDENTIFY),
    Kind(f"{_FIRST}/trace.safetensors", lambda path: _plain(load_trace(path, "first")), _IDENTIFY, 2**32),
    Kind(f"{_FIRST}/beliefs.safetensors", lambda path: _plain(load_beliefs(path, "first")), _IDENTIFY, 2**32),
    Kind(
        "user/profile.yaml",
        lambda path: Config.from_dict(load_profile(path / "user" / "profile.yaml")).to_dict(),
        error=ConfigError,
        checked=False,
    ),
    Kind("user/world.yaml", _world, error=WorldError, checked=False),
    Kind("user/thing.urdf", _world, limit=2**20, error=WorldError, checked=False),
    Kind("user/thing.obj", _world, limit=2**27, error=WorldError, checked=False),
    Kind("user/table.png", _world, limit=2**26, error=WorldError, checked=False),
)
