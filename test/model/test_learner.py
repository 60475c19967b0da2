"""The learner: repeatable, resumable, never ahead of its data, and answering questions while it learns."""

import json
import threading

import numpy as np
import pytest
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, CorruptFileError, ObservationError
from embodied_active_learning.model.build import choose_arithmetic, choose_device
from embodied_active_learning.model.learner import DivergenceError, Learner
from embodied_active_learning.model.objective import plain_loss

SMALL = {
    "camera": {"width": 45, "height": 45},
    "training": {"batch_size": 8, "first_update_at": 8, "device": "cpu", "evaluation_size": 20},
    "exploration": {"samples": 50, "fresh_samples": 10, "steps": 40},
    "objective": {"schedule_every": 2},
}


class GrowingStore:
    """Observations in memory whose arrays move with every one that is added."""

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


def make(count=30, seed=0, **sections):
    values = {name: {**SMALL.get(name, {}), **sections.get(name, {})} for name in {**SMALL, **sections}}
    return Learner(Config.from_dict(values), GrowingStore(count), seed)


def weights(learner):
    return torch.cat([parameter.detach().flatten() for parameter in learner.network.parameters()])


def test_an_update_reports_the_loss_with_its_terms():
    report = make().update()
    expected = report.reconstruction + report.beta * report.kl + report.gamma * report.conditional_reconstruction
    assert report.loss == pytest.approx(expected, rel=1e-5)
    assert (report.update, report.observations) == (1, 8)
    assert 0.0 < report.coverage < 1.0
    assert report.gamma == pytest.approx(0.1 * report.coverage)
    assert report.log_std_min < report.log_std_max
    assert 0 <= report.active_units <= 16


def test_the_decoder_starts_at_the_mean_colour_of_the_observations_unless_it_shall_start_black():
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


def test_one_seed_gives_one_result_and_another_seed_another():
    first, second, other = make(), make(), make(seed=1)
    for learner in (first, second, other):
        for _ in range(4):
            learner.update()
    assert torch.equal(weights(first), weights(second))
    assert not torch.equal(weights(first), weights(other))


def test_learning_neither_reads_nor_moves_global_random_generators():
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    before = torch.random.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    learner = make()
    learner.update()
    learner.evaluate()
    assert torch.equal(before[0], torch.random.get_rng_state())
    assert np.array_equal(before[1], np.random.get_state()[1])  # noqa: NPY002


def test_saved_and_restored_training_goes_on_bit_for_bit():
    straight, broken = make(), make()
    for _ in range(3):
        straight.update()
        broken.update()
    tensors, counters = broken.state()
    resumed = make(seed=9)
    resumed.restore(tensors, json.loads(json.dumps(counters)))
    for _ in range(3):
        assert straight.update() == resumed.update()
    assert torch.equal(weights(straight), weights(resumed))
    for one, other in zip(straight.state()[0].values(), resumed.state()[0].values()):
        assert torch.equal(one, other)


def test_a_learner_that_has_not_begun_can_be_saved_and_restored():
    first, second = make(), make(seed=9)
    second.restore(*first.state())
    assert first.update() == second.update()


def test_the_saved_state_is_a_copy_that_further_updates_leave_alone():
    learner = make()
    learner.update()
    tensors, _ = learner.state()
    kept = {name: tensor.clone() for name, tensor in tensors.items()}
    learner.update()
    assert all(torch.equal(tensors[name], kept[name]) for name in kept)


def test_a_checkpoint_of_another_model_is_refused_by_the_tensors_name():
    learner = make(model={"latent_size": 8})
    with pytest.raises(ConfigError, match=r"network/encoder\.4\.weight"):
        make().restore(*learner.state())


def test_a_checkpoint_without_a_tensor_or_a_counter_is_refused_by_its_name():
    learner = make()
    tensors, counters = learner.state()
    with pytest.raises(CorruptFileError, match="generator"):
        learner.restore(tensors, {name: value for name, value in counters.items() if name != "generator"})
    del tensors["adam/step"]
    with pytest.raises(CorruptFileError, match="adam/step"):
        learner.restore(tensors, counters)


def test_a_batch_holds_no_observation_twice():
    learner = make(count=8)
    read = []

    def note(go_on):
        return lambda indices: read.append(indices) or go_on(indices)

    learner._reader.read = note(learner._reader.read)
    learner._reader.read_in_place = note(learner._reader.read_in_place)
    learner.updates = 1
    learner.update()
    assert sorted(read[0][:8]) == sorted(read[0][8:]) == list(range(8))


def test_observations_are_used_from_the_update_on_that_they_call_for():
    learner = make(count=8)
    seen = [learner.update().observations for _ in range(3)]
    learner._observations.count = 10
    seen += [learner.update().observations for _ in range(6)]
    assert seen == [8, 8, 8, 9, 9, 9, 10, 10, 10]


def test_the_schedule_is_evaluated_only_every_so_many_updates():
    learner = make()
    coverages = []
    for count in (10, 20, 30, 35):
        learner._observations.count = count
        coverages.append(learner.update().coverage)
    assert coverages[0] == coverages[1] != coverages[2] == coverages[3]


def test_a_non_finite_loss_is_skipped_and_counted_and_changes_no_weight():
    learner = make()
    learner.update()
    plain, calls = learner.arithmetic.loss, []

    def sometimes_broken(*arguments):
        calls.append(weights(learner))
        loss = plain(*arguments)
        return loss._replace(total=loss.total * float("nan")) if len(calls) <= 2 else loss

    learner.arithmetic = learner.arithmetic._replace(loss=sometimes_broken)
    report = learner.update()
    assert (report.update, learner.skipped) == (2, 2)
    assert np.isfinite(report.loss)
    assert torch.equal(calls[0], calls[2])


def test_five_non_finite_losses_in_a_row_are_an_error():
    learner = make()
    with torch.no_grad():
        learner.network.decoder[0].bias[0] = float("nan")
    with pytest.raises(DivergenceError, match="5 batches"):
        learner.update()
    assert (learner.updates, learner.skipped, learner.schedule.rejected) == (0, 5, 1)


def test_evaluating_does_not_change_the_training():
    looked, straight = make(), make()
    for _ in range(3):
        looked.evaluate()
        assert looked.update() == straight.update()


def test_an_evaluation_compares_own_shuffled_and_missing_latents():
    learner = make()
    for _ in range(3):
        learner.update()
    with torch.no_grad():  # so early, latents say next to nothing
        learner.network.encoder[-1].weight.mul_(100.0)
    evaluation = learner.evaluate()
    assert (evaluation.update, evaluation.observations) == (3, 8)
    assert 0.0 < evaluation.mse_own < 1.0
    errors = sorted([evaluation.mse_own, evaluation.mse_shuffled, evaluation.mse_none])
    assert np.diff(errors).min() > 1e-6
    assert evaluation.log_std_min < evaluation.log_std_max


def evaluated(learner, count):
    return list(learner._evaluation_indices(count))


def test_the_evaluated_subset_only_grows_until_it_is_complete():
    learner = make()
    whole = evaluated(learner, 40)
    assert len(set(whole)) == 20
    for count in range(10, 41):
        found = evaluated(learner, count)
        assert found == [index for index in whole if index < count]
        assert len(found) >= 2
    assert evaluated(learner, 200) == whole
    assert evaluated(make(seed=1), 40) != whole


def test_before_two_of_the_subset_are_there_the_newest_two_observations_are_evaluated():
    learner = make(training={"evaluation_size": 2})
    last = max(evaluated(learner, 40))
    assert evaluated(learner, last) == [last - 2, last - 1]
    assert evaluated(learner, last + 1) != [last - 1, last]
    assert evaluated(learner, 1) == [0]


def test_the_schedule_takes_the_coverage_that_the_planner_takes():
    ours, theirs = (make(8, exploration={"authors_coverage": authors}).update().coverage for authors in (False, True))
    assert theirs > 1.02 * ours  # divided by the largest kernel


def test_the_snapshot_answers_as_the_network_did_when_it_was_refreshed():
    learner = make()
    learner.update()
    learner.refresh()
    assert learner.snapshots.updates == 1
    states, latent = np.random.default_rng(0).uniform(-1, 1, (9, 3)), np.linspace(-1, 1, 16)
    device = next(learner.network.parameters()).device
    question = (torch.tensor(values, dtype=torch.float32, device=device) for values in (latent, states))
    expected = learner.network.log_std(*question).detach().cpu().numpy()
    learner.update()
    assert np.allclose(learner.snapshots.log_std(states, latent), expected, atol=1e-6)
    assert learner.snapshots.updates == 1


def test_entropy_given_an_observation_is_that_given_its_latent():
    learner, store = make(), GrowingStore(70)
    states = np.random.default_rng(0).uniform(-1, 1, (9, 3))
    latent = learner.snapshots.encode(store.states[:1], store.images[:1])[0][0]
    values, updates = learner.snapshots.conditional_log_std(states, store.states[0], store.images[0])
    assert np.allclose(values, learner.snapshots.log_std(states, latent), atol=1e-6)
    assert updates == 0


def test_the_snapshot_encodes_an_image_for_each_state_or_one_for_all():
    snapshots, store = make().snapshots, GrowingStore(70)
    mean, std, updates = snapshots.encode(store.states, store.images)
    assert updates == 0
    assert mean.shape == std.shape == (70, 16)
    shared, _, _ = snapshots.encode(store.states, store.images[:1])
    assert np.allclose(shared[0], mean[0], atol=1e-6)
    assert np.all(std > 0.0)


@pytest.mark.parametrize("shape", [(1, 44, 45, 3), (45, 45, 3), (2, 45, 45, 3)])
def test_the_snapshot_refuses_images_of_another_shape(shape):
    with pytest.raises(ObservationError, match="images"):
        make().snapshots.encode(np.zeros((3, 3)), np.zeros(shape, np.uint8))


def test_who_waits_for_updates_is_answered_by_the_model_that_had_them_and_everyone_else_by_the_newest():
    learner, store = make(), GrowingStore(70)
    states, question = np.zeros((4, 3)), (store.states[0], store.images[0])
    values = {}
    for _ in range(3):
        learner.update()
        learner.refresh()
        found, updates = learner.snapshots.conditional_log_std(states, *question)
        values[updates] = found
    assert list(values) == [1, 2, 3]
    for min_updates, answered_by in ((0, 3), (1, 3), (2, 2), (3, 3), (4, 3)):
        found, updates = learner.snapshots.conditional_log_std(states, *question, min_updates)
        assert updates == answered_by
        np.testing.assert_array_equal(found, values[answered_by])


def test_a_refresh_waits_for_readers_of_the_model_that_it_replaces_and_for_no_others():
    learner = make()
    learner.update()
    _, newer = learner.snapshots._copies
    with newer.lock:
        learner.refresh()
        assert learner.snapshots.updates == 1
    learner.update()
    with newer.lock:  # which is the older one by now
        waiting = threading.Thread(target=learner.refresh)
        waiting.start()
        waiting.join(0.2)
        assert waiting.is_alive()
        assert learner.snapshots.updates == 1
    waiting.join(10.0)
    assert learner.snapshots.updates == 2


def test_a_reader_who_is_overtaken_by_a_refresh_is_still_answered_by_the_model_that_it_asked_for():
    learner, store = make(), GrowingStore(70)
    for _ in range(2):
        learner.update()
        learner.refresh()
    snapshots, asked = learner.snapshots, (np.zeros((4, 3)), store.states[0], store.images[0], 2)
    expected, updates = snapshots.conditional_log_std(*asked)
    assert updates == 2
    learner.update()
    copies, held = snapshots._copies, threading.Event()

    class Overtaken:
        """The copies; between the choice of one and its use, a refresh comes."""

        def __getitem__(self, index):
            if not held.is_set():
                held.set()
                learner.refresh()
            return copies[index]

    snapshots._copies = Overtaken()
    snapshots._check = lambda *_: None
    found, updates = snapshots.conditional_log_std(*asked)
    assert (held.is_set(), updates) == (True, 2)
    np.testing.assert_array_equal(found, expected)


def test_observations_that_come_early_change_nothing():
    in_time, early = make(count=8), make(count=90)
    for step in range(9, 12):
        assert [in_time.update() for _ in range(3)] == [early.update() for _ in range(3)]
        assert in_time.evaluate() == early.evaluate()
        in_time._observations.count = step
    assert torch.equal(weights(in_time), weights(early))


def test_readers_in_other_threads_see_whole_snapshots_while_learning_goes_on():
    learner = make()
    states, latent = np.zeros((4, 3)), np.zeros(16)
    answers, done = set(), threading.Event()

    def read():
        while not done.is_set():
            answers.add(float(learner.snapshots.log_std(states, latent)[0]))

    reader = threading.Thread(target=read)
    reader.start()
    legal = {float(learner.snapshots.log_std(states, latent)[0])}
    try:
        for _ in range(5):
            learner.update()
            learner.refresh()
            legal.add(float(learner.snapshots.log_std(states, latent)[0]))
    finally:
        done.set()
        reader.join(10.0)
    assert answers <= legal


def test_cuda_is_refused_where_there_is_none(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="training/device"):
        choose_device("cuda")
    assert choose_device("auto") == torch.device("cpu")


def test_on_a_gpu_convolutions_are_exact_and_repeatable(monkeypatch):
    flags = torch.backends.cudnn
    for name, unwanted in (("deterministic", False), ("benchmark", True), ("allow_tf32", True)):
        monkeypatch.setattr(flags, name, unwanted)
    arithmetic = choose_arithmetic(make().network, torch.device("cuda"))
    assert arithmetic.loss is plain_loss
    assert (flags.deterministic, flags.benchmark, flags.allow_tf32) == (True, False, False)


def test_whoever_asks_for_the_network_gets_it_after_the_step_that_is_still_under_way():
    learner, other = make(), make()
    go_on = threading.Event()
    late = learner._optimiser.parts[1]
    late.step = lambda step=late.step: go_on.wait(10.0) and step()
    for _ in range(2):
        go_on.clear()
        learner.update()
        threading.Timer(0.1, go_on.set).start()
        other.update()
    assert torch.equal(weights(learner), weights(other))


def test_what_goes_wrong_in_a_step_is_raised_by_whoever_needs_its_result():
    learner = make()

    def fail():
        raise RuntimeError("no memory")

    learner._optimiser.parts[1].step = fail
    learner.update()
    with pytest.raises(RuntimeError, match="no memory"):
        learner.refresh()


def test_a_model_whose_step_went_wrong_answers_nobody():
    learner = make()
    learner.update()
    learner.refresh()
    go_on, told = threading.Event(), []

    def fail():
        go_on.wait(10.0)
        raise RuntimeError("no memory")

    learner._optimiser.parts[1].step = fail
    learner.update()
    learner.refresh_meanwhile(lambda: told.append(learner.snapshots.updates))
    go_on.set()
    with pytest.raises(RuntimeError, match="no memory"):
        learner.settle()
    assert learner.snapshots.updates == 1
    assert not told
