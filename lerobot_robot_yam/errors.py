"""Errors of this package. Every message names what failed and says what to check."""


class YamError(Exception):
    """Root of every error raised by this package."""


class ConfigError(YamError):
    """A configuration cannot be used (unknown arm, gripper, channel, wrong value).

    This class is no ValueError, since LeRobot's parser replaces a ValueError by an error without the reason.
    """


class ActionError(YamError, ValueError):
    """A command has wrong keys, shape, type or non-finite values; nothing was sent."""


class ObservationError(YamError, ValueError):
    """An observation for a policy lacks something, or has a wrong shape or type; the policy was not run."""


class BusError(YamError, OSError):
    """A CAN channel cannot be opened or used."""


class ChannelInUseError(BusError):
    """Another process of this machine, or another driver on the wire, drives the channel."""


class MotorError(YamError, RuntimeError):
    """A motor is missing, silent, duplicated, misconfigured or reports a fault."""


class StaleStateError(YamError, TimeoutError):
    """The newest state of an arm, motor or camera is too old to be returned as fresh."""


class CameraError(YamError, ConnectionError):
    """A camera cannot be found, opened, set up or read."""


class LifeCycleError(YamError, RuntimeError):
    """The request is not allowed in the arm's present state."""


class GripperError(YamError, RuntimeError):
    """Gripper stops are unknown, implausible or do not match the stored ones."""


class SetupError(YamError, RuntimeError):
    """This computer cannot be set up as requested: no rights, no such adapter, a name that is taken."""


class RigError(YamError, RuntimeError):
    """The virtual rig could not be started or reached, or refused a request."""


class EmergencyStopError(YamError, RuntimeError):
    """The emergency stop is latched: no other arm is energised until it is released."""


class DatasetError(YamError, RuntimeError):
    """A data set is damaged: it cannot be repaired, or a picture of it cannot be decoded."""


class PolicyServerError(YamError, ConnectionError):
    """A policy server cannot be reached, has failed, or does not answer in time; nothing was sent to the robot."""


class LinkError(YamError, ConnectionError):
    """The computer that has the arms cannot be reached, does not answer, or sent a malformed message."""


class PlanError(YamError, RuntimeError):
    """A motion cannot be planned: out of reach, beyond a limit, singular, too near, or malformed. Nothing moves."""


class ControllerError(YamError, RuntimeError):
    """The controller of Waldo Commander refused a command, does not answer, or could not be started."""
