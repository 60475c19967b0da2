"""Learned objects: where they are, what they look like, and where they are found again."""
