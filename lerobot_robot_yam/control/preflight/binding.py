"""Identity check of the arm on a channel: a binding file stores an arm's fingerprint, to be compared at each session.

Contradictions (different serial numbers or motor types, an additional handle or motor) are errors. Changes with an
innocent explanation (different adapter or channel name, new firmware, a silent part) are warnings, unless a sibling
(another binding in the same directory) fits without any change: then the arms are swapped.
"""

import json
import logging
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

from lerobot_robot_yam.arm.mounting import arm_ids
from lerobot_robot_yam.arm.profile import ArmProfile
from lerobot_robot_yam.control.preflight.fingerprint import Fingerprint
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.system.paths import write_whole

logger = logging.getLogger(__name__)

_KIND = "yam arm binding"
_VERSION = 1
WIGGLE_ADVICE = "see which arm is which with yam-identify --wiggle"


@dataclass(frozen=True)
class Binding:
    """An arm's name, the channel on which the arm was bound, and its fingerprint."""

    name: str
    channel: str
    fingerprint: Fingerprint

    def save(self, path: Path) -> None:
        """Write the file atomically. Raises ConfigError: the file cannot be written."""
        data = {"kind": _KIND, "version": _VERSION, "name": self.name, "channel": self.channel}
        try:
            write_whole(path, json.dumps({**data, "fingerprint": self.fingerprint.to_dict()}, indent=1) + "\n")
        except OSError as error:
            raise ConfigError(f"cannot write the arm binding {path}: {error}; choose another path") from error

    @classmethod
    def load(cls, path: Path, place: str = "--channel CHANNEL") -> "Binding | None":
        """Load a binding; return None if there is no file.

        Args:
            place: the arm's channel as `yam-identify` options, for messages.

        Raises:
            ConfigError: the file is unreadable, damaged, or not a binding.
        """
        try:
            data = json.loads(path.read_bytes())
            if data["kind"] != _KIND or data["version"] != _VERSION:
                raise ValueError(f"kind {data['kind']!r}, version {data['version']!r}")
            name, channel = data["name"], data["channel"]
            if not isinstance(name, str) or not isinstance(channel, str):
                raise ValueError("name and channel are not text")
            return cls(name, channel, Fingerprint.from_dict(data["fingerprint"]))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ConfigError(f"cannot read the arm binding {path}: {error}") from error
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ConfigError(
                f"{path} is not a readable arm binding ({error!r}); delete it and bind the arm again: "
                f"yam-identify {place} --bind {shlex.quote(str(path))}"
            ) from error


def contradictions(bound: Fingerprint, found: Fingerprint) -> list[str]:
    """Describe differences that mean another arm; empty if both fingerprints may be of the same arm."""
    reasons = []
    common = sorted(bound.motors.keys() & found.motors.keys())
    told = [i for i in common if i in bound.serials and i in found.serials]
    other = [i for i in told if bound.serials[i] != found.serials[i]]
    if other:
        reasons.append(f"{len(other)} of {len(told)} motors have another serial number (id {_listing(other)})")
    kinds = [i for i in common if len({bound.motors[i].gear_ratio, found.motors[i].gear_ratio} - {None}) > 1]
    if kinds:
        reasons.append(f"motors of another type (id {_listing(kinds)})")
    extra = sorted(found.motors.keys() - bound.motors.keys())
    if extra:
        reasons.append(f"motors that were not there (id {_listing(extra)})")
    if found.handle_firmware is not None and bound.handle_firmware is None:
        reasons.append("a teaching handle that was not there")
    return reasons


def changes(bound: Fingerprint, found: Fingerprint) -> list[str]:
    """Describe differences that may have an innocent explanation, such as new firmware."""
    reasons = []
    silent = sorted(bound.motors.keys() - found.motors.keys())
    if silent:
        reasons.append(f"motors do not answer (id {_listing(silent)})")
    if bound.handle_firmware is not None and found.handle_firmware != bound.handle_firmware:
        what = "does not answer" if found.handle_firmware is None else "has another firmware"
        reasons.append(f"the teaching handle {what}")
    versions = attrgetter("software", "sub")
    common = sorted(bound.motors.keys() & found.motors.keys())
    firmware = [i for i in common if versions(bound.motors[i]) != versions(found.motors[i])]
    if firmware:
        reasons.append(f"motors have another firmware (id {_listing(firmware)})")
    if bound.adapter != found.adapter:
        reasons.append(f"another adapter or port (bound: {bound.adapter}; now: {found.adapter})")
    return reasons


def check_identity(
    path: Path | str, found: Fingerprint, channel: str, name: str, place: str | None = None
) -> list[str]:
    """Check that the arm found on `channel` is the one bound in `path`.

    Args:
        path: binding file of the expected arm; the file's directory is searched for siblings.
        found: see `read_fingerprint`.
        channel, name: the channel, and the arm's name in the configuration, for messages.
        place: the channel as `yam-identify` options; None: `--channel` is sufficient.

    Returns:
        Warnings, already logged; empty if the arm matches its binding exactly.

    Raises:
        MotorError: another arm replies (the message names a bound arm), or no motor replies.
        ConfigError: the file is missing or damaged.
    """
    path, place = Path(path), place or f"--channel {channel}"
    if not found.motors:
        raise MotorError(f"{name}: nothing answers on channel {channel}; check motor power, cable and bit-rate")
    binding = Binding.load(path, place)
    if binding is None:  # a misspelt path must not disable the check
        raise ConfigError(
            f"{name}: there is no arm binding {path}; correct `identity_path`, or bind the arm: "
            f"yam-identify {place} --bind {shlex.quote(str(path))}"
        )
    again = f"yam-identify {place} --name {shlex.quote(binding.name)} --bind {shlex.quote(str(path))}"
    different = changes(binding.fingerprint, found)
    if binding.channel != channel:
        different.append(f"another channel name (bound: {binding.channel}; now: {channel})")
    possible = [other for other in siblings(path) if not contradictions(other.fingerprint, found)]
    exact = [other for other in possible if not changes(other.fingerprint, found)]
    against = contradictions(binding.fingerprint, found)
    if against or (different and exact):
        fitting, why = (exact or possible, against) if against else (exact, different)
        told = _other_arm(binding, fitting, path, found, "; ".join(why))
        raise MotorError(f"{name}: channel {channel} {told}: {again} --force")
    warnings = []
    if different:
        warnings.append(
            f"{name}: the arm on channel {channel} fits {binding.name!r}, but {'; '.join(different)}. "
            f"If that is intended, bind it again: {again}"
        )
    if exact:
        twins = ", ".join(repr(other.name) for other in exact)
        warnings.append(
            f"{name}: the arm on channel {channel} cannot be told apart from {twins}: same serial numbers, "
            f"no other adapter. A swap would go unnoticed; {WIGGLE_ADVICE}"
        )
    for warning in warnings:
        logger.warning(warning)
    return warnings


def bind(
    path: Path | str, name: str, channel: str, found: Fingerprint, arm: ArmProfile, force: bool = False
) -> list[str]:
    """Store the fingerprint `found` for the arm called `name` with the profile `arm`.

    Returns:
        Notes on swaps that later checks cannot detect; empty if this arm differs from all siblings.

    Raises:
        MotorError: motors do not reply; or `path` binds another arm, and `force` is not set.
        ConfigError: the file is damaged (and `force` is not set), or cannot be written.
    """
    path = Path(path)
    *joints, gripper = arm_ids(arm)
    if set(found.motors) not in ({*joints}, {*joints, gripper}, {gripper}):  # {gripper}: a gripper without arm
        raise MotorError(
            f"{name}: on channel {channel} answer motors (id {_listing(found.motors) or 'none'}), which is no whole "
            "arm, so it cannot be bound; check power and cables"
        )
    if not force:
        old = Binding.load(path)
        against = [] if old is None else contradictions(old.fingerprint, found)
        if old is not None and against:
            raise MotorError(
                f"{path} already binds {old.name!r}, and the arm on channel {channel} is another one: "
                f"{'; '.join(against)}. Choose another path, or replace the binding with --force"
            )
    Binding(name, channel, found).save(path)
    return _notes(found, siblings(path))


def siblings(path: Path) -> list[Binding]:
    """Return the other bindings in the directory of `path`; ignore files that are not bindings."""
    found = []
    for other in sorted(path.parent.glob("*.json")):
        if other.name == path.name:
            continue
        try:
            binding = Binding.load(other)
        except ConfigError as error:
            logger.debug("not a binding: %s", error)
            continue
        if binding is not None:
            found.append(binding)
    return found


def _other_arm(expected: Binding, fitting: list[Binding], path: Path, found: Fingerprint, why: str) -> str:
    if not fitting:
        return (
            f"does not carry the arm bound as {expected.name!r} ({why}), nor any other arm bound in {path.parent}. "
            "Look for swapped cables; if it is the right arm, or motors were exchanged or added, bind it again"
        )
    swapped = "cables or adapters"
    if found.adapter is not None and found.adapter == expected.fingerprint.adapter:
        swapped = "the CAN cables"  # the expected adapter, another arm behind it
    elif found.adapter is not None and any(found.adapter == other.fingerprint.adapter for other in fitting):
        swapped = "the adapters' names"  # the other arm came with its adapter
    return (
        f"carries the arm bound as {' or '.join(repr(other.name) for other in fitting)}, not {expected.name!r}: "
        f"{swapped} are swapped ({why}). Put them right, or if this is how it shall be, bind again"
    )


def _notes(found: Fingerprint, others: Iterable[Binding]) -> list[str]:
    """Describe swaps that later checks cannot detect."""
    notes = []
    serials = set(found.serials.values())
    if len(found.serials) < 2 or len(serials) == 1:
        notes.append(
            f"the motors tell no serial numbers of their own ({sorted(serials) or 'none'}), so an identical arm could "
            "not be told apart from this one"
        )
    for other in others:
        if contradictions(other.fingerprint, found) or contradictions(found, other.fingerprint):
            continue
        if other.fingerprint.adapter == found.adapter:
            notes.append(f"this arm cannot be told apart from the one bound as {other.name!r}, or it is the same one")
        else:
            notes.append(
                f"only the adapter tells this arm from {other.name!r}: swapped adapters would be noticed, swapped CAN "
                "cables would not"
            )
    return [f"{note}; {WIGGLE_ADVICE}" for note in notes]


def _listing(ids: Iterable[int]) -> str:
    return ", ".join(map(str, ids))
