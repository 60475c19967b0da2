"""Learned objects: clustering, fingerprints, belief grids, and the decision where each object is found again."""
