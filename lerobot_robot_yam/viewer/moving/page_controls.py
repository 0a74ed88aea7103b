"""What the folders of the panel share: buttons that tell who pressed them, and values that are shown."""

from collections.abc import Callable
from typing import Any

import viser


def pressed(button: viser.GuiButtonHandle, work: Callable[[int], None]) -> viser.GuiButtonHandle:
    """Do this with the number of the browser that presses the button; returns the button."""

    @button.on_click
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is not None:
            work(event.client_id)

    return button


def show_value(handle: Any, value: Any) -> None:
    """Set what a control of the page shows; viser's types say that it cannot be set."""
    handle.value = value
