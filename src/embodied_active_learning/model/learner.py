"""The learner: one network, its optimiser and its schedule, trained online on a growing store of observations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, Optional, Tuple

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, EmbodiedActiveLearningError
from embodied_active_learning.exploration.kernel import CoverageKernel, workspace_coverage
from embodied_active_learning.model import checkpoint
from embodied_active_learning.model.batches import BatchReader, Observations
from embodied_active_learning.model.build import (
    build_network,
    choose_arithmetic,
    choose_device,
    choose_images,
)
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.metrics import Evaluation, active_units, evaluate_model
from embodied_active_learning.model.objective import Arithmetic, Loss
from embodied_active_learning.model.optimiser import Optimiser
from embodied_active_learning.model.replicas import Replicas
from embodied_active_learning.model.schedule import Schedule

ATTEMPTS = 5  # batches tried for one update before a loss that is not finite counts as divergence


class DivergenceError(EmbodiedActiveLearningError):
    """The loss or its gradient stayed non-finite for several batches in a row."""


@dataclass(frozen=True)
class UpdateReport:
    """One update: the loss with its terms, the weights it used, and what the minibatch's latents look like.

    log_std_min, log_std_max and coverage are of the latest evaluation of the schedule.
    """

    update: int
    observations: int
    loss: float
    reconstruction: float
    conditional_reconstruction: float
    kl: float
    beta: float
    gamma: float
    coverage: float
    active_units: int
    log_std_min: float
    log_std_max: float


class Learner:
    """Trains the network (paper, Alg. 1, lines 12-14). Draws only from its own generators, seeded from the seed.

    One thread may call its methods; `snapshots` may be asked from any thread.
    """

    def __init__(
        self, config: Config, observations: Observations, seed: int, loss: Optional[Callable[..., Loss]] = None
    ) -> None:
        """Build the network and the optimiser. Raises ConfigError for a device that is not there.

        loss: plain_loss or a stand-in for it; None takes the fastest for the device.
        """
        self._config = config
        self._observations = observations
        self._seed = seed
        self._device = choose_device(config.training.device)
        weights_seed, batches_seed = np.random.SeedSequence([seed, 201]).spawn(2)
        self._random = np.random.default_rng(batches_seed)
        self._network = build_network(config, int(weights_seed.generate_state(1)[0])).to(self._device)
        self._optimiser = Optimiser(self._network, config.training.learning_rate)
        if loss is None:
            self.arithmetic = choose_arithmetic(self._network, self._device)
        else:
            self.arithmetic = Arithmetic(loss, "as given", torch.get_num_threads())
        self._reader = BatchReader(observations, self._device, keep=self._device.type != "cpu")
        self._variance = CoverageKernel.from_config(config).variance
        self.schedule = Schedule(config.objective)
        self.updates = 0
        self.skipped = 0
        self.rollbacks = 0
        self._images = choose_images(config, self._device)
        self.snapshots = Replicas(self.network, self._images)

    @property
    def network(self) -> ConditionalVAE:
        """The network after the last update. Only the thread that trains may ask for it."""
        self.settle()
        return self._network

    def update(self) -> UpdateReport:
        """One step of Adam on two fresh batches. Raises DivergenceError after five non-finite losses or gradients.

        Only the observations that the update needs are looked at (see Config.observations_needed), however many there
        are by now: one sequence of observations gives one result.
        """
        count = self._count(self.updates)
        if self.updates == 0 and self._config.training.start_at_mean_colour:
            self.network.start_at(self._mean_colour(count))
        if self.updates % self._config.objective.schedule_every == 0:
            self._evaluate_schedule(count)
        beta, gamma = self.schedule.beta, self.schedule.gamma
        loss = self._attempt(count, beta, gamma)
        self.updates += 1
        return UpdateReport(
            update=self.updates,
            observations=count,
            loss=float(loss.total),
            reconstruction=float(loss.reconstruction),
            conditional_reconstruction=float(loss.conditional_reconstruction),
            kl=float(loss.kl),
            beta=beta,
            gamma=gamma,
            coverage=self.schedule.coverage,
            active_units=active_units(loss.latent_means, self._config.training.active_unit_threshold),
            log_std_min=self.schedule.log_std_min,
            log_std_max=self.schedule.log_std_max,
        )

    def evaluate(self) -> Evaluation:
        """The model on a fixed subset of the observations, and over the workspace with the newest one's latent.

        Which `evaluation_size` of the run's `exploration.steps` observations make up the subset follows from the seed.
        Those that the last update could see are used, so that the subset only grows until it is complete; where they
        are fewer than two, the newest two stand in. Draws nothing from the training's generator, so that looking does
        not change the run.
        """
        count = self._count(max(0, self.updates - 1))
        subset = self._reader.read(self._evaluation_indices(count))
        random = np.random.default_rng(np.random.SeedSequence([self._seed, 202]))
        with torch.no_grad():
            log_std = self._log_std_over(self._workspace_states(random), count)
            measured = evaluate_model(self.network, self._images, subset, self._config.training.active_unit_threshold)
        return Evaluation(
            update=self.updates,
            observations=count,
            log_std_min=float(log_std.min()),
            log_std_max=float(log_std.max()),
            **measured,
        )

    def refresh(self) -> None:
        """Let the snapshots answer from the model as it is now; waits for those who still read the one before last."""
        self.refresh_meanwhile(lambda: None)
        self.settle()

    def refresh_meanwhile(self, then: Callable[[], None]) -> None:
        """The same in the background, while the next update begins. then: called from there as soon as it is so."""
        weights, updates = dict(self._network.named_parameters()), self.updates

        def take() -> None:
            self.snapshots.take(weights, updates)
            then()

        self._optimiser.afterwards(take)

    def settle(self) -> None:
        """Return when nothing is going on in the background any more. Raises what went wrong there."""
        self._optimiser.settle()

    def state(self) -> Tuple[Dict[str, torch.Tensor], Dict[str, Any]]:
        """Copies of all that a continued run needs: tensors on the CPU, and plain numbers that JSON can hold.

        The model before the newest is among them, because it may be the one that is asked for next.
        """
        self.settle()
        counters = {
            "updates": self.updates,
            "skipped": self.skipped,
            "rollbacks": self.rollbacks,
            "snapshot_updates": self.snapshots.updates,
            "schedule": self.schedule.state_dict(),
            "generator": self._random.bit_generator.state,
        }
        tensors = checkpoint.pack(self._network, self._optimiser)
        earlier = self.snapshots.weights_before(self.updates)
        if earlier is not None:
            weights, counters["earlier_updates"] = earlier
            tensors.update(checkpoint.pack_earlier(weights))
        return tensors, counters

    def restore(self, tensors: Dict[str, torch.Tensor], counters: Dict[str, Any]) -> None:
        """Go on from state(), as if there had been no interruption.

        Raises ConfigError if it is of another model, CorruptFileError for counters that are none.
        """
        checkpoint.require(counters, ("updates", "skipped", "schedule", "generator"))
        earlier = checkpoint.earlier_weights(tensors, self.network)
        checkpoint.unpack(tensors, self.network, self._optimiser)
        try:
            self._restore_counters(counters)
            earlier_updates = int(counters["earlier_updates"]) if earlier else 0
            snapshot_updates = int(counters.get("snapshot_updates", self.updates))
        except (KeyError, TypeError, ValueError) as error:
            raise CorruptFileError(
                f"checkpoint has counters that cannot be used ({error!r}): it was not written by this version of the "
                "package; delete it"
            ) from error
        if earlier:
            self.snapshots.take(earlier, earlier_updates)
        # A model between two refreshes answered nobody, and must not push out the one that is asked for.
        if snapshot_updates == self.updates:
            self.refresh()

    def roll_back(self, tensors: Dict[str, torch.Tensor], counters: Dict[str, Any]) -> None:
        """Go back to state() of a good model, and on from there with other random draws than before.

        What was skipped and how often it was rolled back is not forgotten. Raises as restore does.
        """
        skipped, rollbacks = self.skipped, self.rollbacks + 1
        self.restore(tensors, counters)
        self.skipped, self.rollbacks = skipped, rollbacks
        if self.snapshots.updates > self.updates:
            self.refresh()  # what was gone back from does not answer any more
        self._random = np.random.Generator(self._random.bit_generator.jumped(rollbacks))

    def _restore_counters(self, counters: Dict[str, Any]) -> None:
        self.updates, self.skipped = int(counters["updates"]), int(counters["skipped"])
        self.rollbacks = int(counters.get("rollbacks", 0))
        self.schedule.load_state_dict(counters["schedule"])
        self._random.bit_generator.state = counters["generator"]

    def _attempt(self, count: int, beta: float, gamma: float) -> Loss:
        for _ in range(ATTEMPTS):
            loss = self._gradients(count, beta, gamma)
            if _all_finite(loss, self._network):
                self._optimiser.step()
                return loss
            self.skipped += 1
        raise DivergenceError(
            f"loss or gradient was not finite for {ATTEMPTS} batches in a row at update {self.updates + 1}: lower"
            " training/learning_rate"
        )

    def _gradients(self, count: int, beta: float, gamma: float) -> Loss:
        size = self._config.training.batch_size
        halves = [self._random.choice(count, size, replace=False) for _ in range(2)]
        noise = self._random.standard_normal((size, self._network.latent_size), dtype=np.float32)
        inputs = torch.from_numpy(noise).to(self._device), beta, gamma
        if self.arithmetic.in_place:
            pair = self._reader.read_in_place(np.concatenate(halves))
            loss = self.arithmetic.loss(self._network, pair, *inputs, self._optimiser.settle)
        else:
            pair = self._reader.read(np.concatenate(halves))
            loss = self.arithmetic.loss(self.network, pair, *inputs)
        loss.hand_over_gradients(self._network)
        terms = (None if term is None else term.detach() for term in loss._replace(gradients=None))
        return Loss(*terms)

    def _count(self, update: int) -> int:
        """Observations that update number `update`, from 0, looks at: the first so many."""
        return min(len(self._observations), self._config.observations_needed(update))

    def _mean_colour(self, count: int) -> torch.Tensor:
        """(3,) mean of all pixels of the first `count` observations, in [0, 1]."""
        images = self._observations.images[:count]
        return torch.from_numpy(images.mean(axis=(0, 1, 2)) / 255.0).to(self._device, torch.float32)

    def _evaluate_schedule(self, count: int) -> None:
        states = self._workspace_states(self._random)
        with torch.no_grad():
            log_std = self._log_std_over(states, count)
        visited = self._observations.states[:count]
        authors = self._config.exploration.authors_coverage
        self.schedule.evaluate(log_std, workspace_coverage(states, visited, self._variance, authors))

    def _workspace_states(self, random: np.random.Generator) -> np.ndarray:
        return random.uniform(-1.0, 1.0, (self._config.exploration.samples, self.network.state_size))

    def _log_std_over(self, states: np.ndarray, count: int) -> np.ndarray:
        """Log std (S,) at states (S, D), given the last of the first `count` observations."""
        latent = self.network.encode(*self._reader.read(np.array([count - 1]))).mean
        points = torch.from_numpy(states.astype(np.float32)).to(self._device)
        return self.network.log_std(latent, points).cpu().numpy()

    def _evaluation_indices(self, count: int) -> np.ndarray:
        """Indices (N,) of the fixed subset among the first `count` observations, or of the last two of these."""
        random = np.random.default_rng(np.random.SeedSequence([self._seed, 203]))
        chosen = random.permutation(self._config.exploration.steps)[: self._config.training.evaluation_size]
        present = chosen[chosen < count]
        return present if len(present) >= 2 else np.arange(max(0, count - 2), count)


def _all_finite(loss: Loss, network: ConditionalVAE) -> bool:
    # A sum is finite only if all its parts are: one pass over the gradients, no copies.
    known = loss.gradient_sum
    sums = [parameter.grad.sum() for parameter in network.parameters()] if known is None else [known]
    return bool(torch.stack([loss.total, *sums]).isfinite().all())
