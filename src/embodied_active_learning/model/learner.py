"""The learner: trains the network online on a growing store of observations. Paper, Alg. 1, lines 12 to 14."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, Dict, Optional, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, DivergenceError
from embodied_active_learning.exploration.kernel import CoverageKernel, workspace_coverage
from embodied_active_learning.model.batches import BatchReader, ObservationSource
from embodied_active_learning.model.build import build_network, choose_device, choose_inference, choose_loss
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.learner_state import (
    ADAM,
    NETWORK,
    PREVIOUS,
    LearnerState,
    copy_with_prefix,
    pack,
    require_keys,
    require_shapes,
    unpack,
    without_prefix,
)
from embodied_active_learning.model.loss import LossFunction, LossTerms
from embodied_active_learning.model.loss_weights import LossWeights
from embodied_active_learning.model.metrics import Evaluation, active_units, evaluate_model
from embodied_active_learning.model.optimiser import Optimiser
from embodied_active_learning.model.replicas import Replicas
from embodied_active_learning.rng import Stream, generator, seed_sequence
from embodied_active_learning.state_dict import select_prefix

ATTEMPTS = 5  # batches tried for one update before an invalid loss counts as divergence
LOSS_LIMIT = 1e6  # nats per pixel value; a healthy model stays below 1e5 even if it predicts a wrong image confidently


@dataclass(frozen=True)
class UpdateReport:
    """One update: the loss, its terms and weights, and the active units of the mini-batch.

    coverage, log_std_min and log_std_max are from the latest evaluation of the loss weights.
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
    """Network, optimiser and loss weights of one run. Draws random numbers only from generators of its own.

    One thread may call the methods; `replicas` may be used from any thread.
    """

    def __init__(
        self, config: Config, observations: ObservationSource, seed: int, loss: Optional[LossFunction] = None
    ) -> None:
        """Build network and optimiser.

        Args:
            config: Of the run.
            observations: Store that grows while the run explores.
            seed: Of all random draws.
            loss: Default: the fastest on the device.

        Raises:
            ConfigError: The configured device is not usable.
        """
        self._config = config
        self._observations = observations
        self._seed = seed
        self.device = choose_device(config.training.device)
        weights_seed, batches_seed = seed_sequence(seed, Stream.BATCHES).spawn(2)
        self._random = np.random.default_rng(batches_seed)
        self._network = build_network(config, int(weights_seed.generate_state(1)[0])).to(self.device)
        self._optimiser = Optimiser(self._network, config.training.learning_rate)
        self.loss = choose_loss(self._network, self.device) if loss is None else loss
        self._reader = BatchReader(observations, self.device)
        self._variance = CoverageKernel.from_config(config).variance
        self.loss_weights = LossWeights(config.objective)
        self.updates = 0
        self.skipped = 0
        self.rollbacks = 0
        self._prepared = -1  # update that prepare() was called for
        self._inference = choose_inference(config, self.device)
        self.replicas = Replicas(self.network, self._inference)

    @property
    def network(self) -> ConditionalVAE:
        """The network after the last update; for the training thread only."""
        self.join()
        return self._network

    def prepare(self, trainers: int = 1) -> None:
        """Do what precedes the next update: initialise the colour, and evaluate the loss weights if that is due.

        Args:
            trainers: Number of trainers that take turns in numbering the updates. Of four, this one makes updates 0, 4,
                8, ... of a round that begins with 0, and the workers those in between.
        """
        if self._prepared == self.updates:
            return
        count = self._count(self.updates)
        if self.updates == 0 and self._config.training.start_at_mean_colour:
            self.network.set_initial_colour(self._mean_colour(count))
        if self._loss_weights_due(trainers):
            self._evaluate_loss_weights(count)
        self._prepared = self.updates

    def update(self, trainers: int = 1) -> UpdateReport:
        """Take one step of Adam on two fresh batches. Paper, Alg. 1, lines 12 to 14.

        Uses only the observations that this update is allowed to use (UpdatePlan.observations_needed), even if more are
        stored, so that the result depends on the sequence of observations alone.

        Args:
            trainers: See prepare().

        Raises:
            DivergenceError: ATTEMPTS losses or gradients in a row were not finite, or too large.
        """
        self.prepare(trainers)
        number, beta, gamma = self.updates, self.loss_weights.beta, self.loss_weights.gamma
        terms = self.step(number, beta, gamma)
        self.updates = number + trainers  # the workers make those in between
        return UpdateReport(
            update=self.updates,
            observations=self._count(number),
            loss=float(terms.total),
            reconstruction=float(terms.reconstruction),
            conditional_reconstruction=float(terms.conditional_reconstruction),
            kl=float(terms.kl),
            beta=beta,
            gamma=gamma,
            coverage=self.loss_weights.coverage,
            active_units=active_units(terms.latent_means),
            log_std_min=self.loss_weights.log_std_min,
            log_std_max=self.loss_weights.log_std_max,
        )

    def step(self, number: int, beta: float, gamma: float) -> LossTerms:
        """Take an update, by its number from 0, with given loss weights, without counting it.

        A worker calls it for its share of a round, with the weights that the owner has sent; `update` calls it for the
        owner's. Takes the first pair of batches whose loss is finite and below LOSS_LIMIT, and gradient finite.

        Raises:
            DivergenceError: Like update().
        """
        count = self._count(number)
        for _ in range(ATTEMPTS):
            terms = self._compute_gradients(count, beta, gamma)
            if float(terms.total) < LOSS_LIMIT and math.isfinite(float(terms.total + terms.gradient_sum)):
                self._optimiser.step()
                return terms
            self.skipped += 1
        raise DivergenceError(
            f"training diverged: loss or gradient not finite, or loss above {LOSS_LIMIT:g}, for {ATTEMPTS} batches in a"
            f" row at update {number + 1}; lower training/learning_rate"
        )

    def evaluate(self) -> Evaluation:
        """Evaluate the model on a random subset, and its log std over the workspace for the newest latent.

        The subset has at most `evaluation_size` of the observations that the last update could use.
        Does not draw from the training's generator, so that evaluations do not change the run.
        """
        count = self._count(max(0, self.updates - 1))
        subset = self._reader.read(self._evaluation_indices(count))
        random = generator(self._seed, Stream.STATES)
        with torch.no_grad():
            log_std = self._log_std_over(self._workspace_states(random), count)
            units, errors = evaluate_model(self.network, self._inference, subset)
        return Evaluation(
            update=self.updates,
            observations=count,
            active_units=units,
            mse_own=errors.own,
            mse_shuffled=errors.shuffled,
            mse_none=errors.none,
            log_std_min=float(log_std.min()),
            log_std_max=float(log_std.max()),
        )

    def end_after(self, steps: int) -> None:
        """Make the remaining updates of a run that ends after this number of observations."""
        self._config = self._config.with_steps(steps)

    def refresh(self) -> None:
        """Copy the network to the older replica; waits for its readers."""
        self.refresh_async(lambda: None)
        self.join()

    def refresh_async(self, on_done: Callable[[], None]) -> None:
        """Refresh in the background while the next update begins. on_done: called in that thread afterwards."""
        weights, updates = dict(self._network.named_parameters()), self.updates

        def refresh() -> None:
            self.replicas.refresh(weights, updates)
            on_done()

        self._optimiser.run_after_step(refresh)

    def join(self) -> None:
        """Wait for all background work. Raises its first error."""
        self._optimiser.join()

    def weights(self) -> torch.Tensor:
        """Return a copy of all weights as one vector (P,) float32 on the CPU."""
        return pack(dict(self.network.named_parameters()))

    def load_weights(self, weights: torch.Tensor) -> None:
        """Set all weights from a vector (P,) as weights() returns it."""
        with torch.no_grad():
            for parameter, values in unpack(weights, dict(self.network.named_parameters())):
                parameter.copy_(values)

    def average(self, first: int, own: int, others: Sequence[Tuple[int, torch.Tensor]]) -> None:
        """Average the weights with those of other trainers, in proportion to the updates that each has made, and count.

        Args:
            first: Number of updates when all had the same weights.
            own: Number that this trainer has made since.
            others: Number and weights (P,) of each other trainer.
        """
        total = own + sum(made for made, _ in others)
        if others and total > 0:
            mean = self.weights() * (own / total)
            for made, weights in others:
                mean.add_(weights, alpha=made / total)
            self.load_weights(mean)
        self.updates = first + total

    def moments(self) -> torch.Tensor:
        """Return a copy of Adam's moments and step count as one vector (2 P + 1,) float32 on the CPU."""
        self.join()
        return pack(self._optimiser.state_dict())

    def load_moments(self, moments: torch.Tensor) -> None:
        """Set Adam's moments and step count from a vector (2 P + 1,) as moments() returns it."""
        self.join()
        state = self._optimiser.state_dict()
        for tensor, values in unpack(moments, state):
            tensor.copy_(values)
        self._optimiser.load_state_dict(state)

    def reseed(self, *key: int) -> None:
        """Draw the following batches and noise from a stream of their own, given by the seed and a key."""
        self._random = generator(self._seed, Stream.WORKER, *key)

    def state_dict(self) -> LearnerState:
        """Return a copy of the state: weights, moments, counters, loss weights and random generator.

        Includes the model before the newest, because the planner may ask for that next.
        """
        self.join()
        counters: Dict[str, Any] = {
            "updates": self.updates,
            "skipped": self.skipped,
            "rollbacks": self.rollbacks,
            "replica_updates": self.replicas.updates,
            "schedule": self.loss_weights.state_dict(),
            "generator": self._random.bit_generator.state,
        }
        tensors = copy_with_prefix(NETWORK, dict(self._network.named_parameters()))
        tensors.update(copy_with_prefix(ADAM, self._optimiser.state_dict()))
        previous = self.replicas.weights_before(self.updates)
        if previous is not None:
            weights, counters["previous_replica_updates"] = previous
            tensors.update(copy_with_prefix(PREVIOUS, weights))
        return LearnerState(tensors, counters)

    def load_state_dict(self, state: LearnerState) -> None:
        """Restore state_dict(), so that training continues as if it had not been interrupted.

        An invalid state changes nothing.

        Raises:
            ConfigError: The state is of another model.
            CorruptFileError: A tensor or counter is missing or invalid.
        """
        tensors, counters = state
        require_keys(counters, ("updates", "skipped", "rollbacks", "replica_updates", "schedule", "generator"))
        current = self.state_dict().tensors
        require_shapes(without_prefix(PREVIOUS, tensors), without_prefix(PREVIOUS, current))
        previous = select_prefix(PREVIOUS, tensors)
        if previous:
            require_shapes(previous, dict(self.network.named_parameters()))
        try:
            updates, skipped, rollbacks = (int(counters[name]) for name in ("updates", "skipped", "rollbacks"))
            previous_updates = int(counters["previous_replica_updates"]) if previous else 0
            replica_updates = int(counters["replica_updates"])
            loss_weights = LossWeights(self._config.objective)
            loss_weights.load_state_dict(counters["schedule"])
            random = np.random.default_rng(0)
            random.bit_generator.state = counters["generator"]
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise CorruptFileError(
                f"invalid counters in the checkpoint: {error!r}; delete the file to use an older one"
            ) from error
        self.network.load_state_dict(select_prefix(NETWORK, tensors))
        self._optimiser.load_state_dict(select_prefix(ADAM, tensors))
        self.updates, self.skipped, self.rollbacks = updates, skipped, rollbacks
        self.loss_weights, self._random = loss_weights, random
        self._prepared = -1
        if previous:
            self.replicas.refresh(previous, previous_updates)
        # A model between two refreshes was never queried and must not replace the requested one.
        if replica_updates == self.updates:
            self.refresh()

    def rollback(self, state: LearnerState) -> None:
        """Return to the state of a good model and continue with other random draws. Raises as load_state_dict.

        The counts of skipped batches and rollbacks are kept.
        """
        skipped, rollbacks = self.skipped, self.rollbacks + 1
        self.load_state_dict(state)
        self.skipped, self.rollbacks = skipped, rollbacks
        if self.replicas.updates > self.updates:
            self.refresh()  # replaces the diverged model
        bits: Any = self._random.bit_generator  # PCG64, which has jumped()
        self._random = np.random.Generator(bits.jumped(rollbacks))

    def _compute_gradients(self, count: int, beta: float, gamma: float) -> LossTerms:
        """Draw two batches, each without repetition, and compute the loss and its gradient."""
        size = self._config.training.batch_size
        halves = [self._random.choice(count, size, replace=False) for _ in range(2)]
        noise = self._random.standard_normal((size, self._network.latent_size), dtype=np.float32)
        pair = self._reader.read(np.concatenate(halves))
        on_device = torch.from_numpy(noise).to(self.device)
        return self.loss.compute_gradients(self._network, pair, on_device, beta, gamma, self._optimiser.join)

    def _count(self, update: int) -> int:
        """Number of observations, from the first on, that update number `update` (from 0) uses."""
        return min(len(self._observations), self._config.update_plan.observations_needed(update))

    def _loss_weights_due(self, trainers: int) -> bool:
        """Whether the loss weights are evaluated before the next updates of all trainers.

        They are evaluated at each multiple of schedule_every: with 25 and four trainers, before updates 24 to 27.
        """
        every = self._config.objective.schedule_every
        return any(number % every == 0 for number in range(self.updates, self.updates + trainers))

    def _mean_colour(self, count: int) -> torch.Tensor:
        """(3,) mean of all pixels of the first `count` observations, in [0, 1]."""
        images = self._observations.images[:count]
        return torch.from_numpy(images.mean(axis=(0, 1, 2)) / 255.0).to(self.device, torch.float32)

    def _evaluate_loss_weights(self, count: int) -> None:
        states = self._workspace_states(self._random)
        with torch.no_grad():
            log_std = self._log_std_over(states, count)
        visited = self._observations.states[:count]
        authors = self._config.exploration.authors_coverage
        self.loss_weights.evaluate(log_std, workspace_coverage(states, visited, self._variance, authors))

    def _workspace_states(self, random: np.random.Generator) -> np.ndarray:
        """(S, D) uniform in the workspace, normalised."""
        return random.uniform(-1.0, 1.0, (self._config.exploration.samples, self.network.state_size))

    def _log_std_over(self, states: np.ndarray, count: int) -> np.ndarray:
        """Log std (S,) at states (S, D), given the last of the first `count` observations."""
        observed, images = self._reader.read(np.array([count - 1]))
        latent = self.network.encode(observed, images[0][None]).mean
        points = torch.from_numpy(states.astype(np.float32)).to(self.device)
        return self.network.log_std(latent, points).cpu().numpy()

    def _evaluation_indices(self, count: int) -> np.ndarray:
        """Indices (N,) of a random subset of the first `count` observations, in random order.

        Every observation has a random key that follows from the seed, and the smallest keys are chosen: the subset
        changes little while a run grows, and does not depend on the number of steps that are planned.
        """
        random = generator(self._seed, Stream.SUBSET)
        return np.argsort(random.random(count), kind="stable")[: self._config.training.evaluation_size]
