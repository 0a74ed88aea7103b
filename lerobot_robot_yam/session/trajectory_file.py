"""Trajectory files in the vendor's format: `np.save` of a dict {trajectory, timestamps, frequency}.

Such a file is a pickle, and plain unpickling would run any code that its author put in. This reader imports nothing
that the file names: stand-ins replace the four constructors that `np.save` writes; any other name is refused.
"""

import io
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.system.paths import user_path, write_whole

FREQUENCY_HZ = 50.0
"""Rate of saved rows, Hz: the maximum rate at which the vendor's replay sends rows."""
_MOST_BYTES = 100_000_000  # maximum size of a file, bytes: enough for five hours of two arms
_NUMBERS = "fiu"  # kinds of numeric numpy types
_SAVED_AS = ("trajectory", "timestamps")  # keys of positions and times in the file


def save_trajectory(path: str | Path, trajectory: Trajectory) -> None:
    """Write a trajectory, resampled to `FREQUENCY_HZ`. The vendor's reader ignores the column names.

    Raises:
        ConfigError: the file cannot be written.
    """
    path = user_path(path)
    # the last row is the end of the trajectory
    times = np.arange(math.ceil(trajectory.seconds * FREQUENCY_HZ) + 1) / FREQUENCY_HZ
    columns = trajectory.positions.T
    rows = np.stack([np.interp(times, trajectory.times_s, column) for column in columns], axis=1)
    content: dict[str, Any] = {"trajectory": rows, "timestamps": times, "frequency": FREQUENCY_HZ}
    file = io.BytesIO()
    np.save(file, np.array(content | {"columns": list(trajectory.columns)}, dtype=object))
    try:
        write_whole(path, file.getvalue())
    except OSError as error:
        raise ConfigError(f"{path} cannot be written ({error.strerror})") from error


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory file of this package or of the vendor. Nothing in the file is executed.

    Raises:
        ConfigError: the file cannot be read, or contains no trajectory.
        ActionError: the numbers are not a valid trajectory, see `Trajectory`.
    """
    path = user_path(path)
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror})") from error
    if len(data) > _MOST_BYTES:
        raise ConfigError(f"{path} is larger than {_MOST_BYTES / 1e6:.0f} MB: no trajectory is")
    try:
        content = _content(io.BytesIO(data))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except Exception as error:  # a broken pickle can raise any exception
        raise ConfigError(f"{path} is no trajectory: its content cannot be read ({error})") from error
    missing = [key for key in _SAVED_AS if key not in content]
    if missing:
        raise ConfigError(f"{path} is no trajectory: it has no {' and no '.join(missing)}")
    columns = content.get("columns", [])
    if not isinstance(columns, list) or not all(isinstance(name, str) for name in columns):
        raise ConfigError(f"{path}: its names of columns are no texts")
    rows, times = (_numbers(path, key, content[key]) for key in _SAVED_AS)
    return Trajectory(times, rows, tuple(columns), str(path))


def _numbers(path: Path, key: str, value: object) -> np.ndarray:
    try:
        found = value.array() if isinstance(value, _Array) else np.array(value)
    except ValueError as error:
        raise ConfigError(f"{path}: its {key} is no table of numbers ({error})") from error
    if found.dtype.kind not in _NUMBERS:
        raise ConfigError(f"{path}: its {key} is no table of numbers")
    return found


def _content(file: io.BytesIO) -> dict[str, Any]:
    """Read the dict of an .npy file. Raises ConfigError: the file has no dict, or contains more than numbers."""
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if shape or dtype.kind != "O":
        raise ConfigError("it is no dict that np.save has written, as yam-float and the vendor's example do")
    array = _NumbersOnly(file).load()
    items = array.items if isinstance(array, _Array) else None
    if items is None or len(items) != 1 or not isinstance(items[0], dict):
        raise ConfigError("it has no dict {trajectory, timestamps, frequency}")
    content: dict[str, Any] = items[0]
    return content


class _Dtype:
    """Stand-in for `numpy.dtype` that only stores the type's name."""

    def __init__(self, text: str, *_: object):
        self.text, self.order = str(text), "="

    def __setstate__(self, state: tuple) -> None:
        self.order = str(state[1])

    def numbers(self, data: bytes) -> np.ndarray:
        """Decode `data` into a flat array. Raises ConfigError: the type is not numeric."""
        dtype = np.dtype(self.order + self.text) if self.text[:1] in _NUMBERS else np.dtype(object)
        if dtype.kind not in _NUMBERS:
            raise ConfigError(f"it holds {self.text!r}, and a trajectory holds numbers")
        return np.frombuffer(data, dtype)


class _Array:
    """Stand-in for `numpy.ndarray` that stores a list of objects, or the bytes that `array` decodes."""

    def __init__(self, *_: object):
        self.items: list[Any] | None = None
        self._rest: tuple = ()

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        self.items = data if isinstance(data, list) else None
        self._rest = (shape, dtype, fortran, data)

    def array(self) -> np.ndarray:
        """Decode the numbers. Raises ConfigError or ValueError: the array contains no numbers."""
        if self.items is not None or not self._rest:
            raise ConfigError("an array of it holds no numbers")
        shape, dtype, fortran, data = self._rest
        return dtype.numbers(data).reshape(shape, order="F" if fortran else "C")


def _scalar(dtype: _Dtype, data: bytes) -> float:
    """Decode a single number; stand-in for numpy's `scalar` constructor."""
    return float(dtype.numbers(data)[0])


_STAND_INS: dict[tuple[str, str], Any] = {("numpy", "ndarray"): _Array, ("numpy", "dtype"): _Dtype} | {
    (f"numpy.{core}.multiarray", name): stand_in
    for core in ("core", "_core")  # names of this numpy module before and since version 2
    for name, stand_in in (("_reconstruct", _Array), ("scalar", _scalar))
}


class _NumbersOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in for a name in the file. Raises ConfigError: a trajectory does not need that name."""
        if (module, name) not in _STAND_INS:
            raise ConfigError(
                f"it asks for {module}.{name}, and a trajectory holds only numbers; it may be made to run code: do not "
                "open it with np.load"
            )
        return _STAND_INS[module, name]

    def persistent_load(self, pid: object) -> Any:
        """Raise ConfigError: the file refers to an object outside the file."""
        raise ConfigError("it refers to something outside of the file")
