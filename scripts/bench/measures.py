"""Measurements of the benchmark, one function per figure or per group of figures that share a session.

Each function takes the settings and fills in `Results`; the names of the figures are keys of the JSON report.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from bench.runner import Subject, cpu_s, driver, measure_periods, percentiles
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S

ARMS, MOTORS = 2, 7
WIRE_LIMIT_HZ = 1.0 / (2 * MOTORS * FRAME_TIME_S)  # one command and one reply per motor
CONTROL_HZ = 250.0
LATENCY_S = 0.00025  # latency of a USB adapter in each direction
LEROBOT_HZ = 60.0  # the faster of LeRobot's usual rates
AGE_HZ = 61.7  # close to LEROBOT_HZ, but out of step with the control rate, so that all phases between two ticks occur


@dataclass
class Settings:
    """Durations of the measurements.

    Attributes:
        seconds: duration for each distribution of periods.
        short_s: duration for every other figure.
    """

    seconds: float = 20.0
    short_s: float = 5.0


@dataclass
class Results:
    """Figures by driver and name, and the periods from which they were computed (ms)."""

    figures: dict[str, dict[str, Any]] = field(default_factory=dict)
    periods_ms: dict[str, np.ndarray] = field(default_factory=dict)

    def put(self, driver_name: str, name: str, value: Any) -> None:
        """Set a figure."""
        self.figures.setdefault(driver_name, {})[name] = value

    def put_periods(self, driver_name: str, name: str, periods_ms: np.ndarray) -> None:
        """Compute the figure `name`_ms from periods, and keep the periods for the plot."""
        self.put(driver_name, f"{name}_ms", percentiles(periods_ms, (50, 99, 99.9)))
        self.periods_ms[f"{driver_name} {name}"] = periods_ms

    def put_rate(self, driver_name: str, name: str, periods_ms: np.ndarray) -> None:
        """Compute and set a tick rate, Hz."""
        self.put(driver_name, name, 1e3 / float(periods_ms.mean()) if len(periods_ms) else float("nan"))


def ours_at_250_hz(settings: Settings, results: Results) -> None:
    """Measure periods at the rig, caller idle and hogged, and the loop's CPU per arm, with the loop in a process."""
    with driver("ours", arms=ARMS, rate_hz=CONTROL_HZ) as (rig, subject):
        loop, begin = subject.loop_pid(), time.monotonic()
        used = cpu_s(loop)
        results.put_periods("ours", "idle", measure_periods(rig, settings.seconds))
        share = (cpu_s(loop) - used) / (time.monotonic() - begin)
        results.put("ours", "cpu_per_arm", share / ARMS)
        with subject.hogging():
            results.put_periods("ours", "hogged", measure_periods(rig, settings.seconds))


def ours_mobile(settings: Settings, results: Results) -> None:
    """Measure the periods and the CPU of each process with two arms and a turning base in one loop."""
    with driver("ours", scene="mobile_tables", arms=ARMS, rate_hz=CONTROL_HZ, base=True) as (rig, subject):

        def work(seconds: float) -> None:
            subject.request("work", seconds=seconds, rate_hz=LEROBOT_HZ, ages=False)

        processes, begin = subject.processes(), time.monotonic()
        used = {name: cpu_s(pid) for name, pid in processes.items()}
        results.put_periods("ours", "mobile_idle", measure_periods(rig, settings.seconds, work))
        elapsed_s = time.monotonic() - begin
        for name, pid in processes.items():
            results.put("ours", f"mobile_cpu_{name}", (cpu_s(pid) - used[name]) / elapsed_s)
        with subject.hogging():
            results.put_periods("ours", "mobile_hogged", measure_periods(rig, settings.seconds))


def ours_as_thread(settings: Settings, results: Results) -> None:
    """Measure the same periods with the loop in a thread of the caller."""
    with driver("ours", arms=ARMS, rate_hz=CONTROL_HZ, isolation="thread") as (rig, subject):
        results.put_periods("ours", "thread_idle", measure_periods(rig, settings.short_s))
        with subject.hogging():
            results.put_periods("ours", "thread_hogged", measure_periods(rig, settings.seconds))


def ours_unthrottled(settings: Settings, results: Results) -> None:
    """Measure the maximum tick rate that the wire allows."""
    _put_rates(settings, results, "ours", "ours", rate_hz=0.0)


def _put_rates(settings: Settings, results: Results, name: str, kind: str, **job: Any) -> None:
    """Measure tick rates of a self-running driver: one arm, without and with adapter latency, and two arms."""
    for key, latency_s, arms in (
        ("unthrottled", 0.0, 1),
        ("unthrottled_latency", LATENCY_S, 1),
        ("unthrottled_two_arms", 0.0, 2),
    ):
        with driver(kind, latency_s, arms=arms, **job) as (rig, _):
            results.put_rate(name, f"{key}_hz", measure_periods(rig, settings.short_s))


def ours_robot(settings: Settings, results: Results) -> None:
    """Measure `BiYamFollower` without cameras: cost of get_observation + send_action, and age of the observations."""
    with driver("ours_robot") as (_, subject):
        _put_get_send(settings, results, "ours", subject)
    with driver("ours_robot", temperatures=True) as (_, subject):
        _put_age(settings, results, "ours", subject)


def damiao_bus(settings: Settings, results: Results) -> None:
    """Measure LeRobot's `DamiaoMotorsBus` with the calls of LeRobot's OpenArm robot, classic CAN."""
    with driver("damiao_bus", arms=2) as (_, subject):
        _put_age(settings, results, "damiao_bus", subject)
    with driver("damiao_bus", arms=2) as (_, subject):
        _put_get_send(settings, results, "damiao_bus", subject)
    for name, latency_s in (("unthrottled", 0.0), ("unthrottled_latency", LATENCY_S)):
        with driver("damiao_bus", latency_s, arms=1) as (rig, subject):

            def spin(seconds: float, subject: Subject = subject) -> None:
                subject.request("work", seconds=seconds, rate_hz=1e6, ages=False)

            results.put_rate("damiao_bus", f"{name}_hz", measure_periods(rig, settings.short_s, spin))


def vendor(settings: Settings, results: Results) -> None:
    """Measure the vendor's SDK from the package index: its robots, which run at no fixed rate, and its chain alone."""
    if find_spec("i2rt") is None:
        results.put("vendor", "missing", "dreamscale-i2rt is not installed (pip install dreamscale-i2rt)")
        return
    with driver("vendor", arms=ARMS) as (rig, subject):
        used, begin = cpu_s(subject.pid), time.monotonic()
        results.put_periods("vendor", "idle", measure_periods(rig, settings.seconds))
        share = (cpu_s(subject.pid) - used) / (time.monotonic() - begin)
        results.put("vendor", "cpu_per_arm", share / ARMS)
        with subject.hogging():
            results.put_periods("vendor", "hogged", measure_periods(rig, settings.seconds))
    with driver("vendor", arms=2) as (_, subject):
        _put_age(settings, results, "vendor", subject)
        _put_get_send(settings, results, "vendor", subject)
    _put_rates(settings, results, "vendor", "vendor")
    with driver("vendor_chain", arms=1) as (rig, _):
        results.put_rate("vendor", "chain_alone_hz", measure_periods(rig, settings.short_s))


def _put_get_send(settings: Settings, results: Results, name: str, subject: Subject) -> None:
    """Measure the median of get + send at LeRobot's rate, with cold caches each time, and back to back."""
    for key, rate_hz in (("get_send_paced_ms", LEROBOT_HZ), ("get_send_ms", 1e6)):
        rows = np.array(subject.request("work", seconds=settings.short_s, rate_hz=rate_hz, ages=False)["rows"])
        results.put(name, key, float(np.median(rows[:, 0])))


def _put_age(settings: Settings, results: Results, name: str, subject: Subject) -> None:
    rows = np.array(subject.request("work", seconds=settings.short_s, rate_hz=AGE_HZ)["rows"])
    results.put(name, "age_ms", percentiles(rows[:, 1], (50, 99)))


STEPS: dict[str, Callable[[Settings, Results], None]] = {
    "ours.250hz": ours_at_250_hz,
    "ours.mobile": ours_mobile,
    "ours.thread": ours_as_thread,
    "ours.unthrottled": ours_unthrottled,
    "ours.robot": ours_robot,
    "damiao_bus": damiao_bus,
    "vendor": vendor,
}


def report(settings: Settings, results: Results) -> dict[str, Any]:
    """Return the JSON report, without the machine."""
    return {"wire_limit_hz": WIRE_LIMIT_HZ, "settings": asdict(settings), **results.figures}
