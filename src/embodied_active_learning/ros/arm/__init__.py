"""Arm nodes, their clients, and what moves the arm and observes with it."""
