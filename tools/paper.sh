#!/bin/bash
# Make the missing runs of docs/results.md and their measurements, then its figures and tables. The stopping criterion
# and the views of a fingerprint are measured separately.
# SWEEPS is the folder of the sessions; arguments are passed to each sweep, such as --workers 2.
set -euo pipefail
cd "$(dirname "$0")/.."
set +u; source ./setup.bash; set -u
sweeps="${SWEEPS:-$HOME/.ros/embodied_active_learning/sweeps}"
python3 -m embodied_active_learning.sweep experiments/learning_metrics.yaml --root "$sweeps" "$@"
python3 -m embodied_active_learning.sweep experiments/paper_profile.yaml --root "$sweeps" "$@"
python3 -m embodied_active_learning.sweep experiments/ablations.yaml --root "$sweeps" "$@"
python3 -m embodied_active_learning.sweep experiments/curated_objects.yaml --root "$sweeps" "$@"
python3 -m embodied_active_learning.sweep experiments/identification_images.yaml --root "$sweeps" "$@"
python3 experiments/table1.py "$sweeps/learning_metrics" "$sweeps/identification_images"
python3 experiments/table1.py "$sweeps/paper_profile" "$sweeps/identification_images"
python3 experiments/ablation_models.py "$sweeps/ablations" "$sweeps/identification_images/even-star-plant-duck-seed100"
OPENBLAS_NUM_THREADS=1 python3 experiments/coverage_benchmark.py
python3 experiments/ergodicity.py "$sweeps/learning_metrics/ergodic-diagonal-seed1"
python3 experiments/pac_bayes.py "$sweeps/learning_metrics/ergodic-diagonal-seed1"
python3 experiments/figures.py
