"""Report how a leader and its follower feel: lag, tracking, jerk, feedback, effort of the hand, control loops.

yam-feel --leader can_leader_l --follower can_follower_l               a running session, while you move the leader
yam-feel --leader leader_left --follower follower_left --rig NAME      the same on a virtual rig
yam-feel data/NAME --episode 3 --plot feel.png                         an episode of a data set, and a picture

A session is only observed: nothing is written to it, and nothing is sent on a bus. A data set yields only lag, tracking
and jerk, at its own rate. Exit status: 0 done; 1 it cannot be done; 2 wrong arguments.
"""

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.commands.lib.arm_command import add_place_arguments, place_of
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import say, table, tell
from lerobot_robot_yam.commands.lib.feel_figures import SPEED_RAD_S, Effort, Motion, effort, likeness, motion, periods_s
from lerobot_robot_yam.commands.lib.plot_file import plot_file
from lerobot_robot_yam.errors import BusError, ConfigError, StaleStateError
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.shared_block import SharedBlock

_HEAD = ("joint", "moved rad", "lag ms", "tracking mrad", "jerk ratio", "feedback Nm", "largest", "backdrive Nm")
_LOOK_S = 0.0005  # polling interval of the published states, s: an eighth of a tick
_SILENT_S = 0.5  # maximum age of the newest state when recording ends, s
_LEAST_FRAMES = 30  # minimum length of an episode, frames


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-feel`; return its exit status."""
    parser = command_parser("yam-feel", __doc__)
    parser.add_argument("path", type=user_path, nargs="?", help="directory of a data set, in place of a session")
    parser.add_argument("--episode", type=int, default=0, help="of the data set (default 0)")
    parser.add_argument("--leader", help="CAN channel of the leader")
    parser.add_argument("--follower", help="CAN channel of the follower")
    add_place_arguments(parser)
    parser.add_argument("--arm", default="yam", help="profile of the leader (default yam)")
    parser.add_argument("--gripper", default="yam_teaching_handle", help="its end (default yam_teaching_handle)")
    parser.add_argument("--seconds", type=float, default=10.0, help="to watch the session (default 10)")
    parser.add_argument("--plot", type=user_path, help="file for a picture, such as feel.png")
    args = parser.parse_args(arguments)
    if (args.path is None) != bool(args.leader and args.follower):
        parser.error("give --leader and --follower of a running session, or the directory of a data set")
    if not 2.0 <= args.seconds <= 600.0:
        parser.error("--seconds takes 2 … 600")
    return run_command("yam-feel", lambda: _watch(args) if args.path is None else _look_back(args))


def _watch(args: argparse.Namespace) -> int:
    """Report on a running session; return the exit status.

    Raises:
        YamError: no session drives an arm, a session ends, or the profile does not fit the leader.
    """
    arm, gripper = resolve_profiles(args.arm, args.gripper)
    place = place_of(args.interface, args.rig)
    rig = place["can_options"].get("rig")
    keys = {name: channel_key(place["interface"], name, rig) for name in (args.leader, args.follower)}
    hint = f"move the leader by hand, each joint to and fro, for {args.seconds:g} s …"
    led, follows = _record_states(keys, args.seconds, lambda: tell(hint))
    lines, periods = [], {}
    for name, states in ((args.leader, led), (args.follower, follows)):
        periods[name] = lasted_s = periods_s(states)
        p50, p99, most = np.percentile(lasted_s, (50, 99, 100)) * 1e3
        lost = int((states["lost"][-1] - states["lost"][0]).sum())
        loop = f"periods of the loop p50 {p50:.2f} ms, p99 {p99:.2f}, max {most:.2f}; lost replies {lost}"
        lines.append(f"{name}: {loop}")
    coupled = float(np.mean(follows["coupled_to"] != 0))
    lines.append(f"{args.follower}: follows at loop rate for {coupled:.0%} of the time")
    return _report(motion(led, follows), effort(led, arm, gripper), lines, args.plot, periods)


def _record_states(keys: Mapping[str, str], seconds: float, begins: Callable[[], None]) -> list[np.ndarray]:
    """Record the published states of arms for a given time; return an array (k,) of `STATE_DTYPE` for each arm.

    Args:
        keys: arm's name in messages -> key of the arm's channel.
        seconds: duration of the recording, s.
        begins: called once the states of all arms are found.

    Raises:
        ConfigError: no session drives one of the arms.
        BusError: a session ended during the recording.
    """
    blocks: list[SharedBlock] = []
    try:
        for name, key in keys.items():
            try:
                blocks.append(SharedBlock(state_path(key), STATE_DTYPE, create=False))
            except FileNotFoundError as error:
                raise ConfigError(f"{name}: no session drives it; start one, such as lerobot-teleoperate") from error
            except StaleStateError as error:
                raise ConfigError(f"{name}: {error}") from error
        begins()
        payloads: list[list[bytes]] = [[] for _ in blocks]
        seen, until_s = [0] * len(blocks), time.monotonic() + seconds
        while time.monotonic() < until_s:
            for index, block in enumerate(blocks):
                sequence = block.sequence()
                if sequence != seen[index] and (payload := block.glance_bytes()) is not None:
                    seen[index] = sequence
                    payloads[index].append(payload)
            time.sleep(_LOOK_S)
    finally:
        for block in blocks:
            block.close()
    states = [np.frombuffer(b"".join(found), STATE_DTYPE) for found in payloads]
    for name, found in zip(keys, states, strict=True):
        if not len(found) or time.monotonic() - found["stamp_s"][-1] > _SILENT_S:
            raise BusError(f"{name}: its session has ended, or its control loop hangs; start it and measure again")
    return states


def _look_back(args: argparse.Namespace) -> int:
    """Report on an episode of a data set, with actions as leader and states as follower; return the exit status.

    Raises:
        ConfigError: the data set or episode is missing, the episode is too short, or its actions are not joint angles.
    """
    from lerobot_robot_yam.face.datasets.check.motion_checks import arms_of
    from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, open_dataset

    data = open_dataset(args.path)
    episode = next((found for found in data.episodes if found.number == args.episode and found.length), None)
    if episode is None or episode.length < _LEAST_FRAMES:
        has = f"{episode.length} frames" if episode else f"no rows that can be read; there are {len(data.episodes)}"
        raise ConfigError(f"{args.path}: episode {args.episode} has {has}; give --episode another number")
    arms = []
    if ACTION in episode.rows and STATE in episode.rows:
        features = data.features[ACTION], data.features[STATE]
        arms = arms_of(episode.rows[ACTION], episode.rows[STATE], *features, data.unit)
    if not arms:
        raise ConfigError(f"{args.path}: its actions are no joints of its states; record it with action_space: joint")
    names = [f"{arm.prefix}joint_{joint + 1}" for arm in arms for joint in range(arm.action.shape[1])]
    leader, follower = (np.hstack([getattr(arm, side) for arm in arms]) for side in ("action", "state"))
    return _report(Motion(names, np.arange(episode.length) / data.fps, leader, follower), None, [], args.plot, {})


def _report(
    motion: Motion, effort: Effort | None, lines: Sequence[str], plot: Path | None, periods: Mapping[str, np.ndarray]
) -> int:
    rows = _rows(motion, effort)
    said = [table(_HEAD[: len(rows[0])], rows), *lines]
    if effort is not None:
        drag, friction = (", ".join(_shown(value, 2) for value in nm) for nm in (effort.drag_nm, effort.friction_nm))
        said.append(
            f"backdrive: drag of the motors at {SPEED_RAD_S:g} rad/s, {drag}, and the profile's friction, {friction}"
        )
    say("\n".join(said))
    if plot is not None:
        _save_plot(plot, motion, effort, periods)
        say(f"picture: {plot}")
    return 0


def _rows(motion: Motion, effort: Effort | None) -> list[tuple[str, ...]]:
    found = likeness(motion.times_s, motion.leader, motion.follower)
    moved = np.ptp(motion.leader, axis=0)
    columns = [moved, found.lag_s * 1e3, found.error_rad * 1e3, found.joint_jerk_ratio]
    if effort is not None:
        feedback = effort.feedback_nm
        columns += [np.sqrt(np.mean(feedback**2, axis=0)), np.abs(feedback).max(axis=0, initial=0.0)]
        columns += [effort.backdrive_nm]
    digits = (2, 1, 1, 2, 2, 2, 2)
    return [
        (name, *(_shown(column[joint], places) for column, places in zip(columns, digits, strict=False)))
        for joint, name in enumerate(motion.names)
    ]


def _shown(value: float, places: int) -> str:
    return f"{value:.{places}f}" if np.isfinite(value) else "–"


def _save_plot(path: Path, motion: Motion, effort: Effort | None, periods: Mapping[str, np.ndarray]) -> None:
    """Plot both arms, their difference, feedback and loop periods to a file. Raises ConfigError: see `plot_file`."""
    n = len(motion.names)
    rows = 2 + (effort is not None) + bool(periods)
    with plot_file(path, (3.2 * n, 3.2 * rows), dpi=100) as figure:
        grid = figure.add_gridspec(rows, n)
        for joint, name in enumerate(motion.names):
            axes = figure.add_subplot(grid[0, joint])
            axes.plot(motion.times_s, motion.leader[:, joint], linewidth=1.0, label="leader")
            axes.plot(motion.times_s, motion.follower[:, joint], linewidth=1.0, label="follower")
            axes.set(title=name, xlabel="s", ylabel="rad" if joint == 0 else "")
            if joint == 0:
                axes.legend(fontsize=8)
            axes = figure.add_subplot(grid[1, joint])
            axes.plot(motion.times_s, (motion.follower - motion.leader)[:, joint] * 1e3, linewidth=0.7)
            axes.set(xlabel="s", ylabel="follower - leader, mrad" if joint == 0 else "")
            if effort is not None:
                axes = figure.add_subplot(grid[2, joint])
                axes.plot(effort.dq[:, joint], effort.feedback_nm[:, joint], ".", markersize=1.5)
                axes.set(xlabel="leader, rad/s", ylabel="feedback, Nm" if joint == 0 else "")
        if periods:
            axes = figure.add_subplot(grid[-1, :])
            for name, lasted_s in periods.items():
                axes.hist(lasted_s * 1e3, bins=100, histtype="step", log=True, label=name)
            axes.set(xlabel="period of the control loop, ms", ylabel="ticks")
            axes.legend(fontsize=8)


if __name__ == "__main__":
    sys.exit(main())
