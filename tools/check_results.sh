#!/bin/bash
# Shortened experiments: a sweep of three runs with two worlds, seeds and variants, its comparison, a bound and the
# coverage benchmark. The first update is after 64 steps. A bound takes 10 s or more for each view up to the eighth.
set -euo pipefail
cd "$(dirname "$0")/.."
set +u; source ./setup.bash; set -u
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cat > "$folder/short.yaml" << SPEC
overrides: {exploration: {steps: 80}}
worlds: [diagonal]
seeds: [1, 2]
variants:
  ergodic: {}
  no-gamma: {worlds: [right], seeds: [1], overrides: {objective: {gamma_weight: 0.0}}}
SPEC
python3 -m embodied_active_learning.sweep "$folder/short.yaml" --root "$folder" --workers 2
python3 -m embodied_active_learning.sweep.compare_sessions "$folder/results/short" --output "$folder"
python3 experiments/pac_bayes.py "$folder/short/ergodic-diagonal-seed1" --views 2 --output "$folder/pac_bayes.csv"
python3 experiments/coverage_benchmark.py --seeds 1 --lengths 50 --output "$folder/coverage.csv"
