"""Embodied active learning of generative sensor-object models.

    import embodied_active_learning as eal

    config = eal.load_config("demo", world="right", steps=1000)
    session = eal.learn(config)  # simulated arm, planner and trainer in one process
    fingerprints = eal.fingerprint(session)
    decisions = eal.identify(session, images_of=session)

Each name is imported at its first use, so that importing the package takes no time and needs no ROS.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what editors and type checkers see
    from embodied_active_learning.config import Config as Config
    from embodied_active_learning.errors import EmbodiedActiveLearningError as EmbodiedActiveLearningError
    from embodied_active_learning.exploration.commands import PoseCommand as PoseCommand
    from embodied_active_learning.exploration.commands import VelocityCommand as VelocityCommand
    from embodied_active_learning.exploration.explorer import Explorer as Explorer
    from embodied_active_learning.objects.decision import Decision as Decision
    from embodied_active_learning.pipeline.api import fingerprint as fingerprint
    from embodied_active_learning.pipeline.api import identify as identify
    from embodied_active_learning.pipeline.api import load_config as load_config
    from embodied_active_learning.pipeline.api import load_model as load_model
    from embodied_active_learning.pipeline.api import load_session as load_session
    from embodied_active_learning.pipeline.learning import learn as learn
    from embodied_active_learning.registry import EXPLORERS as EXPLORERS
    from embodied_active_learning.registry import INFORMATION_MEASURES as INFORMATION_MEASURES
    from embodied_active_learning.session.session import Session as Session

__version__ = "0.1.0"

_PUBLIC = {
    "Config": "config",
    "Decision": "objects.decision",
    "EmbodiedActiveLearningError": "errors",
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
