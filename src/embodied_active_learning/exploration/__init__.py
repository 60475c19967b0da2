"""Exploration: KL-ergodic control of the conditional-entropy target, and the explorers it is compared with.

Modules, from the arm's motion up: `commands`, `dynamics`, `kernel` (coverage), `samples` (visited states and time
average), `objective` (target, KL-ergodic measure, barrier), `controller`, `baselines`, `explorer` (interface and
registry).
"""
