"""Trained models: same results as the network, and loading from a session."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, ObservationError
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.session.checkpoints import save_checkpoint, save_model
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model

VALUES = {"camera": {"width": 48, "height": 45}, "model": {"latent_size": 4, "hidden_sizes": [32, 16]}}
CONFIG = Config.from_dict(VALUES)
COUNT = 70  # more images than one forward pass takes


def make_network(config=CONFIG, seed=0):
    torch.manual_seed(seed)
    network = ConditionalVAE((config.camera.height, config.camera.width), 3, config.model)
    with torch.no_grad():
        for parameter in network.parameters():  # larger weights, so that no output is nearly constant
            parameter.mul_(1.7)
    return network


def normalised(states):
    return torch.from_numpy(CONFIG.workspace.box().normalise(states).astype(np.float32))


@pytest.fixture(scope="module")
def network():
    return make_network()


@pytest.fixture(scope="module")
def model(network):
    return TrainedModel(CONFIG, network.state_dict())


@pytest.fixture(scope="module")
def data():
    """States (N, 3) in SI units, and as many images."""
    random, box = np.random.default_rng(0), CONFIG.workspace.box()
    states = random.uniform(box.lower, box.upper, (COUNT, 3))
    return states, random.integers(0, 256, (COUNT, 45, 48, 3), dtype=np.uint8)


def test_encode_matches_network_at_normalised_states(network, model, data):
    states, images = data
    with torch.no_grad():
        expected = network.encode(normalised(states), torch.from_numpy(images))
    mean, std = model.encode(states, images)
    np.testing.assert_allclose(mean, expected.mean, atol=1e-5)
    np.testing.assert_allclose(std, expected.std, atol=1e-5)
    assert np.ptp(mean, axis=0).max() > 0.05
    assert mean.dtype == std.dtype == np.float32
    assert mean.shape == std.shape == (COUNT, model.latent_size) == (COUNT, 4)


def test_decode_matches_network_clipped_to_0_and_1(network, model, data):
    states, _ = data
    latents = 3.0 * np.random.default_rng(1).standard_normal((COUNT, 4)).astype(np.float32)
    with torch.no_grad():
        expected, log_std = network.decode(torch.from_numpy(latents), normalised(states))
    images, std = model.decode(latents, states)
    assert images.shape == (COUNT, 45, 48, 3)
    assert expected.min() < 0.0
    np.testing.assert_allclose(images, expected.clamp(0.0, 1.0).permute(0, 2, 3, 1), atol=1e-5)
    np.testing.assert_allclose(std, log_std.exp(), rtol=1e-4)


def test_log_std_matches_network_for_all_pairs(network, model, data):
    states, _ = data
    latents = 3.0 * np.random.default_rng(1).standard_normal((5, 4)).astype(np.float32)
    found = model.log_std(latents, states)
    assert found.shape == (5, COUNT)
    with torch.no_grad():
        for row, latent in zip(found, torch.from_numpy(latents)):
            _, expected = network.decode(latent.expand(COUNT, -1), normalised(states))
            np.testing.assert_allclose(row, expected, atol=1e-5)


def test_log_std_of_many_states_matches_few(model):
    random, box = np.random.default_rng(2), CONFIG.workspace.box()
    states = random.uniform(box.lower, box.upper, (9000, 3))
    found = model.log_std(np.ones((1, 4), np.float32), states)
    assert found.shape == (1, 9000)
    np.testing.assert_allclose(found[:, ::1000], model.log_std(np.ones((1, 4), np.float32), states[::1000]), atol=1e-5)


@pytest.mark.parametrize(("images", "states"), [(1, 1), (3, 50), (70, 1), (7, 70)])
def test_encode_pairs_matches_encode(model, data, images, states):
    at, seen = data[0][:states], data[1][:images]
    pairs = model.encode_pairs(at, model.image_features(seen))
    assert pairs.shape == (images, states, 4)
    for image, row in zip(seen, pairs):
        mean, _ = model.encode(at, np.repeat(image[None], states, axis=0))
        np.testing.assert_allclose(row, mean, atol=1e-5)


def test_encode_pairs_keeps_order_across_chunks(model, data):
    states = np.random.default_rng(3).uniform(-1.0, 1.0, (500, 3))
    features = model.image_features(data[1][:20])
    pairs = model.encode_pairs(states, features)
    for image, state in ((0, 0), (7, 499), (8, 0), (19, 321)):
        mean, _ = model.encode_features(states[state : state + 1], features[image : image + 1])
        np.testing.assert_allclose(pairs[image, state], mean[0], atol=1e-5)


def test_images_may_be_a_view(model, data):
    states, images = data
    mirrored = images[:3, :, ::-1]
    np.testing.assert_array_equal(model.encode(states[:3], mirrored), model.encode(states[:3], mirrored.copy()))


@pytest.mark.parametrize(
    ("images", "found"),
    [
        (np.zeros((2, 48, 45, 3), np.uint8), r"uint8 \(2, 48, 45, 3\)"),
        (np.zeros((2, 45, 48), np.uint8), r"uint8 \(2, 45, 48\)"),
        (np.zeros((45, 48, 3), np.uint8), r"uint8 \(45, 48, 3\)"),
        (np.zeros((2, 45, 48, 4), np.uint8), r"uint8 \(2, 45, 48, 4\)"),
        (np.zeros((2, 45, 48, 3), np.float32), r"float32 \(2, 45, 48, 3\)"),
    ],
)
def test_images_of_another_size_or_type_are_refused(model, images, found):
    with pytest.raises(ObservationError, match=rf"{found}, the model was trained with uint8 \(N, \*\(45, 48"):
        model.image_features(images)


def open_session(root, **sections):
    config = Config.from_dict({**VALUES, "session": {"root": str(root), "name": "a"}, **sections})
    with Session.open_for_writing(config):
        pass
    return Session.open_read_only(root / "a")


def write_checkpoint(session, updates, network):
    packed = {f"network/{name}": tensor for name, tensor in network.state_dict().items()}
    save_checkpoint(session.paths.checkpoints, updates, 10, {**packed, "adam/step": torch.zeros(())}, {})


def assert_same_weights(trained, network):
    expected = network.state_dict()
    assert set(trained.weights) == set(expected)
    for held in (trained.weights, trained.model.network.state_dict()):
        assert all(torch.equal(held[name], tensor) for name, tensor in expected.items())


def test_no_model_before_training(tmp_path):
    assert load_session_model(open_session(tmp_path)) is None


def test_model_without_updates_is_none(tmp_path):
    session = open_session(tmp_path)
    write_checkpoint(session, 0, make_network())
    assert load_session_model(session) is None
    save_model(session.paths.model, make_network().state_dict(), {"updates": 0, "observations": 10})
    assert load_session_model(session) is None


def test_newest_checkpoint_is_loaded_without_final_model(tmp_path):
    session = open_session(tmp_path)
    write_checkpoint(session, 3, make_network(seed=3))
    write_checkpoint(session, 12, make_network(seed=12))
    trained = load_session_model(session)
    assert trained.updates == 12
    assert_same_weights(trained, make_network(seed=12))


def test_final_model_is_preferred_to_checkpoints(tmp_path):
    session = open_session(tmp_path)
    write_checkpoint(session, 12, make_network(seed=12))
    save_model(session.paths.model, make_network(seed=9).state_dict(), {"updates": 9, "observations": 3})
    trained = load_session_model(session)
    assert trained.updates == 9
    assert_same_weights(trained, make_network(seed=9))


def test_loaded_model_is_in_evaluation_mode(tmp_path):
    session = open_session(tmp_path)
    write_checkpoint(session, 3, make_network())
    network = load_session_model(session).model.network
    assert not network.training
    assert not any(parameter.requires_grad for parameter in network.parameters())


@pytest.mark.parametrize(
    "section", [{"model": {"latent_size": 5, "hidden_sizes": [32, 16]}}, {"camera": {"width": 60}}]
)
@pytest.mark.parametrize("final", [True, False])
def test_model_of_another_configuration_is_refused_by_file(tmp_path, section, final):
    session = open_session(tmp_path)
    other = make_network(Config.from_dict({**VALUES, **section}))
    if final:
        save_model(session.paths.model, other.state_dict(), {"updates": 3, "observations": 3})
    else:
        write_checkpoint(session, 3, other)
    name = r"model\.safetensors" if final else r"checkpoint_000000003\.safetensors"
    with pytest.raises(CorruptFileError, match=rf"{name} does not fit the session's camera and model settings"):
        load_session_model(session)


def test_damaged_model_is_refused_despite_checkpoints(tmp_path):
    session = open_session(tmp_path)
    write_checkpoint(session, 3, make_network())
    save_model(session.paths.model, make_network().state_dict(), {"updates": 3, "observations": 3})
    content = bytearray(session.paths.model.read_bytes())
    content[-1] ^= 1
    session.paths.model.write_bytes(content)
    with pytest.raises(CorruptFileError, match=r"model\.safetensors"):
        load_session_model(session)
