"""Functions on handles of the page's elements: properties, presses, and inputs that are undone."""

from collections.abc import Callable
from typing import Any

import viser


def put(handle: Any, **properties: Any) -> None:
    """Set properties of an element; only changed properties are sent to the browsers."""
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def pressed(button: viser.GuiButtonHandle, work: Callable[[int], None]) -> viser.GuiButtonHandle:
    """Call `work` with the number of the browser that presses the button; return the button."""

    @button.on_click
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is not None:
            work(event.client_id)

    return button


def kept(handle: Any, may_set: Callable[[int], bool]) -> Any:
    """Undo at once the input of a browser that may not set the element; return the handle."""
    good = [handle.value]

    @handle.on_update
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is None or may_set(event.client_id):
            good[0] = event.target.value
        else:
            put(handle, value=good[0])

    return handle
