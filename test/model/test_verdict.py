"""Verdict on a run."""

import math

import pytest

from embodied_active_learning.model.verdict import ReconstructionErrors, judge_run


@pytest.mark.parametrize(
    ("name", "updates", "errors", "ergodic_measure"),
    [
        ("healthy", 3000, (0.0018, 0.0190, 0.0169), 0.066),
        ("healthy", 450, (0.0055, 0.0175, 0.0129), 0.166),
        ("healthy", 3000, (0.0018, 0.0190, 0.0169), None),
        ("ergodic measure high", 3000, (0.0018, 0.0190, 0.0169), 0.9),
        ("not enough steps", 0, (None, None, None), None),
        ("not enough steps", 240, (0.01178, 0.01215, 0.01220), 0.293),
        ("not enough steps", 390, (0.0103, 0.0145, 0.0142), 0.173),
        ("not enough steps", 3000, (0.0103, 0.0145, 0.0142), 0.1),
        ("latent not used", 3000, (0.0168, 0.0169, 0.0176), 0.1),
        ("diverged", 180, (1597.0, 1600.0, 0.076), 0.1),
        ("diverged", 180, (0.12, 0.12, 0.05), 0.1),
        ("diverged", 180, (0.6, 0.8, 0.7), 0.1),
        ("diverged", 180, (math.nan, 0.1, 0.1), 0.1),
        ("diverged", 180, (math.inf, 0.1, 0.1), 0.1),
        ("not evaluated", 30, (None, None, None), 0.5),
    ],
)
def test_verdict_of_a_run(name, updates, errors, ergodic_measure):
    verdict = judge_run(updates, *errors, ergodic_measure)
    assert verdict.name == name
    assert str(verdict) == f"{name}: {verdict.explanation}"


@pytest.mark.parametrize(
    ("errors", "remedy"),
    [
        ((1597.0, 1600.0, 0.076), "lower training/learning_rate"),
        ((0.0168, 0.0169, 0.0176), "objective/beta_max"),
        ((0.0103, 0.0145, 0.0142), "raise exploration/steps"),
    ],
)
def test_verdict_names_a_remedy(errors, remedy):
    assert remedy in judge_run(3000, *errors, 0.1).explanation


def test_empty_table_has_its_own_verdict():
    verdict = judge_run(900, 0.001, 0.001, 0.001, 0.05, "nothing to learn")
    assert verdict.name == "nothing to learn"


def test_latent_contribution_is_relative_to_best_alternative():
    assert ReconstructionErrors(0.01, 0.1, 0.05).latent_contribution == pytest.approx(0.8)
    assert ReconstructionErrors(0.05, 0.1, 0.05).latent_contribution == 0.0
    assert ReconstructionErrors(0.0, 0.0, 0.0).latent_contribution == 1.0
