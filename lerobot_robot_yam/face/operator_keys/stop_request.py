"""A button that stops a command which records episode by episode. Pure: no clock, no keyboard.

LeRobot's stop key sets two flags at once: stop, and leave the loop. A key is on its way for a moment. One that arrives
when the next episode has begun ends it before its first frame, and LeRobot, which then saves it, ends with an error.
So the button sets the same flags itself, one after the other:

    stop       at once: no further episode begins, unless it has begun already
    re-record  when an episode is recorded that has begun since, or the one to be saved has no frame: nobody wants it
    leave      in a loop that was seen while the flags above were set: behind it comes no episode
"""

from lerobot_robot_yam.face.operator_keys.key_plan import Phase, Situation
from lerobot_robot_yam.face.recorder.record_command import AGAIN, LEAVE_LOOP, STOP


class StopRequest:
    """One press of the button, at the situation `now`. Its flags are set."""

    def __init__(self, now: Situation):
        self._turn = now.turn if now.phase is Phase.RECORDING and now.frames else None
        now.flags[STOP] = True

    def advance(self, now: Situation) -> bool:
        """Look at the command anew; whether nothing is left to do."""
        if now.phase not in (Phase.RECORDING, Phase.RESETTING):
            return not now.command
        if now.turn != self._turn if now.phase is Phase.RECORDING else not now.frames:
            now.flags[AGAIN] = True
        now.flags[LEAVE_LOOP] = True
        return True
