"""Handles of the page's elements."""

from typing import Any


def put(handle: Any, **properties: Any) -> None:
    """Set properties of an element, and send to the browsers those that differ from what they are."""
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
