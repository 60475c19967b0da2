#!/bin/bash
# Shortened experiments: a sweep of 2 worlds x 2 seeds x 150 steps with a variant, its comparison, a
# bound and the coverage benchmark.
set -euo pipefail
cd "$(dirname "$0")/.."
set +u; source ./setup.bash; set -u
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cat > "$folder/short.yaml" << SPEC
overrides: {exploration: {steps: 150}}
worlds: [diagonal, right]
seeds: [1, 2]
variants:
  ergodic: {}
  no-gamma: {worlds: [diagonal], seeds: [1], overrides: {objective: {gamma_weight: 0.0}}}
SPEC
python3 -m embodied_active_learning.sweep "$folder/short.yaml" --root "$folder" --workers 2
python3 -m embodied_active_learning.sweep.compare_sessions "$folder/results/short" --output "$folder"
python3 experiments/pac_bayes.py "$folder/short/ergodic-diagonal-seed1" --views 10 --output "$folder/pac_bayes.csv"
python3 experiments/coverage_benchmark.py --seeds 1 --lengths 50 --output "$folder/coverage.csv"
