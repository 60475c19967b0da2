"""The package's named errors: each message says what is wrong, where, and what to do about it."""


class EmbodiedActiveLearningError(Exception):
    """Base of every error that this package raises on purpose."""


class ConfigError(EmbodiedActiveLearningError, ValueError):
    """A configuration value, or the key that names it, cannot be used."""


class WorldError(EmbodiedActiveLearningError, ValueError):
    """A simulated world cannot be built from its file."""


class SessionError(EmbodiedActiveLearningError):
    """A session folder is in use, is not ours, or cannot be read."""


class CorruptFileError(SessionError):
    """A stored file is damaged, or was not written by this package."""


class BagError(EmbodiedActiveLearningError):
    """A recorded bag is damaged, holds nothing of what is looked for, or cannot be written."""


class ObservationError(EmbodiedActiveLearningError, ValueError):
    """An image or a state is not what the model was built for, and was not stored."""


class CommandError(EmbodiedActiveLearningError, ValueError):
    """A motion command was refused, and the arm stands still."""


class ArmFailedError(CommandError):
    """The arm took a command and did not carry it out: a reflex, or a pose that was not reached."""


class ArmStoppedError(CommandError):
    """Somebody stopped the arm: it takes no command until arm/recover is called."""


class ArmBusyError(CommandError):
    """Another node drives the arm, or it is carrying out a command."""


class ArmNotReadyError(ArmBusyError):
    """The robot cannot take a command now: its states have stopped, say, or a reflex is being recovered from."""


class RobotError(EmbodiedActiveLearningError):
    """The robot's own software refused something, or did not answer."""


class MissingPackageError(EmbodiedActiveLearningError):
    """Something that only some runs need is not installed."""


class BusyError(EmbodiedActiveLearningError):
    """What was asked for can be done only once at a time, and is under way."""


class TaskCancelledError(EmbodiedActiveLearningError):
    """A long task was cancelled by its caller; nothing was stored."""


class NoResponseError(CommandError):
    """A motion command was not answered: whether the arm carries it out is not known."""


class RunFailedError(EmbodiedActiveLearningError):
    """Another node of the run has given up; the message is its reason."""
