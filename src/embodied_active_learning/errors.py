"""The exceptions of this package. Each message names the problem, its place and the remedy."""


class EmbodiedActiveLearningError(Exception):
    """Base class of all exceptions of this package."""


class ConfigError(EmbodiedActiveLearningError, ValueError):
    """A key or a value of the configuration is invalid."""


class WorldError(EmbodiedActiveLearningError, ValueError):
    """A world file is invalid."""


class SessionError(EmbodiedActiveLearningError):
    """A session is in use, missing, or cannot be read or written."""


class CorruptFileError(SessionError):
    """A stored file is damaged or of another format."""


class DivergenceError(EmbodiedActiveLearningError):
    """The loss or its gradient was invalid for several batches in a row, or weights or moments are not finite."""


class BagError(EmbodiedActiveLearningError):
    """A bag is damaged, has no suitable messages, or cannot be written."""


class ObservationError(EmbodiedActiveLearningError, ValueError):
    """An image or a state does not fit the model and was not stored."""


class CommandError(EmbodiedActiveLearningError, ValueError):
    """A motion command was rejected, so the arm does not move, or it failed as the subclass states."""


class ArmFailedError(CommandError):
    """The arm accepted a command but failed to execute it: a reflex, or a pose that was not reached."""


class ArmStoppedError(CommandError):
    """The arm was stopped: it rejects commands until arm/recover is called."""


class ArmBusyError(CommandError):
    """Another node controls the arm, or a command is being executed."""


class ArmNotReadyError(ArmBusyError):
    """The robot is not ready for commands, for example during the recovery from a reflex."""


class RobotError(EmbodiedActiveLearningError):
    """The robot's driver rejected a request or did not respond."""


class ServiceError(EmbodiedActiveLearningError):
    """A service of another node did not respond, or responded with an error."""


class MissingPackageError(EmbodiedActiveLearningError):
    """An optional package is not installed."""


class BusyError(EmbodiedActiveLearningError):
    """The requested task is already running."""


class TaskCancelledError(EmbodiedActiveLearningError):
    """A long task was cancelled by its caller; nothing was stored."""


class NoResponseError(CommandError):
    """No response to a motion command: the arm may or may not execute it."""


class RunFailedError(EmbodiedActiveLearningError):
    """Another node of the run has failed; the message is its error."""
