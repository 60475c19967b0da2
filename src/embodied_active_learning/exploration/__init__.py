"""Exploration: KL-ergodic control of the conditional-entropy target, and the explorers it is compared with.

Modules, from the arm's motion up: `commands`, `dynamics`, `kernel` (coverage), `samples` (visited states and time
average), `ergodic_objective` (target, KL-ergodic measure, barrier), `controller`, `active` (where decisions are open),
`baselines`, `explorer` (interface). The names of the explorers are in `registry`.
"""
