"""What other processes or other days have left behind may be damaged: blocks in memory, files on disk."""

import itertools
import json
import math
import struct

import numpy as np
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, load_stops, save_stops, verify_stops
from lerobot_robot_yam.control.preflight.binding import Binding, check_identity
from lerobot_robot_yam.control.preflight.fingerprint import Adapter, Fingerprint, MotorPrint
from lerobot_robot_yam.errors import ChannelInUseError, ConfigError, GripperError, MotorError, StaleStateError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system import shared_block
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.cases import SPECIAL, documents, for_all, mutations, numbers

DTYPE = np.dtype([("counter", "u8"), ("values", "f8", 6), ("text", "S9")])
HEADER = 24  # bytes before the record: magic, sequence, size, checksum
_FRESH = itertools.count()


@pytest.fixture(scope="module")
def impatient():
    """A reader of a block that never becomes whole waits 0.25 s; here it looks twice."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shared_block, "_READ_TIMEOUT_S", 0.0)
        yield


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return tmp_path_factory.mktemp("stored")


@pytest.fixture(scope="module")
def runtime(directory):
    """A runtime directory of these tests: an emergency stop there stops nobody else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("YAM_RUNTIME_DIR", str(directory))
        yield directory


def record(counter):
    out = np.zeros((), DTYPE)
    out["counter"], out["values"], out["text"] = counter, counter / 3, str(counter)
    return out


def damages():
    """(offset, bytes) written over a block behind its writer's back."""
    size = HEADER + DTYPE.itemsize
    anywhere = st.tuples(st.integers(0, size - 1), st.binary(min_size=1, max_size=16))
    sequence = st.tuples(st.just(8), st.integers(0, 9).map(lambda n: struct.pack("<Q", n)))
    return st.lists(anywhere | sequence, min_size=1, max_size=4)


@for_all(written=st.lists(st.integers(0, 2**64 - 1), max_size=3), damage=damages(), late=st.booleans())
def test_a_damaged_block_gives_a_whole_record_or_an_error(impatient, directory, written, damage, late):
    path = directory / f"block-{next(_FRESH)}"
    writer = SharedBlock(path, DTYPE, create=True)
    readers = [] if late else [SharedBlock(path, DTYPE, create=False)]
    try:
        for counter in written:
            writer.write(record(counter))
        for offset, data in damage:
            end = min(offset + len(data), HEADER + DTYPE.itemsize)
            writer._map[offset:end] = data[: end - offset]  # nobody else can
        if late:
            try:
                readers = [SharedBlock(path, DTYPE, create=False)]
            except StaleStateError as error:
                assert "layout" in str(error)
        for reader in readers:
            try:
                found = reader.read()
            except StaleStateError as error:
                assert str(path) in str(error)
            else:
                if found is None:
                    assert reader.sequence() == 0
                else:
                    assert found.tobytes() in [record(counter).tobytes() for counter in written]
        writer.write(record(7))
        if writer.sequence() and not writer.sequence() % 2:  # the writer's own count survived
            for reader in readers:
                assert reader.read()["counter"] == 7
    finally:
        for block in (*readers, writer):
            block.close()


@for_all(
    first=st.integers(0, 2**64 - 1), second=st.integers(0, 2**64 - 1), done=st.integers(0, 200), adopt=st.booleans()
)
def test_a_write_that_was_cut_short_is_never_read(impatient, directory, first, second, done, adopt):
    """The writer dies after `done` bytes of the new record; a successor may go on with the block."""
    path = directory / f"block-{next(_FRESH)}"
    writer = SharedBlock(path, DTYPE, create=True)
    writer.write(record(first))
    reader = SharedBlock(path, DTYPE, create=False)
    new = record(second).tobytes()
    writer._sequence[0] += 1
    cut = min(done, len(new))
    writer._map[HEADER : HEADER + cut] = new[:cut]
    with pytest.raises(StaleStateError):
        reader.read()
    if adopt:
        writer.adopt()
        try:
            found = reader.read()
            assert found is None or found.tobytes() in (record(first).tobytes(), new)
        except StaleStateError:
            pass
        writer.write(record(5))
        assert reader.read()["counter"] == 5
    reader.close()
    writer.close()


@for_all(size=st.integers(0, 200), data=st.binary(max_size=100))
def test_a_file_that_is_no_block_is_refused(directory, size, data):
    path = directory / f"block-{next(_FRESH)}"
    path.write_bytes(data.ljust(size, b"\0"))
    with pytest.raises(StaleStateError, match="layout"):
        SharedBlock(path, DTYPE, create=False)
    path.unlink()


@for_all(holder=st.binary(max_size=40))
def test_a_lock_is_refused_whatever_its_holder_wrote(directory, holder):
    path = directory / "lock"
    with FileLock(path, "channel can0"):
        path.write_bytes(holder)
        with pytest.raises(ChannelInUseError, match="can0"):
            FileLock(path, "channel can0").acquire()


GRIPPER = load_gripper("linear_4310")
GOOD = {"version": 1, "gripper": "linear_4310", "closed_rad": 3.25, "open_rad": -3.3}


@st.composite
def files(draw):
    """The bytes of a calibration file, damaged."""
    kind = draw(st.sampled_from(["values", "values", "values", "bytes", "else", "deep"]))
    if kind == "deep":
        return b"[" * draw(st.integers(1, 20_000))
    if kind == "else":
        return json.dumps(draw(documents()), default=str).encode()
    data = dict(GOOD)
    if kind == "values":
        plain = numbers().map(lambda x: x.item() if hasattr(x, "item") else x)
        near = st.floats(-4, 4) | st.sampled_from([*SPECIAL, True, None, "3.25", "linear_4310", 3, -4])
        for key in draw(st.lists(st.sampled_from([*GOOD, "closed_rad", "open_rad", "extra"]), min_size=1, max_size=2)):
            data[key] = draw(near | plain)
            if draw(st.integers(0, 4)) == 0:
                del data[key]
    raw = bytearray(json.dumps(data).encode())
    if kind == "bytes":
        at = draw(st.integers(0, len(raw)))
        raw[at : at + draw(st.integers(0, 5))] = draw(st.binary(max_size=3))
    return bytes(raw)


@for_all(short=50, data=files())
def test_stored_stops_are_right_or_refused(directory, data):
    path = directory / "gripper.json"
    path.write_bytes(data)
    try:
        stops = load_stops("left", path, "linear_4310")
        assert stops is not None
        assert math.isfinite(stops.closed_rad) and math.isfinite(stops.open_rad)
        next(verify_stops("left", GRIPPER.calibration, stops))
    except GripperError as error:
        assert "gripper" in str(error)
        return
    span = GRIPPER.calibration.min_span_rad, GRIPPER.calibration.max_span_rad
    assert span[0] <= abs(stops.span_rad) <= span[1] and stops.closed_rad > stops.open_rad


FOUND = Fingerprint({1: MotorPrint(40.0, 12.5, 10.0, 28.0, 4711, 10, 5013, 0)}, (2, 4, 0), Adapter("0001", "usb-1-2"))
BINDING = {
    "kind": "yam arm binding",
    "version": 1,
    "name": "left",
    "channel": "can0",
    "fingerprint": FOUND.to_dict(),
}


@for_all(short=50, document=mutations(BINDING))
def test_a_stored_binding_is_compared_or_refused(directory, document):
    path = directory / "binding.json"
    try:
        path.write_text(json.dumps(document, default=str))
    except TypeError:  # keys that JSON does not have
        return
    try:
        binding = Binding.load(path)
        assert binding is not None and isinstance(binding.name, str)
        check_identity(path, FOUND, "can0", "left")
    except (ConfigError, MotorError) as error:
        assert str(error)


@for_all(short=50, data=st.binary(max_size=40) | documents().map(lambda data: json.dumps(data, default=str).encode()))
def test_an_emergency_stop_stands_whatever_its_file_says(runtime, data):
    (runtime / "emergency-stop").write_bytes(data)
    stop = EmergencyStop()
    assert stop.latched and isinstance(stop.reason(), str)
    stop.latch("again")
    assert stop.latched
    stop.release()
    assert not stop.latched and stop.reason() == ""


@for_all(short=50, closed=st.floats(-20, 20), opened=st.floats(-20, 20))
def test_stops_are_read_back_as_they_were_stored(directory, closed, opened):
    path = directory / "deeper" / "gripper.json"
    save_stops("left", path, "linear_4310", GripperStops(closed, opened))
    assert load_stops("left", path, "linear_4310") == GripperStops(closed, opened)
    with pytest.raises(GripperError, match="crank_4310"):
        load_stops("left", path, "crank_4310")
