"""The learner: reproducible, resumable, and answering queries while it trains."""

import json
import threading

import numpy as np
import pytest
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, CorruptFileError, DivergenceError, ObservationError
from embodied_active_learning.model import build
from embodied_active_learning.model.build import choose_device, choose_loss
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.model.learner_state import LearnerState
from embodied_active_learning.model.loss import PlainLoss
from threads import wait_for

SMALL = {
    "camera": {"width": 45, "height": 45},
    "model": {"hidden_sizes": [64, 32]},
    "training": {"batch_size": 8, "first_update_at": 8, "device": "cpu", "evaluation_size": 20},
    "exploration": {"samples": 50, "fresh_samples": 10, "steps": 40},
    "objective": {"schedule_every": 2},
}


LARGE_GENERATOR = {"bit_generator": "PCG64", "state": {"state": 2**200, "inc": 1}, "has_uint32": 0, "uinteger": 0}


class GrowingStore:
    """Observations in memory; every access copies the arrays, as when the store has grown."""

    def __init__(self, count, image_size=(45, 45)):
        random = np.random.default_rng(5)
        self._states = random.uniform(-1, 1, (200, 3)).astype(np.float32)
        self._images = random.integers(0, 256, (200, *image_size, 3), dtype=np.uint8)
        self.count = count

    def __len__(self):
        return self.count

    @property
    def states(self):
        return self._states[: self.count].copy()

    @property
    def images(self):
        images = self._images[: self.count].copy()
        images.setflags(write=False)
        return images


def make(count=30, seed=0, store=None, **sections):
    values = {name: {**SMALL.get(name, {}), **sections.get(name, {})} for name in {**SMALL, **sections}}
    return Learner(Config.from_dict(values), GrowingStore(count) if store is None else store, seed)


def weights(learner):
    return torch.cat([parameter.detach().flatten() for parameter in learner.network.parameters()])


def test_update_reports_loss_and_terms():
    report = make().update()
    expected = report.reconstruction + report.beta * report.kl + report.gamma * report.conditional_reconstruction
    assert report.loss == pytest.approx(expected, rel=1e-5)
    assert (report.update, report.observations) == (1, 8)
    assert 0.0 < report.coverage < 1.0
    assert report.gamma == pytest.approx(0.1 * report.coverage)
    assert report.log_std_min < report.log_std_max
    assert 0 <= report.active_units <= 16


def test_decoder_starts_at_mean_colour_or_black():
    at_mean, black = make(), make(training={"start_at_mean_colour": False})
    for learner in (at_mean, black):
        learner.update()
    colour = GrowingStore(30).images.mean(axis=(0, 1, 2)) / 255.0
    assert np.allclose(at_mean.network.image_decoder[-1].bias.detach().cpu(), colour, atol=0.01)
    assert np.abs(black.network.image_decoder[-1].bias.detach().cpu().numpy()).max() < 0.2


def test_training_lowers_the_loss():
    learner = make()
    losses = [learner.update().loss for _ in range(30)]
    assert losses[-1] < losses[0] - 0.3


def test_result_depends_on_seed_only():
    first, second, other = make(), make(), make(seed=1)
    for learner in (first, second, other):
        for _ in range(4):
            learner.update()
    assert torch.equal(weights(first), weights(second))
    assert not torch.equal(weights(first), weights(other))


def test_training_does_not_use_global_random_generators():
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    before = torch.random.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    learner = make()
    learner.update()
    learner.evaluate()
    assert torch.equal(before[0], torch.random.get_rng_state())
    assert np.array_equal(before[1], np.random.get_state()[1])  # noqa: NPY002


def test_resumed_training_is_bit_identical():
    straight, broken = make(), make()
    for _ in range(3):
        straight.update()
        broken.update()
    tensors, counters = broken.state_dict()
    resumed = make(seed=9)
    resumed.load_state_dict(LearnerState(tensors, json.loads(json.dumps(counters))))
    for _ in range(3):
        assert straight.update() == resumed.update()
    assert torch.equal(weights(straight), weights(resumed))
    for one, other in zip(straight.state_dict().tensors.values(), resumed.state_dict().tensors.values()):
        assert torch.equal(one, other)


def test_untrained_learner_can_be_restored():
    first, second = make(), make(seed=9)
    second.load_state_dict(first.state_dict())
    assert first.update() == second.update()


def test_state_dict_is_a_copy():
    learner = make()
    learner.update()
    tensors, _ = learner.state_dict()
    kept = {name: tensor.clone() for name, tensor in tensors.items()}
    learner.update()
    assert all(torch.equal(tensors[name], kept[name]) for name in kept)


def test_state_of_another_model_is_refused_by_tensor_name():
    learner = make(model={"latent_size": 8})
    with pytest.raises(ConfigError, match=r"network/encoder\.4\.weight"):
        make().load_state_dict(learner.state_dict())


def test_incomplete_state_is_refused_by_name():
    learner = make()
    tensors, counters = learner.state_dict()
    incomplete = {name: value for name, value in counters.items() if name != "generator"}
    with pytest.raises(CorruptFileError, match="generator"):
        learner.load_state_dict(LearnerState(tensors, incomplete))
    del tensors["adam/step"]
    with pytest.raises(CorruptFileError, match="adam/step"):
        learner.load_state_dict(LearnerState(tensors, counters))


def test_unknown_tensor_is_refused_by_name():
    learner = make()
    tensors, counters = learner.state_dict()
    tensors["network/unknown"] = torch.zeros(1)
    with pytest.raises(ConfigError, match="network/unknown"):
        learner.load_state_dict(LearnerState(tensors, counters))


@pytest.mark.parametrize(
    ("counter", "value"),
    [
        ("updates", "many"),
        ("skipped", {"a": 1}),
        ("rollbacks", [1]),
        ("replica_updates", None),
        ("previous_replica_updates", None),
        *(("schedule", value) for value in ({"window": [1]}, None, "text")),
        *(("generator", value) for value in ({}, [], None, {"bit_generator": "PCG64"}, LARGE_GENERATOR)),
    ],
)
def test_invalid_counter_leaves_learner_unchanged(counter, value):
    learner, other = make(), make(seed=9)
    other.update()
    other.refresh()
    other.update()
    tensors, counters = other.state_dict()
    before = learner.state_dict()
    with pytest.raises(CorruptFileError, match="invalid counters"):
        learner.load_state_dict(LearnerState(tensors, {**counters, counter: value}))
    assert learner.state_dict().counters == before.counters
    assert all(torch.equal(tensor, before.tensors[name]) for name, tensor in learner.state_dict().tensors.items())


def test_batch_has_no_duplicate_observation():
    learner = make(count=8)
    read = []

    read_batch = learner._reader.read
    learner._reader.read = lambda indices: read.append(indices) or read_batch(indices)
    learner.updates = 1
    learner.update()
    assert sorted(read[0][:8]) == sorted(read[0][8:]) == list(range(8))


def test_observations_are_used_from_their_update_on():
    store = GrowingStore(8)
    learner = make(store=store)
    seen = [learner.update().observations for _ in range(3)]
    store.count = 10
    seen += [learner.update().observations for _ in range(6)]
    assert seen == [8, 8, 8, 9, 9, 9, 10, 10, 10]


def test_loss_weights_are_evaluated_at_their_interval():
    store, coverages = GrowingStore(10), []
    learner = make(store=store)
    for count in (10, 20, 30, 35):
        store.count = count
        coverages.append(learner.update().coverage)
    assert coverages[0] == coverages[1] != coverages[2] == coverages[3]


def test_non_finite_loss_is_skipped_and_counted():
    learner = make()
    learner.update()
    compute, calls = learner.loss.compute_gradients, []

    def fail_twice(*arguments):
        calls.append(weights(learner))
        terms = compute(*arguments)
        return terms._replace(total=terms.total * float("nan")) if len(calls) <= 2 else terms

    learner.loss.compute_gradients = fail_twice
    report = learner.update()
    assert (report.update, learner.skipped) == (2, 2)
    assert np.isfinite(report.loss)
    assert torch.equal(calls[0], calls[2])


def test_five_non_finite_losses_raise_divergence_error():
    learner = make()
    with torch.no_grad():
        learner.network.decoder[0].bias[0] = float("nan")
    with pytest.raises(DivergenceError, match="5 batches"):
        learner.update()
    assert (learner.updates, learner.skipped) == (0, 5)


def test_evaluation_does_not_change_training():
    evaluated_one, straight = make(), make()
    for _ in range(3):
        evaluated_one.evaluate()
        assert evaluated_one.update() == straight.update()


def test_evaluation_compares_own_shuffled_and_no_latents():
    learner = make()
    for _ in range(3):
        learner.update()
    with torch.no_grad():  # after so few updates, latents have almost no effect
        learner.network.encoder[-1].weight.mul_(100.0)
    evaluation = learner.evaluate()
    assert (evaluation.update, evaluation.observations) == (3, 8)
    assert 0.0 < evaluation.mse_own < 1.0
    errors = sorted([evaluation.mse_own, evaluation.mse_shuffled, evaluation.mse_none])
    assert np.diff(errors).min() > 1e-6
    assert evaluation.log_std_min < evaluation.log_std_max


def evaluated(learner, count):
    return list(learner._evaluation_indices(count))


def test_evaluation_subset_does_not_depend_on_planned_steps():
    short, long = make(exploration={"steps": 40}), make(exploration={"steps": 4000})
    assert evaluated(short, 30) == evaluated(long, 30)


def test_evaluation_subset_has_all_observations_or_a_random_part():
    learner = make()
    assert sorted(evaluated(learner, 20)) == list(range(20))
    assert len(evaluated(learner, 200)) == len(set(evaluated(learner, 200))) == 20
    assert evaluated(learner, 200) != sorted(evaluated(learner, 200))
    assert evaluated(make(seed=1), 200) != evaluated(learner, 200)


def test_evaluation_subset_changes_little_while_a_run_grows():
    learner = make()
    assert set(evaluated(learner, 201)) - set(evaluated(learner, 200)) <= {200}


def test_loss_weights_use_configured_coverage():
    ours, theirs = (make(8, exploration={"authors_coverage": authors}).update().coverage for authors in (False, True))
    assert theirs > 1.02 * ours  # divided by the largest kernel


def network_log_std(learner, states, latent):
    """Return the log std of the learner's own network at states (S, 3) for a latent (L,)."""
    device = next(learner.network.parameters()).device
    query = (torch.tensor(values, dtype=torch.float32, device=device) for values in (latent, states))
    return learner.network.log_std(*query).detach().cpu().numpy()


def test_replica_keeps_the_network_of_its_refresh():
    learner = make()
    learner.update()
    learner.refresh()
    assert learner.replicas.updates == 1
    states, store = np.random.default_rng(0).uniform(-1, 1, (9, 3)), GrowingStore(70)
    observed = store.states[0], store.images[0]
    latent = learner.replicas.encode(store.states[:1], store.images[:1])[0][0]
    expected = network_log_std(learner, states, latent)
    learner.update()
    values, updates = learner.replicas.conditional_log_std(states, *observed)
    assert np.allclose(values, expected, atol=1e-6)
    assert learner.replicas.updates == updates == 1


def test_conditional_log_std_uses_the_observations_latent():
    learner, store = make(), GrowingStore(70)
    states = np.random.default_rng(0).uniform(-1, 1, (9, 3))
    latent = learner.replicas.encode(store.states[:1], store.images[:1])[0][0]
    values, updates = learner.replicas.conditional_log_std(states, store.states[0], store.images[0])
    assert np.allclose(values, network_log_std(learner, states, latent), atol=1e-6)
    assert updates == 0


def test_replica_encodes_one_image_per_state_or_one_for_all():
    replicas, store = make().replicas, GrowingStore(70)
    mean, std, updates = replicas.encode(store.states, store.images)
    assert updates == 0
    assert mean.shape == std.shape == (70, 16)
    shared, _, _ = replicas.encode(store.states, store.images[:1])
    assert np.allclose(shared[0], mean[0], atol=1e-6)
    assert np.all(std > 0.0)


@pytest.mark.parametrize("shape", [(1, 44, 45, 3), (45, 45, 3), (2, 45, 45, 3)])
def test_replica_refuses_images_of_another_shape(shape):
    with pytest.raises(ObservationError, match="images"):
        make().replicas.encode(np.zeros((3, 3)), np.zeros(shape, np.uint8))


def test_query_with_min_updates_gets_the_model_of_that_update():
    learner, store = make(), GrowingStore(70)
    states, query = np.zeros((4, 3)), (store.states[0], store.images[0])
    values = {}
    for _ in range(3):
        learner.update()
        learner.refresh()
        found, updates = learner.replicas.conditional_log_std(states, *query)
        values[updates] = found
    assert list(values) == [1, 2, 3]
    for min_updates, expected in ((0, 3), (1, 3), (2, 2), (3, 3), (4, 3)):
        found, updates = learner.replicas.conditional_log_std(states, *query, min_updates)
        assert updates == expected
        np.testing.assert_array_equal(found, values[expected])


def test_refresh_waits_only_for_readers_of_the_replaced_model():
    learner = make()
    learner.update()
    _, newer = learner.replicas._replicas
    with newer.lock:
        learner.refresh()
        assert learner.replicas.updates == 1
    learner.update()
    with newer.lock:  # by now the older one
        waiting = threading.Thread(target=learner.refresh)
        waiting.start()
        waiting.join(0.2)
        assert waiting.is_alive()
        assert learner.replicas.updates == 1
    waiting.join(10.0)
    assert learner.replicas.updates == 2


def test_reader_overtaken_by_refresh_gets_the_requested_model():
    learner, store = make(), GrowingStore(70)
    for _ in range(2):
        learner.update()
        learner.refresh()
    replicas, asked = learner.replicas, (np.zeros((4, 3)), store.states[0], store.images[0], 2)
    expected, updates = replicas.conditional_log_std(*asked)
    assert updates == 2
    learner.update()
    originals, held = replicas._replicas, threading.Event()

    class Overtaken:
        """The replicas; a refresh happens between the choice of one and its use."""

        def __getitem__(self, index):
            if not held.is_set():
                held.set()
                learner.refresh()
            return originals[index]

    replicas._replicas = Overtaken()
    replicas._check = lambda *_: None
    found, updates = replicas.conditional_log_std(*asked)
    assert (held.is_set(), updates) == (True, 2)
    np.testing.assert_array_equal(found, expected)


def test_early_observations_do_not_change_the_result():
    store = GrowingStore(8)
    in_time, early = make(store=store), make(count=90)
    for step in range(9, 12):
        assert [in_time.update() for _ in range(3)] == [early.update() for _ in range(3)]
        assert in_time.evaluate() == early.evaluate()
        store.count = step
    assert torch.equal(weights(in_time), weights(early))


def test_readers_never_see_partly_refreshed_replicas():
    learner = make()
    store, answers, done = GrowingStore(70), set(), threading.Event()

    def query():
        return float(learner.replicas.conditional_log_std(np.zeros((4, 3)), store.states[0], store.images[0])[0][0])

    def read():
        while not done.is_set():
            answers.add(query())

    reader = threading.Thread(target=read)
    reader.start()
    legal = {query()}
    try:
        wait_for(lambda: answers)
        for _ in range(5):
            learner.update()
            learner.refresh()
            legal.add(query())
    finally:
        done.set()
        reader.join(10.0)
    assert answers <= legal


class UnusableCuda:
    """torch finds a GPU, but every computation on it fails, as with a GPU that this torch has no kernels for."""

    REASON = "CUDA error: no kernel image is available for execution on the device"

    def __init__(self, monkeypatch):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
        monkeypatch.setattr(build, "check_device", self.fail)

    def fail(self, device):
        assert device.type == "cuda"
        raise RuntimeError(f"{self.REASON}\nCompile with `TORCH_USE_CUDA_DSA` to enable device-side assertions.")


def test_unusable_gpu_falls_back_to_cpu_with_warning(monkeypatch, caplog):
    UnusableCuda(monkeypatch)
    assert choose_device("auto") == torch.device("cpu")
    assert UnusableCuda.REASON in caplog.text
    assert "training on the CPU" in caplog.text


def test_unusable_gpu_is_an_error_if_requested(monkeypatch):
    UnusableCuda(monkeypatch)
    with pytest.raises(ConfigError, match=r"no kernel image.*set training/device: cpu"):
        choose_device("cuda")


def test_device_check_computes_a_convolution_gradient():
    build.check_device(torch.device("cpu"))
    with pytest.raises(RuntimeError):
        build.check_device(torch.device("meta"))  # has shapes, but no numbers


def test_cuda_is_refused_without_a_device(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="training/device"):
        choose_device("cuda")
    assert choose_device("auto") == torch.device("cpu")


def test_cuda_convolutions_are_exact_and_deterministic(monkeypatch):
    flags = torch.backends.cudnn
    for name, unwanted in (("deterministic", False), ("benchmark", True), ("allow_tf32", True)):
        monkeypatch.setattr(flags, name, unwanted)
    loss = choose_loss(make().network, torch.device("cuda"))
    assert isinstance(loss, PlainLoss)
    assert (flags.deterministic, flags.benchmark, flags.allow_tf32) == (True, False, False)


def test_network_waits_for_the_background_step():
    learner, other = make(), make()
    proceed = threading.Event()
    late = learner._optimiser.parts[1]
    late.step = lambda step=late.step: proceed.wait(10.0) and step()
    for _ in range(2):
        proceed.clear()
        learner.update()
        threading.Timer(0.1, proceed.set).start()
        other.update()
    assert torch.equal(weights(learner), weights(other))


def test_error_in_background_step_is_raised_by_refresh():
    learner = make()

    def fail():
        raise RuntimeError("no memory")

    learner._optimiser.parts[1].step = fail
    learner.update()
    with pytest.raises(RuntimeError, match="no memory"):
        learner.refresh()


def test_failed_step_does_not_refresh_replicas():
    learner = make()
    learner.update()
    learner.refresh()
    proceed, called = threading.Event(), []

    def fail():
        proceed.wait(10.0)
        raise RuntimeError("no memory")

    learner._optimiser.parts[1].step = fail
    learner.update()
    learner.refresh_async(lambda: called.append(learner.replicas.updates))
    proceed.set()
    with pytest.raises(RuntimeError, match="no memory"):
        learner.join()
    assert learner.replicas.updates == 1
    assert not called


def test_vectors_restore_weights_and_moments():
    trained, fresh = make(), make(seed=1)
    for _ in range(3):
        trained.update()
    fresh.load_weights(trained.weights())
    fresh.load_moments(trained.moments())
    tensors, others = fresh.state_dict().tensors, trained.state_dict().tensors
    assert all(torch.equal(tensors[name], tensor) for name, tensor in others.items())


def test_average_is_weighted_by_updates():
    learner = make()
    own = learner.weights()
    learner.average(0, 1, [(3, own + 4.0)])
    assert torch.allclose(learner.weights(), own + 3.0, atol=1e-6)
    assert learner.updates == 4


def test_trainers_in_turn_evaluate_loss_weights_as_often_as_one():
    """The loss weights are due at each second number."""
    turns, single = make(), make()
    numbers = [turns.update(trainers=2).update for _ in range(3)]
    for _ in range(6):
        single.update()
    assert numbers == [2, 4, 6]
    assert turns.updates == single.updates == 6
    assert len(turns.loss_weights.state_dict()["window"]) == len(single.loss_weights.state_dict()["window"]) == 3
