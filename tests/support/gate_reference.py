"""What a gate with `gate: auto` has to do, from where both arms truly were; the gate itself is asked nothing.

Each condition is a length c in rad that is above zero while it holds. A transition is early if its c was below zero all
through the last WINDOW ticks, and one is missed if a c was above zero all that time and the state stayed. The gate sees
samples some milliseconds old, and its filter carries a hand that trembles on by some mrad: that is what WINDOW and
MARGIN_RAD are for.
"""

import itertools
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.state.modes import Gate

TICK_S, WINDOW, MARGIN_RAD = 0.004, 5, 0.005


class Ticks(NamedTuple):
    """A pair of arms at k ticks of its leader, joints in rad.

    Attributes:
        gates: (k,) states of the gate.
        leader, follower: (k, joints) where they truly were.
        wanted: (k, joints) the follower's target.
        setpoint: (k, joints) the follower's set-point.
    """

    gates: list[Gate]
    leader: np.ndarray
    follower: np.ndarray
    wanted: np.ndarray
    setpoint: np.ndarray


def check_gates(config, ticks: Ticks) -> list[Gate]:
    """Assert that no transition was early or missed, or is unknown; returns the states as they follow each other."""
    changes = [i for i in range(1, len(ticks.gates)) if ticks.gates[i] is not ticks.gates[i - 1]]
    bounds = [0, *changes, len(ticks.gates)]
    for begin, end in itertools.pairwise(bounds):
        state = ticks.gates[begin]
        after = ticks.gates[end] if end < len(ticks.gates) else None
        held = {to: _windows(length) for to, length in _lengths(config, ticks, state, begin, end).items()}
        assert after is None or after in held, f"tick {end}: {state.name} -> {after.name}"
        for to, windows in held.items():
            readings = 2 if (state, to) == (Gate.HOMING, Gate.APPROACH) else 1  # the lift is the difference of two
            margin = readings * MARGIN_RAD
            missed = windows[WINDOW:-1].min(axis=1, initial=np.inf) > margin
            assert not missed.any(), f"tick {begin + WINDOW + missed.argmax()}: {state.name} -> {to.name} was missed"
            if to is after:
                assert windows[-1].max() > -margin, f"tick {end}: {state.name} -> {to.name} was early"
    return [ticks.gates[i] for i in bounds[:-1]]


def _windows(length: np.ndarray) -> np.ndarray:
    """(k, WINDOW + 1): each tick's value and those before it."""
    padded = np.concatenate([np.full(WINDOW, length[0]), length])
    return np.lib.stride_tricks.sliding_window_view(padded, WINDOW + 1)


def _lengths(config, ticks: Ticks, state: Gate, begin: int, end: int) -> dict[Gate, np.ndarray]:
    """c of each way out of a state that lasts from tick `begin` to `end`: (end − begin + 1,)."""
    here = slice(begin, end + 1)
    counted = [joint - 1 for joint in config.gate_joints]
    away = np.abs(ticks.leader[:, counted]).max(axis=1)
    if state is Gate.HOMING:
        least = np.minimum.accumulate(away[here])
        home = np.linalg.norm(ticks.setpoint[here], axis=1) - 0.05, np.abs(ticks.leader[here]).max(axis=1) - 0.1
        return {
            Gate.APPROACH: away[here] - np.maximum(config.engage_threshold_rad, least + 0.15),
            Gate.IDLE: -np.maximum(*home),
        }
    if state is Gate.IDLE:
        return {Gate.APPROACH: away[here] - config.engage_threshold_rad}
    back = round(config.release_s / TICK_S)
    lately = [away[max(tick - back, 0) : tick + 1].max() for tick in range(begin, min(end + 1, len(away)))]
    found = {Gate.HOMING: config.release_threshold_rad - np.array(lately)}
    if state is Gate.APPROACH:
        way_s = np.pi / 2 * np.abs(ticks.leader - ticks.follower)[begin].max() / config.approach_speed_rad_s
        run = (np.arange(len(lately)) + 2) * TICK_S >= max(config.approach_s, way_s)  # its gate saw a smaller gap
        gap = np.abs(ticks.follower - ticks.wanted)[here].max(axis=1)
        found[Gate.ENGAGED] = np.where(run, 0.05 - gap, -1.0)
    return found
