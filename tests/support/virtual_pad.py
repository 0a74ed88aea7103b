"""Gamepads that SDL simulates, on a machine without any: the shipped driver reads them as it reads real ones."""

import ctypes

from lerobot_robot_yam.face.driving import sdl_pads
from lerobot_robot_yam.face.driving.sdl_pads import AXES, BUTTONS

FULL = 32767
JOYSTICK = 0x200  # SDL_INIT_JOYSTICK


class _Description(ctypes.Structure):  # SDL_VirtualJoystickDesc, version 1
    _fields_ = [
        *((name, ctypes.c_uint16) for name in ("version", "type", "axes", "buttons", "hats", "vendor", "product", "_")),
        *((name, ctypes.c_uint32) for name in ("button_mask", "axis_mask")),
        *((name, ctypes.c_char_p) for name in ("name",)),
        *((f"callback_{number}", ctypes.c_void_p) for number in range(7)),
    ]


def _sdl():
    """SDL itself, which pygame has loaded."""
    sdl_pads._pygame()
    with open("/proc/self/maps") as maps:
        sdl = ctypes.CDLL(next(line.split()[-1] for line in maps if "libSDL2-2" in line))
    sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
    sdl.SDL_JoystickClose.argtypes = [ctypes.c_void_p]
    sdl.SDL_JoystickInstanceID.argtypes = [ctypes.c_void_p]
    sdl.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
    sdl.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
    return sdl


class VirtualPad:
    """One pad, plugged in. known: of a layout that SDL knows; otherwise with four bare axes and six buttons."""

    def __init__(self, name="Test Pad", known=True, product=1):
        self._sdl = _sdl()
        assert self._sdl.SDL_InitSubSystem(JOYSTICK) == 0  # it runs while this pad is plugged in
        size = (len(AXES), len(BUTTONS)) if known else (4, 6)
        described = _Description(1, int(known), *size, 0, 0x1D50, product, name=name.encode())
        index = self._sdl.SDL_JoystickAttachVirtualEx(ctypes.byref(described))
        assert index >= 0
        self._handle = self._sdl.SDL_JoystickOpen(index)
        self._instance = self._sdl.SDL_JoystickInstanceID(self._handle)

    def push(self, axis, value):
        """Move an axis, by number or SDL's name, to −1 … 1."""
        number = AXES.index(axis) if isinstance(axis, str) else axis
        self._sdl.SDL_JoystickSetVirtualAxis(self._handle, number, round(value * FULL))

    def press(self, button, down=True):
        number = BUTTONS.index(button) if isinstance(button, str) else button
        self._sdl.SDL_JoystickSetVirtualButton(self._handle, number, down)

    def unplug(self):
        """Idempotent."""
        if self._handle is None:
            return
        for index in range(self._sdl.SDL_NumJoysticks()):
            if self._sdl.SDL_JoystickGetDeviceInstanceID(index) == self._instance:
                self._sdl.SDL_JoystickDetachVirtual(index)
                break
        self._sdl.SDL_JoystickClose(self._handle)
        self._handle = None
        self._sdl.SDL_QuitSubSystem(JOYSTICK)
