"""Helpers for page controls: setting properties, handling presses, and undoing inputs that are not allowed."""

from collections.abc import Callable
from typing import Any

import viser


def put(handle: Any, **properties: Any) -> None:
    """Set properties of a page control. Only changed properties are sent to the browsers."""
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def pressed(button: viser.GuiButtonHandle, work: Callable[[int], None]) -> viser.GuiButtonHandle:
    """Make a button call `work` with the number of the browser that pressed it; return the button."""

    @button.on_click
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is not None:
            work(event.client_id)

    return button


def kept(handle: Any, may_set: Callable[[int], bool]) -> Any:
    """Undo inputs to a control from browsers for which `may_set` is false; return the control's handle."""
    good = [handle.value]

    @handle.on_update
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is None or may_set(event.client_id):
            good[0] = event.target.value
        else:
            put(handle, value=good[0])

    return handle
