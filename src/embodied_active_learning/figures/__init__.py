"""Figures of sessions, fingerprints and identifications, drawn without a display.

Matplotlib is imported here without the user's MPLBACKEND: importing it fails if that is not a known backend. Figures
use neither pyplot nor the user's matplotlibrc (see style.default_style).
"""

import os

_backend = os.environ.pop("MPLBACKEND", None)
try:
    import matplotlib  # noqa: F401
finally:
    if _backend is not None:
        os.environ["MPLBACKEND"] = _backend
