"""Judges whether a run has learned a useful model, from the numbers of its last evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Optional

GREY_IMAGE_ERROR = 0.25
"""Largest possible mean squared error of a constant grey image; pixels are in [0, 1]."""
HARMFUL = 2.0
"""Ratio of the errors with own and without latent above which the latent does harm."""
UNUSED, USEFUL = 0.2, 0.5
"""Latent contribution below which the latent is not used, and from which on it is useful."""
ENOUGH_UPDATES = 1000
"""Updates after which a latent that is not used yet rarely becomes useful."""
OBJECTS_STABLE, NOTHING_TO_LEARN = "objects stable", "nothing to learn"
"""Why the stopping criterion ends a run."""
HIGH_ERGODIC_MEASURE = 0.2
"""[nat] Runs of the ergodic explorer end between 0.03 and 0.1."""


class ReconstructionErrors(NamedTuple):
    """Mean squared errors of images decoded from their own latents, from those of other images, and from z = 0."""

    own: float
    shuffled: float
    none: float

    @property
    def latent_contribution(self) -> float:
        """Share of the error that an image's own latent removes, at most 1; about 0 if the latent is not used."""
        return 1.0 - self.own / max(min(self.shuffled, self.none), 1e-12)


@dataclass(frozen=True)
class Verdict:
    """Judgement of a run: a name for programs, and the explanation with a remedy for people."""

    name: str
    explanation: str

    def __str__(self) -> str:
        return f"{self.name}: {self.explanation}"


NO_TRAINING = Verdict("images only", "no model is trained with training/updates_per_observation 0")
"""Verdict on a run that only collects images."""


def judge_run(
    updates: int,
    mse_own: Optional[float],
    mse_shuffled: Optional[float],
    mse_none: Optional[float],
    ergodic_measure: Optional[float],
    ended: str = "",
) -> Verdict:
    """Return the verdict on a run; None for numbers that it does not have.

    Args:
        updates: Number of model updates.
        mse_own: Mean squared error of images decoded from their own latents.
        mse_shuffled: From the latents of other images.
        mse_none: Without a latent, from z = 0.
        ergodic_measure: KL divergence between target and visited states [nat].
        ended: Why the stopping criterion has ended the run; empty if all steps were made.
    """
    if ended == NOTHING_TO_LEARN:
        return Verdict(ended, "nothing on the table differs from it; place objects, or check the camera's images")
    if updates == 0:
        return Verdict("not enough steps", "no model update was made; raise exploration/steps")
    if mse_own is None or mse_shuffled is None or mse_none is None:
        return Verdict("not evaluated", "the run has no evaluation yet; finish it, or lower training/evaluate_every")
    errors = ReconstructionErrors(mse_own, mse_shuffled, mse_none)
    problem = _judge_model(updates, errors)
    if problem is not None:
        return problem
    if ergodic_measure is not None and ergodic_measure > HIGH_ERGODIC_MEASURE:
        return Verdict(
            "ergodic measure high",
            f"visited states do not match the target ({ergodic_measure:.3g} nat, limit {HIGH_ERGODIC_MEASURE});"
            " raise exploration/steps, or use exploration/explorer: ergodic",
        )
    return Verdict("healthy", describe_latent_use(errors))


def _judge_model(updates: int, errors: ReconstructionErrors) -> Optional[Verdict]:
    """Return what is wrong with the model, or None."""
    if not errors.own <= min(GREY_IMAGE_ERROR, HARMFUL * errors.none):
        return Verdict(
            "diverged",
            f"mean squared error {errors.own:.3g} with own latent, {errors.none:.3g} without latent, at most"
            f" {GREY_IMAGE_ERROR} with a grey image; lower training/learning_rate",
        )
    share, use = errors.latent_contribution, describe_latent_use(errors)
    if share < UNUSED and updates >= ENOUGH_UPDATES:
        return Verdict("latent not used", f"{use}; lower objective/beta_max, or check that images show objects")
    if share < USEFUL:
        return Verdict("not enough steps", f"{use} after {updates} updates; raise exploration/steps")
    return None


def describe_latent_use(errors: ReconstructionErrors) -> str:
    """Return in words how much of the error an image's own latent removes."""
    return f"the latent removes {100.0 * max(0.0, errors.latent_contribution):.0f} % of the reconstruction error"
