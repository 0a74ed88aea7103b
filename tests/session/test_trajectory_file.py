"""Files of trajectories: ours, the vendor's, and those that try to run code."""

import builtins
import os
import pickle

import numpy as np
import pytest

from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.session.trajectory_file import load_trajectory, save_trajectory

ROWS = np.linspace(0.0, 0.6, 28).reshape(4, 7)
TIMES = np.array([7.0, 7.016, 7.034, 7.05])
_HEADER, _FRAME = 128, b"\x95"  # of an .npy file, bytes; opcode of a pickle, before the length of what follows


def vendor(path, **changes):
    """A file as the vendor's example saves it."""
    np.save(path, {"trajectory": ROWS, "timestamps": TIMES, "frequency": 60.0} | changes)
    return path


@pytest.mark.parametrize("dtype", ["<f8", ">f4", "<i8"])
def test_the_vendors_file_loads(tmp_path, dtype):
    rows = (ROWS * 10).astype(dtype)
    loaded = load_trajectory(vendor(tmp_path / "vendor.npy", trajectory=np.asfortranarray(rows)))
    np.testing.assert_allclose(loaded.positions, rows)
    np.testing.assert_allclose(loaded.times_s, TIMES - 7.0)


def test_a_file_of_an_older_numpy_loads(tmp_path):
    data = vendor(tmp_path / "new.npy", frequency=np.float64(60.0)).read_bytes()
    new, old = (bytes([0x8C, len(name)]) + name for name in (b"numpy._core.multiarray", b"numpy.core.multiarray"))
    assert data[_HEADER + 2 : _HEADER + 3] == _FRAME and new in data
    path = tmp_path / "old.npy"
    path.write_bytes((data[: _HEADER + 2] + data[_HEADER + 11 :]).replace(new, old))  # no frame: its length changes
    np.testing.assert_allclose(load_trajectory(path).positions, ROWS)


def test_what_is_saved_is_loaded_by_us_and_by_the_vendors_reader(tmp_path):
    path = tmp_path / "deep" / "ours.npy"
    save_trajectory(path, Trajectory(TIMES, ROWS, tuple("abcdefg")))
    ours, vendors = load_trajectory(path), np.load(path, allow_pickle=True).item()
    assert ours.columns == tuple("abcdefg")
    np.testing.assert_allclose(ours.positions[[0, -1]], ROWS[[0, -1]])
    np.testing.assert_allclose(ours.positions, vendors["trajectory"])
    np.testing.assert_allclose(np.diff(vendors["timestamps"]), 1.0 / vendors["frequency"])
    for key in ("trajectory", "timestamps"):
        assert vendors[key].tolist()


class Runs:
    """Asks whoever unpickles it to call something."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize(
    ("function", "argument", "named"),
    [
        (os.system, "touch ran", "posix.system"),
        (builtins.eval, "open('ran', 'w')", "builtins.eval"),
        (np.memmap, "ran", "numpy.memmap"),
        (np.load, "ran", "numpy.load"),
    ],
)
def test_nothing_in_a_file_is_run(tmp_path, monkeypatch, function, argument, named):
    monkeypatch.chdir(tmp_path)
    for content in (
        {"trajectory": Runs(function, argument), "timestamps": TIMES},
        {"trajectory": np.array([Runs(function, argument), None]), "timestamps": TIMES},
        Runs(function, argument),
    ):
        vendor_like = tmp_path / "evil.npy"
        np.save(vendor_like, content)
        with pytest.raises(ConfigError, match=f"evil.npy: it asks for {named}, .* may be made to run code"):
            load_trajectory(vendor_like)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"trajectory": "none"}, "its trajectory is no table of numbers"),
        ({"trajectory": np.array(["a", "b"])}, "holds '?U1'?, and a trajectory holds numbers"),
        ({"trajectory": np.array([[1.0], None, [2.0]], dtype=object)}, "an array of it holds no numbers"),
        ({"timestamps": {"a": 1}}, "its timestamps is no table of numbers"),
        ({"columns": [1, 2]}, "its names of columns are no texts"),
        ({"columns": ["one"]}, "1 names for 7 columns"),
        ({"timestamps": TIMES[::-1]}, "time goes back or stands still at row 1"),
    ],
)
def test_other_content_is_refused(tmp_path, changes, said):
    with pytest.raises((ConfigError, ActionError), match=said):
        load_trajectory(vendor(tmp_path / "odd.npy", **changes))


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "file.npy"
    with pytest.raises(ConfigError, match="cannot be read"):
        load_trajectory(path)
    path.write_text("hello")
    with pytest.raises(ConfigError, match="is no trajectory"):
        load_trajectory(path)
    np.save(path, ROWS)
    with pytest.raises(ConfigError, match="it is no dict that np.save has written"):
        load_trajectory(path)
    np.save(path, {"timestamps": TIMES})
    with pytest.raises(ConfigError, match="it has no trajectory"):
        load_trajectory(path)
    whole = vendor(path).read_bytes()
    for end in range(0, len(whole), 37):
        path.write_bytes(whole[:end])
        with pytest.raises(ConfigError):
            load_trajectory(path)
    path.write_bytes(whole[:_HEADER] + pickle.dumps([1, 2]))
    with pytest.raises(ConfigError, match="it has no dict"):
        load_trajectory(path)
    with pytest.raises(ConfigError, match="cannot be written"):
        save_trajectory(path / "below.npy", Trajectory(TIMES, ROWS))
