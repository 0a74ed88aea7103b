"""What the bench measures, one function per figure or group of figures that share a session.

Each takes the settings and fills in a `Results`; the figures' names are the keys of the JSON report.
"""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from bench.runner import CHANNEL, BenchError, Subject, driver, measure_periods, measure_work
from bench.windows import Periods, cpu_s, percentiles
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S
from lerobot_robot_yam.rig.client.rig_control import RigControl

MOTORS = 7
WIRE_LIMIT_HZ = 1.0 / (2 * MOTORS * FRAME_TIME_S)  # a command and a reply per motor
CONTROL_HZ = 250.0
LATENCY_S = 0.00025  # of a USB adapter, each way
LEROBOT_HZ = 60.0  # the faster of LeRobot's usual rates
AGE_HZ = 61.7  # about that, but out of step with the control rate, so that every phase between two ticks is seen
FRESH_MS = 1e3 / CONTROL_HZ + 2.0  # a sample is late beyond this age
_LOST_FRAMES = 4  # per repeat
_HICCUP_S = 0.2
_HICCUP_DELAY_S = 0.012


@dataclass
class Settings:
    """How long to look.

    Attributes:
        seconds: undisturbed time for each distribution of periods.
        short_s: the same for every other figure.
        arms: that our loop drives at 250 Hz, and the vendor's as fast as it does.
        repeats: of what is counted in events: imports, and four lost frames each.
    """

    seconds: float = 20.0
    short_s: float = 5.0
    arms: int = 2
    repeats: int = 5


@dataclass
class Results:
    """Figures by driver and name, the periods behind them (ms), and how much time counted."""

    figures: dict[str, dict[str, Any]] = field(default_factory=dict)
    periods_ms: dict[str, np.ndarray] = field(default_factory=dict)
    windows: dict[str, dict[str, float]] = field(default_factory=dict)

    def put(self, driver_name: str, name: str, value: Any) -> None:
        """Set a figure."""
        self.figures.setdefault(driver_name, {})[name] = value

    def count(self, driver_name: str, name: str, used_s: float, total_s: float) -> None:
        """Note on how much undisturbed time a figure stands."""
        self.windows[f"{driver_name}.{name}"] = {"used_s": round(used_s, 2), "total_s": round(total_s, 2)}

    def put_periods(self, driver_name: str, name: str, periods: Periods) -> None:
        """Set the figure `name`_ms from periods, and keep them for the plot."""
        self.put(driver_name, f"{name}_ms", periods.figures())
        self.put(driver_name, f"{name}_hz", periods.hz)
        self.periods_ms[f"{driver_name} {name}"] = periods.ms
        self.count(driver_name, f"{name}_ms", periods.used_s, periods.total_s)

    def put_rate(self, driver_name: str, name: str, periods: Periods) -> None:
        """Set a tick rate in Hz."""
        self.put(driver_name, name, periods.hz)
        self.count(driver_name, name, periods.used_s, periods.total_s)


def ours_at_250_hz(settings: Settings, results: Results) -> None:
    """Period at the rig with the caller idle and hogged, and the loop's CPU per arm: loop in its own process."""
    with driver("ours", arms=settings.arms, rate_hz=CONTROL_HZ) as (rig, subject, _):
        loop, begin = subject.loop_pid(), time.monotonic()
        used = cpu_s(loop)
        results.put_periods("ours", "idle", measure_periods(rig, settings.seconds))
        share = (cpu_s(loop) - used) / (time.monotonic() - begin)
        results.put("ours", "cpu_per_arm", share / settings.arms)
        with subject.hogging():
            results.put_periods("ours", "hogged", measure_periods(rig, settings.seconds))


def ours_as_thread(settings: Settings, results: Results) -> None:
    """The same with the loop in a thread of the caller."""
    with driver("ours", arms=settings.arms, rate_hz=CONTROL_HZ, isolation="thread") as (rig, subject, _):
        results.put_periods("ours", "thread_idle", measure_periods(rig, settings.short_s))
        with subject.hogging():
            results.put_periods("ours", "thread_hogged", measure_periods(rig, settings.seconds))


def ours_unthrottled(settings: Settings, results: Results) -> None:
    """Ticks per second as fast as the wire allows."""
    _put_rates(settings, results, "ours", "ours", rate_hz=0.0)


def _put_rates(settings: Settings, results: Results, name: str, kind: str, **job: Any) -> None:
    """Ticks per second of a driver that runs by itself: one arm, without and with adapter latency, and two arms."""
    for key, latency_s, arms in (
        ("unthrottled", 0.0, 1),
        ("unthrottled_latency", LATENCY_S, 1),
        ("unthrottled_two_arms", 0.0, 2),
    ):
        with driver(kind, latency_s, arms=arms, **job) as (rig, _, _):
            results.put_rate(name, f"{key}_hz", measure_periods(rig, settings.short_s))


def ours_robot(settings: Settings, results: Results) -> None:
    """`BiYamFollower` without cameras: cost of get_observation + send_action, time to connect."""
    with driver("ours_robot") as (_, subject, connect_s):
        results.put("ours", "connect_s", connect_s)
        _put_get_send(settings, results, "ours", subject)


def ours_age(settings: Settings, results: Results) -> None:
    """Age of what `BiYamFollower.get_observation` returns: undisturbed, and around single lost frames."""
    with driver("ours_robot", temperatures=True) as (rig, subject, _):
        _put_age(settings, results, "ours", subject)
        results.put("ours", "age_after_lost_frame_ms", lost_frames(rig, subject, _LOST_FRAMES * settings.repeats))
        _put_hiccup(results, "ours", rig, subject)


def damiao_bus(settings: Settings, results: Results) -> None:
    """LeRobot's own `DamiaoMotorsBus` with the calls of its OpenArm robot, classic CAN."""
    with driver("damiao_bus", arms=2) as (rig, subject, connect_s):
        results.put("damiao_bus", "connect_s", connect_s)
        _put_age(settings, results, "damiao_bus", subject)
        _put_hiccup(results, "damiao_bus", rig, subject)
    with driver("damiao_bus", arms=2) as (_, subject, _):
        _put_get_send(settings, results, "damiao_bus", subject)
    for name, latency_s, read in (
        ("unthrottled", 0.0, True),
        ("unthrottled_latency", LATENCY_S, True),
        ("unthrottled_write_only", 0.0, False),
    ):
        _put_damiao_rate(settings, results, name, latency_s, read)


def _put_damiao_rate(settings: Settings, results: Results, name: str, latency_s: float, read: bool) -> None:
    """Ticks per second of one arm, and how old the samples are meanwhile; `read` False only commands."""
    ages: list[float] = []
    with driver("damiao_bus", latency_s, arms=1, read=read) as (rig, subject, _):

        def spin(length_s: float, wait: Callable[[], None]) -> None:
            answer = subject.request("work", wait, seconds=length_s, rate_hz=1e6)
            ages.extend(age for _, _, age in answer["rows"])

        results.put_rate("damiao_bus", f"{name}_hz", measure_periods(rig, settings.short_s, spin))
    results.put("damiao_bus", f"{name}_age_ms", percentiles(np.array(ages), (50, 99)))


def vendor(settings: Settings, results: Results) -> None:
    """The maker's SDK from the package index: its robots, whose loops have no rate, and its chain alone."""
    if find_spec("i2rt") is None:
        results.put("vendor", "missing", "dreamscale-i2rt is not installed (pip install dreamscale-i2rt)")
        return
    with driver("vendor", arms=settings.arms) as (rig, subject, connect_s):
        results.put("vendor", "connect_s", connect_s)
        used, begin = cpu_s(subject.pid), time.monotonic()
        results.put_periods("vendor", "idle", measure_periods(rig, settings.seconds))
        share = (cpu_s(subject.pid) - used) / (time.monotonic() - begin)
        results.put("vendor", "cpu_per_arm", share / settings.arms)
        with subject.hogging():
            results.put_periods("vendor", "hogged", measure_periods(rig, settings.seconds))
    with driver("vendor", arms=2) as (_, subject, _):
        _put_age(settings, results, "vendor", subject)
        _put_get_send(settings, results, "vendor", subject)
    _put_rates(settings, results, "vendor", "vendor")
    with driver("vendor_chain", arms=1) as (rig, _, _):
        results.put_rate("vendor", "chain_alone_hz", measure_periods(rig, settings.short_s))


def imports(settings: Settings, results: Results) -> None:
    """Time to import both plugin packages as LeRobot does, in an interpreter that has imported lerobot."""
    code = (
        "import time, lerobot.cameras, lerobot.robots, lerobot.teleoperators\n"
        "begin = time.perf_counter()\n"
        "import lerobot_robot_yam, lerobot_teleoperator_yam\n"
        "print((time.perf_counter() - begin) * 1e3)\n"
    )
    # Installers compile; a checkout is compiled by the first of these runs.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    found = []
    for _ in range(1 + settings.repeats):
        run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
        if run.returncode:
            raise BenchError(f"importing the plugin failed:\n{run.stderr[-2000:]}")
        found.append(float(run.stdout.split()[-1]))
    results.put("ours", "import_ms", statistics.median(found[1:]))


def lost_frames(rig: RigControl, subject: Subject, count: int) -> dict[str, float]:
    """Watch the sample's age while single replies are lost.

    Returns:
        peak: the oldest sample seen, ms; over: the longest time for which samples stayed older than a tick + 2 ms,
        in ms (one tick is what a lost frame costs).
    """
    losses: list[float] = []

    def lose() -> None:
        time.sleep(0.1)
        rig.fault(CHANNEL, "joint_2", "drop_next", 1)
        losses.append(time.monotonic())

    answer = subject.request("work", lose, seconds=count * 0.1, rate_hz=2000.0, send=False)
    rows = np.array(answer["rows"])
    peaks, overs = [0.0], [0.0]
    for loss in losses:
        near = rows[(rows[:, 0] > loss - 0.005) & (rows[:, 0] < loss + 0.09)]
        if len(near) == 0:
            continue
        peaks.append(float(near[:, 2].max()))
        overs.append(_longest_late_ms(near))
    return {"peak": statistics.median(peaks[1:] or peaks), "over": statistics.median(overs[1:] or overs)}


def _longest_late_ms(rows: np.ndarray) -> float:
    """Length of the longest stretch of rows (monotonic s, ms, age ms) whose samples were all older than FRESH_MS."""
    longest = 0.0
    begin_s: float | None = None
    for now, _, age_ms in rows.tolist():
        if age_ms <= FRESH_MS:
            begin_s = None
        else:
            begin_s = now if begin_s is None else begin_s
            longest = max(longest, now - begin_s)
    return longest * 1e3


def _put_get_send(settings: Settings, results: Results, name: str, subject: Subject) -> None:
    """Median of get + send: at LeRobot's pace, where the caches are cold each time, and back to back."""
    for key, rate_hz in (("get_send_paced_ms", LEROBOT_HZ), ("get_send_ms", 1e6)):
        rows, used_s, total_s = measure_work(subject, settings.short_s, rate_hz=rate_hz, ages=False)
        results.put(name, key, float(np.median(rows[:, 1])) if len(rows) else float("nan"))
        results.count(name, key, used_s, total_s)


def _put_age(settings: Settings, results: Results, name: str, subject: Subject) -> None:
    rows, used_s, total_s = measure_work(subject, settings.short_s, rate_hz=AGE_HZ)
    results.put(name, "age_ms", percentiles(rows[:, 2], (50, 99)))
    results.count(name, "age_ms", used_s, total_s)


def _put_hiccup(results: Results, name: str, rig: RigControl, subject: Subject) -> None:
    """Median age in the second that begins half a second after every reply was late for a moment."""

    def disturb() -> None:
        time.sleep(0.5)
        rig.fault(CHANNEL, None, "delay_s", _HICCUP_DELAY_S)
        time.sleep(_HICCUP_S)
        rig.clear_faults(CHANNEL)
        ended.append(time.monotonic())
        time.sleep(1.7)

    ended: list[float] = []
    rows = np.array(subject.request("work", disturb, seconds=2.2, rate_hz=AGE_HZ)["rows"])
    after = rows[(rows[:, 0] > ended[0] + 0.5) & (rows[:, 0] < ended[0] + 1.5), 2]
    results.put(name, "age_after_hiccup_ms", percentiles(after, (50, 99)))


STEPS: dict[str, Callable[[Settings, Results], None]] = {
    "ours.250hz": ours_at_250_hz,
    "ours.thread": ours_as_thread,
    "ours.unthrottled": ours_unthrottled,
    "ours.robot": ours_robot,
    "ours.age": ours_age,
    "ours.import": imports,
    "damiao_bus": damiao_bus,
    "vendor": vendor,
}


def report(settings: Settings, results: Results) -> dict[str, Any]:
    """The JSON report, without the machine."""
    return {
        "wire_limit_hz": WIRE_LIMIT_HZ,
        "settings": asdict(settings),
        **results.figures,
        "windows": results.windows,
    }
