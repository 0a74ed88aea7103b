"""Errors of this package. Every message states what failed and what to check."""


class YamError(Exception):
    """Base class of all errors that this package raises."""


class ConfigError(YamError):
    """A configuration is invalid (unknown arm, gripper or channel, wrong value).

    Not a subclass of ValueError, since LeRobot's parser replaces a ValueError with an error without the reason.
    """


class ActionError(YamError, ValueError):
    """An action or command has wrong keys, shape or type, or non-finite values; nothing was sent."""


class ObservationError(YamError, ValueError):
    """An observation for a policy is incomplete, or has a wrong shape or type; the policy was not run."""


class BusError(YamError, OSError):
    """A CAN channel cannot be opened or used."""


class ChannelInUseError(BusError):
    """Another process on this machine, or another driver on the bus, uses the channel."""


class MotorError(YamError, RuntimeError):
    """A motor is missing, silent, duplicated, misconfigured or reports a fault."""


class StaleStateError(YamError, TimeoutError):
    """The newest state of an arm, motor or camera is too old to be returned as fresh."""


class CameraError(YamError, ConnectionError):
    """A camera cannot be found, opened, set up or read."""


class LifeCycleError(YamError, RuntimeError):
    """A request is not allowed in the current state of the arm."""


class GripperError(YamError, RuntimeError):
    """Gripper stops are unknown, implausible or differ from the stored ones."""


class SetupError(YamError, RuntimeError):
    """This computer cannot be set up as requested: missing rights, no such adapter, or a name in use."""


class RigError(YamError, RuntimeError):
    """The virtual rig could not be started or reached, or refused a request."""


class EmergencyStopError(YamError, RuntimeError):
    """The emergency stop is latched: no more arms are energised until its release."""


class DatasetError(YamError, RuntimeError):
    """A data set is damaged: it cannot be repaired, or one of its images cannot be decoded."""


class PolicyServerError(YamError, ConnectionError):
    """A policy server cannot be reached, has failed, or does not reply in time; nothing was sent to the robot."""


class LinkError(YamError, ConnectionError):
    """The computer with the arms cannot be reached, does not reply, or has sent a malformed message."""


class PlanError(YamError, RuntimeError):
    """A motion cannot be planned: out of reach, beyond a limit, singular, in collision, or malformed. Nothing moves."""


class ControllerError(YamError, RuntimeError):
    """The controller of Waldo Commander refused a command, does not reply, or could not be started."""
