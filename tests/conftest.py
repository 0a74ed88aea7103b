"""What all tests share: a runtime directory of their own, a virtual rig, and a check that nothing is left behind."""

import contextlib
import fcntl
import functools
import gc
import importlib.metadata
import inspect
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

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
from draccus.wrappers import docstring  # noqa: E402
from tqdm import tqdm  # noqa: E402

from lerobot_robot_yam.rig.control import RigControl, running_rig  # noqa: E402
from tests.support import lerobot_tree  # noqa: E402
from tests.support.stillness import Stillness  # noqa: E402

# The longest parts of parsing a command: draccus looks for the help of each option in the source, and for the arguments
# of argparse's actions, every time again.
docstring.get_attribute_docstring = functools.cache(docstring.get_attribute_docstring)
inspect.getfullargspec = functools.cache(inspect.getfullargspec)
tqdm.monitor_interval = 0  # LeRobot shows progress bars, whose watching thread would outlive a test

_SETTLE_S = 10.0  # a rig ends about a second after its last client, a renderer with its rig
_WORKER = "PYTEST_XDIST_WORKER" in os.environ
_MARK = f"YAM_RUNTIME_DIR={RUNTIME}\0".encode()
_TRACKER = "multiprocessing.resource_tracker"
_LONGEST = "test_conformance.py"  # one test of a minute
_elders = set(os.listdir("/proc"))  # they ran before any test did
_stillness = Stillness(Path(os.environ.setdefault("YAM_TEST_STILLNESS", str(RUNTIME) + "-stillness")))
_begun = 0.0  # the present attempt at a test
_leaked = False  # it left something behind: the next attempt would take that for what was there before
_floor: IO[str] | None = None  # the lock that says who may use the machine, while we hold it


def pytest_addoption(parser: pytest.Parser, pluginmanager: pytest.PytestPluginManager) -> None:
    """`--lerobot=PATH`: the same tests with a newer LeRobot. With a space, pytest would take PATH for tests to run.

    It is used from here on: the next conftest that is loaded may import LeRobot.
    """
    parser.addoption("--lerobot", type=Path, metavar="PATH", help="a checkout of LeRobot to use, not the installed one")
    config = pluginmanager.get_plugin("pytestconfig")
    assert isinstance(config, pytest.Config)
    given = [word.partition("=")[2] for word in config.invocation_params.args if word.startswith("--lerobot=")]
    if not given:
        return
    if _WORKER:  # which has its environment, but not its path, of the process that has started it
        sys.path.insert(0, os.environ["PYTHONPATH"].partition(os.pathsep)[0])
        return
    (RUNTIME / "lerobot").mkdir()
    try:
        lerobot_tree.use(Path(given[-1]), RUNTIME / "lerobot")
    except FileNotFoundError as error:
        raise pytest.UsageError(f"--lerobot: {given[-1]} is no checkout of LeRobot ({error})") from error


def pytest_configure(config: pytest.Config) -> None:
    """One process for all workers."""
    if not _WORKER:
        config.add_cleanup(_stillness.start().kill)


def pytest_report_header() -> str:
    """Which LeRobot is tested."""
    return f"lerobot {importlib.metadata.version('lerobot')}"


def pytest_collection_finish() -> None:
    """What is loaded by now stays: each walk of Python's collector over torch and LeRobot takes a third of a second."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """What stood still before does not count."""
    global _begun, _leaked
    _begun, _leaked = time.monotonic(), False


def _disturbed() -> bool:
    return not _leaked and _stillness.late_s() > _begun


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A failure on a machine that stood still is tried again. Modules that need the machine alone come first.

    One after another (with --no-loadscope-reorder): between others, each time one worker would wait for the other. The
    longest module comes in the middle of the others: earlier, those that need the machine would wait for its one test,
    and at the end everybody would.
    """
    for item in items:
        if item.path.parent.name == "cli" and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(900))  # of all tries together
        # Property tests draw other cases next time, and simulated time does not stand still.
        if item.path.parent.name != "properties" and "lockstep" not in item.nodeid:
            item.add_marker(pytest.mark.flaky(reruns=2, condition=_disturbed))
    alone = {item.path for item in items if _is_alone(item)}
    others = [path for path in dict.fromkeys(item.path for item in items) if path not in alone]
    half = set(others[: len(others) // 2])
    items.sort(key=lambda item: (item.path not in alone, item.path not in half, item.path.name != _LONGEST))


def _locked(path: Path, kind: int) -> IO[str]:
    file = open(path, "w")
    fcntl.flock(file, kind)
    return file


def _is_alone(item: pytest.Item) -> bool:
    return item.get_closest_marker("alone") is not None


@pytest.hookimpl(wrapper=True, tryfirst=True)  # no time limit runs yet for who waits here
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Several workers share the machine; a test marked `alone` has it to itself. Whoever waits first goes first.

    From one such test of a module to its next the machine is kept: the arms that they share are live in between.
    """
    global _floor
    shared = item.config._tmp_path_factory.getbasetemp()
    if _WORKER:
        shared = shared.parent
    if _floor is None:
        with _locked(shared / "turnstile", fcntl.LOCK_EX):
            _floor = _locked(shared / "floor", fcntl.LOCK_EX if _is_alone(item) else fcntl.LOCK_SH)
    try:
        return (yield)
    finally:
        if not (_is_alone(item) and nextitem and nextitem.path == item.path and _is_alone(nextitem)):
            _floor.close()
            _floor = None


def _processes() -> dict[int, str]:
    """Command lines of all processes that were started, however indirectly, by these tests."""
    found, running = {}, set(os.listdir("/proc"))
    _elders.intersection_update(running)  # the number of one that has ended may be given again
    for name in running - _elders:
        entry = Path("/proc", name)
        try:
            if name.isdigit() and _MARK in (entry / "environ").read_bytes():
                found[int(name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # ended meanwhile, or somebody else's
    return {pid: line for pid, line in found.items() if _TRACKER not in line}


def _left() -> dict[str, set[str]]:
    """Everything that could be left behind, by kind."""
    files: set[str] = set()
    for directory, below, names in os.walk(RUNTIME):
        if directory == str(RUNTIME):
            below[:] = [name for name in below if name != "home"]  # LeRobot's, full of data sets
        files |= {os.path.relpath(os.path.join(directory, name), RUNTIME) for name in (*below, *names)}
    return {
        "processes": {f"{pid} {line}" for pid, line in _processes().items()},
        "threads": {f"{t.name} {t.ident}" for t in threading.enumerate()},
        "sockets": _sockets(),
        "files": files,
    }


def _sockets() -> set[str]:
    found = set()
    for entry in os.scandir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # of this very look
            found.add(os.readlink(entry.path))
    return {target for target in found if target.startswith("socket:")}


def _what_is_new(before: dict[str, set[str]]) -> dict[str, set[str]]:
    """What is there that was not before, once it has had time to go."""
    deadline = time.monotonic() + _SETTLE_S
    while True:
        extra = {kind: names - before[kind] for kind, names in _left().items() if names - before[kind]}
        if not extra or time.monotonic() > deadline:
            return extra
        time.sleep(0.05)


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fails a test after which a process, thread, socket, lock or shared block exists that did not before."""
    global _leaked
    before = _left()
    yield
    extra = _what_is_new(before)
    (RUNTIME / "emergency-stop").unlink(missing_ok=True)  # of a test that has failed: no other shall fail of it
    _leaked = bool(extra)
    assert not extra, f"left behind: {extra}"


@pytest.fixture(autouse=True, scope="module")
def nothing_left_behind_by_a_module() -> Iterator[None]:
    """The same of what the tests of a module share, which is there before the first of them and after the last."""
    before = _left()
    yield
    extra = _what_is_new(before)
    assert not extra, f"left behind: {extra}"


@pytest.fixture
def rig() -> Iterator[RigControl]:
    """A virtual rig of this test, without operator."""
    with running_rig() as rig:
        yield rig


def pytest_sessionfinish() -> None:
    import shutil

    shutil.rmtree(RUNTIME, ignore_errors=True)
    if not _WORKER:
        Path(os.environ["YAM_TEST_STILLNESS"]).unlink(missing_ok=True)
