"""Episodes that begin when the leaders are lifted, and end when the leaders are home. Pure: no clock, no keyboard.

`lerobot-record` starts recording as soon as it is launched, and starts the next episode as soon as the previous one is
saved. Therefore the re-record key is pressed at once in an episode that did not begin with a lift: LeRobot discards the
episode and waits in its reset phase. The next lift ends the reset, and no save delays the recording. When the leaders
are home, the episode ends, and the reset after it ends at once, so that the episode is saved. An episode that an
emergency stop interrupts is discarded: the leaders go home after the stop, but not because the person has finished.

In lerobot-rollout, episodes belong to the policy: leaders neither begin nor end an episode.
"""

from collections.abc import Sequence

from lerobot_robot_yam.face.lerobot_command.running_command import RECORD, Meaning, Phase, Situation
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import Limited

LIFTED = (Gate.APPROACH, Gate.ENGAGED, Gate.FINE, Gate.RECENTRE)
_LEAST_FRAMES = 5  # minimum number of frames of an episode: a shorter episode was ended by a late key
_HOME = (Gate.HOMING, Gate.IDLE)


def all_lifted(gates: Sequence[Gate]) -> bool | None:
    """Return True if all leaders are lifted, False if all are home, otherwise None."""
    if all(gate in LIFTED for gate in gates):
        return True
    return False if all(gate in _HOME for gate in gates) else None


def led_by_hand(leaders: Sequence[ArmState]) -> bool:
    """Return whether all leaders float, or hold in a pause after a quick hand; none is stopped or in trouble."""
    return all(
        leader.mode is Mode.FLOAT or (leader.mode is Mode.HOLD and Limited.PEER not in leader.limited)
        for leader in leaders
    )


class AutoEpisodes:
    """State machine that derives the next key from the states of the leaders and the command."""

    def __init__(self) -> None:
        self._turn = 0.0
        self._armed = False  # whether the leaders were home since the last episode began
        # whether a lift ends this turn (_starts), and ended the previous turn (_begun)
        self._starts = self._begun = False
        self._was_lifted = False  # whether leaders were lifted in this turn (run of the command's loop)
        self._cut_off = False  # whether an arm stopped or failed in this turn

    def key(self, lifted: bool | None, by_hand: bool, now: Situation) -> Meaning | None:
        """Return the key to press now, if any. The same key is returned until the command has reacted.

        Args:
            lifted: state of all leaders, see `all_lifted`.
            by_hand: see `led_by_hand`.
            now: the command's situation.
        """
        if now.command != RECORD or not now.keys or now.phase not in (Phase.RECORDING, Phase.RESETTING):
            return None
        if now.turn != self._turn:
            self._turn, self._begun = now.turn, self._starts
            self._starts = self._was_lifted = self._cut_off = False
            self._armed &= not self._begun
        home = lifted is False
        self._armed |= home
        if now.phase is Phase.RECORDING:
            self._was_lifted |= lifted is True
            self._cut_off |= not by_hand
            if not now.frames:
                return None
            if not self._begun or self._cut_off or (home and not self._was_lifted):
                return Meaning.RERECORD
            return Meaning.NEXT if home and not now.ends_by_itself else None
        if not now.drops and now.frames < _LEAST_FRAMES:
            self._starts = lifted is True  # the same lift continues
            return Meaning.RERECORD
        self._starts = now.drops and self._armed and lifted is True
        if now.ends_by_itself or not (self._starts or not now.drops):
            return None
        return Meaning.NEXT  # saves the episode now instead of before the next one
