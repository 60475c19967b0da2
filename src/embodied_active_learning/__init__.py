"""Embodied active learning of generative sensor-object models."""

__version__ = "0.1.0"
