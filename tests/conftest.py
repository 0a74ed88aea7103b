"""What all tests share: a runtime directory of their own, a virtual rig, and a check that nothing is left behind."""

import contextlib
import enum
import fcntl
import functools
import os
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

# Set before anything is imported that reads them once. Unix sockets live in the runtime directory: a short path.
RUNTIME = Path(tempfile.mkdtemp(prefix="yam-test-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None))
os.environ["YAM_RUNTIME_DIR"] = str(RUNTIME)
os.environ["HF_LEROBOT_HOME"] = str(RUNTIME / "home")
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ.pop("YAM_RIG", None)
os.environ.pop("HF_LEROBOT_CALIBRATION", None)
# Under nohup and in the background of a script these are ignored, by us and by whatever we start.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest  # noqa: E402
from tqdm import tqdm  # noqa: E402

from lerobot_robot_yam.rig.control import RigControl, running_rig  # noqa: E402

tqdm.monitor_interval = 0  # LeRobot shows progress bars, whose watching thread would outlive a test

_SETTLE_S = 10.0  # a rig ends about a second after its last client, a renderer with its rig
_WORKER = "PYTEST_XDIST_WORKER" in os.environ
_MARK = f"YAM_RUNTIME_DIR={RUNTIME}\0".encode()


class _Share(enum.IntEnum):
    """What a test may have beside it, in the order in which they run."""

    BUSY = 0
    ALONE = 1
    UNTIMED = 2
    ORDINARY = 3


def _share(item: pytest.Item) -> _Share:
    marked = [share for share in _Share if item.get_closest_marker(share.name.lower())]
    return marked[0] if marked else _Share.ORDINARY


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """One of several workers does what is busy or alone; meanwhile another does what is untimed."""
    if _WORKER:
        items.sort(key=_share)
        for item in items:
            share = _share(item)
            group = "busy" if share <= _Share.ALONE else f"{share.name.lower()}-{item.path.stem}"
            item.add_marker(pytest.mark.xdist_group(group))


@contextlib.contextmanager
def _patient() -> Iterator[None]:
    """With what nobody else wants of the processors, children included; where we may take that back again."""
    if os.geteuid() != 0:
        yield
        return
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@functools.cache
def _lock(config: pytest.Config, name: str) -> int:
    """Descriptor of a file whose lock says who may use the machine."""
    return os.open(config._tmp_path_factory.getbasetemp().parent / name, os.O_CREAT | os.O_RDWR)


@pytest.hookimpl(wrapper=True, tryfirst=True)  # whoever waits here has not begun: no time limit runs yet
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Several workers share the machine as the markers say; one that is busy stays so to the end of its kind."""
    if not _WORKER:
        return (yield)
    share = _share(item)
    timed, rest = _lock(item.config, "timed"), _lock(item.config, "untimed")
    if share is _Share.UNTIMED:
        fcntl.flock(rest, fcntl.LOCK_SH)
        try:
            with _patient():
                return (yield)
        finally:
            fcntl.flock(rest, fcntl.LOCK_UN)
    fcntl.flock(timed, fcntl.LOCK_SH if share is _Share.ORDINARY else fcntl.LOCK_EX)
    if share is _Share.ALONE:
        fcntl.flock(rest, fcntl.LOCK_EX)
    try:
        return (yield)
    finally:
        following = _Share.ORDINARY if nextitem is None else _share(nextitem)
        if following > _Share.ALONE:
            fcntl.flock(timed, fcntl.LOCK_UN)
            fcntl.flock(rest, fcntl.LOCK_UN)


def _processes() -> dict[int, str]:
    """Command lines of all processes that were started, however indirectly, by these tests."""
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            if _MARK in (entry / "environ").read_bytes():
                found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # ended meanwhile, or somebody else's
    return {pid: line for pid, line in found.items() if "multiprocessing.resource_tracker" not in line}


def _left() -> dict[str, set[str]]:
    """Everything that could be left behind, by kind."""
    files = {str(p.relative_to(RUNTIME)) for p in RUNTIME.rglob("*")} if RUNTIME.is_dir() else set()
    return {
        "processes": {f"{pid} {line}" for pid, line in _processes().items()},
        "threads": {f"{t.name} {t.ident}" for t in threading.enumerate()},
        "files": {name for name in files if name.partition("/")[0] != "home"},
    }


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fails a test after which a process, thread, socket, lock or shared block exists that did not before."""
    before = _left()
    yield
    deadline = time.monotonic() + _SETTLE_S
    while True:
        extra = {kind: names - before[kind] for kind, names in _left().items() if names - before[kind]}
        if not extra or time.monotonic() > deadline:
            break
        time.sleep(0.05)
    assert not extra, f"left behind: {extra}"


@pytest.fixture
def rig() -> Iterator[RigControl]:
    """A virtual rig of this test, without operator."""
    with running_rig() as rig:
        yield rig


def pytest_sessionfinish() -> None:
    import shutil

    shutil.rmtree(RUNTIME, ignore_errors=True)
