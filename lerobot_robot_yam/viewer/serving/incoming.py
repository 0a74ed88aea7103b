"""Check of messages from browsers before viser sees them.

viser 1.1 sets any field of a control that a message names, even callbacks and `removed`. It also converts values: the
text "nan" becomes a slider's value, without a check of limits. viser accepts files of any size, opens a tunnel to the
internet on request, and keeps form markers forever. So only messages that our page needs are accepted. They may have
only fields declared by viser, finite numbers, and for a control only values that a person could set.

A new feature that needs another message type (uploads, `get_render`) adds it to `_KINDS`, with limits in this module.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import viser
import viser._messages as messages
from viser.infra._messages import wire_field_names

from lerobot_robot_yam.errors import YamError

_KINDS = {
    kind.__name__: kind
    for kind in (
        messages.ViewerCameraMessage,
        messages.GuiUpdateMessage,
        messages.GuiButtonHoldMessage,
        messages.CommandTriggerMessage,
        messages.ScenePointerMessage,
        messages.SceneNodeClickMessage,
        messages.SceneNodeDragMessage,
        messages.TransformControlsUpdateMessage,
        messages.TransformControlsDragStartMessage,
        messages.TransformControlsDragEndMessage,
        messages.LocalStorageGetItemResponseMessage,  # reply to a heartbeat ping
    )
}
_OTHER_KINDS = {kind.__name__ for kind in messages.Message.get_subclasses()} - set(_KINDS)
_LARGEST = 1e9  # maximum magnitude of a number in a scene or camera message
_UNIT = 0.01  # tolerance for the length of a unit quaternion
_ROUNDING = 1e-6  # tolerance for a slider's limits, as a fraction of its range: browsers add up steps

_SWITCHES = (viser.GuiButtonHandle, viser.GuiCheckboxHandle)
_CHOICES = (viser.GuiDropdownHandle, viser.GuiButtonGroupHandle)
_NUMBERS = (viser.GuiNumberHandle, viser.GuiSliderHandle)
_ROWS = (viser.GuiMultiSliderHandle, viser.GuiVector2Handle, viser.GuiVector3Handle)
_COLOURS = (viser.GuiRgbHandle, viser.GuiRgbaHandle)


class MalformedError(YamError):
    """A message that no viser page would send."""


def passes(raw: bytes | str, control: Callable[[str], Any]) -> bool:
    """Return whether to pass a message on to viser. Other well-formed messages are to be dropped.

    Args:
        raw: message as received.
        control: function that returns a control's handle for its id, or None.

    Raises:
        MalformedError: no viser page would send this message.
    """
    name, fields = _decoded(raw)
    if name in _OTHER_KINDS:
        return False
    kind = _KINDS.get(name)
    if kind is None or not set(fields) <= set(wire_field_names(kind)):
        raise MalformedError(f"no message of viser's: {name[:40]!r}")
    try:
        message: Any = msgspec.convert(fields, kind)
    except (msgspec.ValidationError, TypeError, ValueError, OverflowError) as error:
        raise MalformedError(f"{name}: {error}") from None
    if isinstance(message, messages.GuiUpdateMessage):
        handle = control(message.uuid)
        return handle is not None and set(message.updates) == {"value"} and settable(handle, message.updates["value"])
    if isinstance(message, messages.GuiButtonHoldMessage):
        handle = control(message.uuid)
        return handle is not None and settable(handle, True) and math.isfinite(message.frequency)
    turn = getattr(message, "wxyz", None)
    return _finite(list(fields.values())) and (turn is None or abs(math.hypot(*turn) - 1.0) <= _UNIT)


def settable(control: Any, value: Any) -> bool:
    """Return whether a person could set this viser control to `value`: visible, enabled, value within its range."""
    if not _seen(control) or getattr(control, "disabled", True):  # progress bars have no `disabled`
        return False
    if isinstance(control, _SWITCHES):
        return isinstance(value, bool)
    if isinstance(control, viser.GuiTextHandle):
        return isinstance(value, str)
    if isinstance(control, _CHOICES):
        return isinstance(value, str) and value in control.options
    if isinstance(control, _NUMBERS):
        return within(value, control.min, control.max)
    if not isinstance(control, (*_ROWS, *_COLOURS)) or not isinstance(value, (list, tuple)):
        return False
    count = len(control.value)
    low, high = (0, 255) if isinstance(control, _COLOURS) else (control.min, control.max)
    lows, highs = (limit if isinstance(limit, tuple) else (limit,) * count for limit in (low, high))
    return len(value) == count and all(map(within, value, lows, highs))


def _seen(control: Any) -> bool:
    """Return whether a control and all folders around it are visible."""
    while control is not None:
        if not getattr(control, "visible", True):
            return False
        impl = getattr(control, "_impl", None)  # the root and modals have no `_impl`
        control = impl and impl.gui_api._container_handle_from_uuid.get(impl.parent_container_id)
    return True


def within(value: Any, low: float | None, high: float | None) -> bool:
    """Return whether a value is a finite number within [low, high]. None means no limit."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return False
    slack = 0.0 if low is None or high is None else (high - low) * _ROUNDING
    return (low is None or value >= low - slack) and (high is None or value <= high + slack)


def _decoded(raw: bytes | str) -> tuple[str, dict[str, Any]]:
    """Return a message's type name and its fields. Raises MalformedError: the message cannot be decoded."""
    try:
        fields = msgspec.msgpack.decode(raw) if isinstance(raw, bytes) else None
    except (msgspec.DecodeError, RecursionError, ValueError, TypeError) as error:
        raise MalformedError(f"no message: {error}") from None
    if not isinstance(fields, dict) or not all(isinstance(key, str) for key in fields):
        raise MalformedError("no message: it has no fields")
    name = fields.pop("type", None)
    if not isinstance(name, str):
        raise MalformedError("no message: it has no type")
    return name, fields


def _finite(value: Any) -> bool:
    """Return whether all numbers in nested lists are finite and at most `_LARGEST` in magnitude."""
    if isinstance(value, (list, tuple)):
        return all(map(_finite, value))
    return not isinstance(value, (int, float)) or abs(value) <= _LARGEST  # False for NaN
