"""Let one or two arms float, compensated for gravity; record motions that you guide by hand, and replay them.

yam-float --channel can_follower_l                                   one arm, by keys
yam-float --channel can_follower_l can_follower_r                    two arms, recorded and replayed together
yam-float --channel can_follower_l --load wave.npy --output new.npy  what l and s read and write
yam-float --config_path rig.yaml                                     the followers of a rig's file or run config

HAZARD: this ENERGISES the arms. Files have the format of the vendor's example. The arms land however the command ends.
"""

import argparse
import dataclasses
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig, lead_of, passive_of
from lerobot_robot_yam.arm.mounting import seeks_stops
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, each_arm, with_likely_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import CLEAR_SCREEN, confirm_word, table, tell, tell_landed
from lerobot_robot_yam.commands.lib.key_terminal import QUIT, KeyTerminal, key_terminal
from lerobot_robot_yam.control.actuation import gravity_model
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, StaleStateError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.playback import Playback, replay
from lerobot_robot_yam.session.state_recorder import StateRecorder
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.session.trajectory_file import load_trajectory, save_trajectory
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.paths import user_path

HELP = "f: float  h: hold  d: down, land  r: record  p: replay  s: save  l: load  q: land and quit"
_HEAD = ("", "rad", "rad/s", "Nm", "gravity Nm", "stage °C", "coil °C")
_LOOK_S = 0.01
_SHOWN_S = 0.2
_ENTER, _ESCAPE, _DELETE = ("\r", "\n"), "\x1b", ("\x7f", "\b")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-float`; return its exit status."""
    parser = command_parser("yam-float", __doc__)
    add_arm_arguments(parser, several=True, required=False)
    parser.add_argument("--config_path", type=user_path, metavar="FILE", help="rig's file or run config with the arms")
    parser.add_argument("--tuning", nargs="+", metavar="PATH", help="file of yam-tune; one for each arm")
    parser.add_argument("--payload", type=float, metavar="KG", help="load that is fixed to the tool of each arm")
    parser.add_argument("--tilt", type=float, nargs=2, metavar="RAD", help="roll and pitch of the bases")
    parser.add_argument("--friction", type=float, nargs="+", metavar="NM", help="friction per joint, fed forward")
    parser.add_argument(
        "--calibration", nargs="+", metavar="PATH", help="the gripper's stored stops; without them it seeks its stops"
    )
    parser.add_argument("--output", type=user_path, default="trajectory.npy", help="file to save to (trajectory.npy)")
    parser.add_argument("--load", type=user_path, metavar="FILE", help="trajectory to begin with")
    parser.add_argument("--yes", action="store_true", help="do not ask before the arms are energised")
    args = parser.parse_args(arguments)
    return run_command("yam-float", lambda: _float(args))


def _float(args: argparse.Namespace) -> int:
    """Energise the arms, process keys until the user quits, and always land the arms; return the exit status."""
    if not sys.stdin.isatty():
        raise ConfigError("it is driven by keys, and there is no terminal to type them; nothing was energised")
    loaded = None if args.load is None else load_trajectory(args.load)
    configs = configs_of(args)
    session = ArmSession(configs)
    if loaded is not None:
        loaded.check([session.hardware(config.name) for config in configs])
    tell(_hazard(configs))
    confirm_word(args.yes, "float", "Type float to go on:")
    with key_terminal() as terminal:
        try:
            session.start()
            FloatConsole(session, [config.name for config in configs], terminal, args.output, loaded).run()
        finally:
            landed = session.stop()
    return tell_landed(landed)


def configs_of(args: argparse.Namespace) -> list[ArmConfig]:
    """Return the configs of the arms that the arguments name. Energises nothing.

    Raises:
        ConfigError: no arm is named, or more than two, or an option contradicts --config_path.
        BusError: a channel cannot be opened.
    """
    given: dict[str, Any] = {
        "tuning": args.tuning,
        "payload_mass_kg": args.payload,
        "base_tilt_rad": args.tilt,
        "coulomb_friction_nm": args.friction,
    }
    given = {name: value for name, value in given.items() if value is not None}
    if (args.channel is None) == (args.config_path is None):
        raise ConfigError("which arms? Give --channel, or --config_path; one of them")
    if args.config_path is None:
        configs = [
            with_likely_gripper(arm, **{**given, "calibration_path": arm.calibration, "tuning": arm.tuning})
            for arm in each_arm(args)
        ]
    else:
        if given or args.calibration:
            raise ConfigError(f"set {', '.join(given) or 'calibration_path'} in {args.config_path}, for each arm")
        plan = from_config(args.config_path, args.rig)
        driven = plan.followers or plan.arms
        configs = [target.driven for target in driven if passive_of(target.config) is None]
        if not 1 <= len(configs) <= 2:
            raise ConfigError(f"{args.config_path} has {len(configs)} arms with motors, and one or two can float")
    more: dict[str, Any] = {"start": "hold", "track_integral": True}
    alone: dict[str, Any] = {"lead": None}  # a leader floats by itself, and leads nobody
    return [dataclasses.replace(config, **more, **(alone if lead_of(config) else {})) for config in configs]


def _hazard(configs: Sequence[ArmConfig]) -> str:
    """Return the hazard warning that the user has to confirm."""
    channels = " and ".join(config.channel for config in configs)
    text = (
        f"HAZARD: this energises the arm on {channels}. It floats: it weighs nothing to your hand, and stays where you "
        "let it go. A replay moves it by itself. Keep clear of its way, and the emergency stop within reach."
    )
    seeks = [config.name for config in configs if seeks_stops(config)]
    if seeks:
        text += f" The gripper of {' and '.join(seeks)} closes and opens fully to find its stops (see --calibration)."
    return text


class FloatConsole:
    """Console that drives arms by single keys until the user quits. The caller stops the session.

    Args:
        session: started session with all arms in mode HOLD.
        names: names of the session's arms.
        terminal: source of single keys.
        output: file that `s` saves to.
        trajectory: trajectory to start with, or None.
    """

    def __init__(
        self, session: ArmSession, names: list[str], terminal: KeyTerminal, output: Path, trajectory: Trajectory | None
    ):
        self._session, self._names, self._terminal, self._output = session, names, terminal, output
        self._trajectory = trajectory
        self._recorder: StateRecorder | None = None
        self._playback: Playback | None = None
        self._typed: str | None = None  # file name typed so far; None: no name is being typed
        self._said = ""
        self._keys: dict[str, Callable[[], None]] = {
            "f": self._float,
            "h": self._hold,
            "d": self._land,
            "r": self._record,
            "p": self._replay,
            "s": self._save,
            "l": self._ask_for_file,
        }
        self._meet()

    def _meet(self) -> None:
        self._clients: list[ArmClient] = [self._session[name] for name in self._names]
        self._tables = [_Table(client) for client in self._clients]

    def run(self) -> None:
        """Let the arms float, and process keys until `q` is typed or the terminal is closed.

        Raises:
            StaleStateError: a control loop has stopped publishing states.
        """
        clock = self._session.clock
        shown_s = clock.now() - _SHOWN_S
        self._try(self._float)
        while not self._terminal.gone:
            for key in self._terminal.keys(_LOOK_S):
                if self._typed is not None:
                    self._type(key)
                elif key in QUIT:
                    return
                elif key in self._keys:
                    self._said = ""
                    self._try(self._keys[key])
            states = [self._state(client) for client in self._clients]
            if self._recorder is not None:
                self._recorder.poll()
            if self._playback is not None:
                self._try(self._play, self._playback)
            if clock.now() - shown_s >= _SHOWN_S:
                shown_s = clock.now()
                self._show(states)

    def _state(self, client: ArmClient) -> ArmState:
        """Return an arm's latest state, even in mode FAULT: the user is watching the arm.

        Raises:
            StaleStateError: the control loop has stopped publishing states.
        """
        state = client.published()
        age_s = self._session.clock.now() - state.published_s
        if state.mode is not Mode.OFF and age_s > client.config.max_state_age_s:
            raise StaleStateError(f"{client.config.name}: its control loop has been silent for {age_s:.2f} s")
        return state

    def _try[*A](self, work: Callable[[*A], None], *arguments: *A) -> None:
        try:
            work(*arguments)
        except StaleStateError:
            raise
        except YamError as error:
            self._playback = None
            self._said = str(error)

    def _wake(self) -> None:
        """Restart the session if all arms are in mode OFF; otherwise re-enable the arms in mode FAULT."""
        self._playback = None
        modes = [client.mode() for client in self._clients]
        if all(mode is Mode.OFF for mode in modes):
            self._session.stop()
            self._session.start()
            self._meet()
        elif Mode.FAULT in modes:
            self._session.rearm()

    def _float(self) -> None:
        self._wake()
        for client in self._clients:
            if client.mode() is not Mode.FLOAT:
                client.float()

    def _hold(self) -> None:
        self._wake()
        for client in self._clients:
            client.hold()

    def _land(self) -> None:
        self._playback = None
        self._end_recording()
        for client in self._clients:
            client.land()

    def _record(self) -> None:
        if self._recorder is not None:
            self._end_recording()
            return
        self._float()
        self._recorder = StateRecorder(self._clients)

    def _end_recording(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            self._trajectory = recorder.trajectory()
            self._said = f"recorded {self._trajectory.seconds:.1f} s; p replays it, s saves it"

    def _replay(self) -> None:
        self._end_recording()
        if self._trajectory is None:
            raise LifeCycleError("there is nothing to replay; record it (r) or load it (l)")
        self._wake()
        self._playback = replay(self._clients, self._trajectory)
        self._said = "replaying; h or f ends it"

    def _play(self, playback: Playback) -> None:
        if playback.step(self._session.clock.now()):
            self._playback = None
            for client in self._clients:
                client.hold()
            self._said = "replayed; the arm holds"

    def _save(self) -> None:
        self._end_recording()
        if self._trajectory is None:
            raise LifeCycleError("there is nothing to save; record it first (r)")
        save_trajectory(self._output, self._trajectory)
        self._said = f"saved to {self._output}"

    def _ask_for_file(self) -> None:
        if self._playback is not None:  # hold first: while a name is typed, no key can end the replay
            self._hold()
        self._typed = ""

    def _type(self, key: str) -> None:
        """Process one key typed while entering a file name."""
        assert self._typed is not None
        if key in _ENTER:
            name, self._typed = self._typed, None
            self._try(self._load, user_path(name) if name else self._output)
        elif key == _ESCAPE or key in QUIT[1:]:
            self._typed = None
        elif key in _DELETE:
            self._typed = self._typed[:-1]
        elif key.isprintable():
            self._typed += key
        self._show([self._state(client) for client in self._clients])

    def _load(self, path: Path) -> None:
        trajectory = load_trajectory(path)
        trajectory.check([client.hardware for client in self._clients])
        self._trajectory, self._said = trajectory, f"loaded {path}: {trajectory.seconds:.1f} s"

    def _show(self, states: list[ArmState]) -> None:
        lines = [shown.show(state) for shown, state in zip(self._tables, states, strict=True)]
        doing = f"trajectory of {self._trajectory.seconds:.1f} s" if self._trajectory else "no trajectory"
        if self._playback is not None:
            doing = f"REPLAYING {self._playback.elapsed_s:.1f} of {self._playback.trajectory.seconds:.1f} s"
        elif self._recorder is not None:
            doing = "RECORDING"
        lines += [doing, self._said]
        if self._typed is not None:
            lines[-1] = f"file to load (Enter alone: {self._output}, Escape: none): {self._typed}"
        tell(CLEAR_SCREEN + "\n".join([*lines, HELP]))


class _Table:
    """Table of an arm's joints (angle, speed, torque, gravity, temperatures), with mode and loop period above."""

    def __init__(self, client: ArmClient):
        self._client, self._gravity = client, gravity_model(client.hardware)
        self._seen: tuple[float, int] | None = None

    def show(self, state: ArmState) -> str:
        """Return the table as text."""
        hw = self._client.hardware
        weight: list[float] = []
        if self._gravity is not None:
            weight = (self._gravity.torque(state.q) * hw.arm.gravity_factor).tolist()
        rows = [
            [name, f"{q:+.3f}", f"{dq:+.2f}", f"{tau:+.2f}", f"{nm:+.2f}"]
            for name, q, dq, tau, nm in zip(hw.joint_names, state.q, state.dq, state.tau_nm, weight, strict=True)
        ]
        if state.gripper is not None:
            rate, tau = f"{state.gripper_rate:+.2f}", f"{state.gripper_tau_nm:+.2f}"
            rows.append(["gripper", f"{state.gripper:.3f}", rate, tau, ""])
        for row, stage, coil in zip(rows, state.temp_mos_c, state.temp_rotor_c, strict=True):
            row += [f"{stage:.0f}", f"{coil:.0f}"]
        before, self._seen = self._seen, (state.published_s, state.tick)
        period = ""
        if before is not None and state.tick > before[1] and math.isfinite(before[0]):
            period = f"  period {(state.published_s - before[0]) / (state.tick - before[1]) * 1e3:.2f} ms"
        trouble = f"  {state.message}" if state.message else ""
        return f"{hw.name} ({hw.config.channel}): {state.mode.name}{period}{trouble}\n{table(_HEAD, rows)}"


if __name__ == "__main__":
    sys.exit(main())
