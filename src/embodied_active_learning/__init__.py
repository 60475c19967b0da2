"""Embodied active learning of generative sensor-object models.

    import embodied_active_learning as eal

    config = eal.load_config("demo", world="right", steps=300)
    session = eal.learn(config)
    prints = eal.fingerprint(session)
    decisions = eal.identify(session, images_of=other)

Each name is imported at its first use, so that importing the package takes no time and needs no ROS.
"""

from importlib import import_module as _import_module

__version__ = "0.1.0"

_PUBLIC = {
    "Config": "config",
    "EXPLORERS": "registry",
    "Explorer": "exploration.explorer",
    "INFORMATION_MEASURES": "registry",
    "PoseCommand": "exploration.commands",
    "Session": "session.session",
    "VelocityCommand": "exploration.commands",
    "fingerprint": "pipeline.api",
    "identify": "pipeline.api",
    "learn": "pipeline.learning",
    "load_config": "pipeline.api",
    "load_model": "pipeline.api",
    "load_session": "pipeline.api",
}


def __getattr__(name):  # type: ignore[no-untyped-def]  # PEP 562
    """Import a public name. Raises AttributeError for any other."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"embodied_active_learning.{_PUBLIC[name]}"), name)


def __dir__():  # type: ignore[no-untyped-def]
    """List the public names."""
    return sorted([*globals(), *_PUBLIC])
