"""Arm nodes and their clients."""
