"""Set-point of the arm, moved by a queue of planned commands, or by one stream of jog and servo commands.

This module is pure: the caller passes the time and receives the set-point for each tick. A stream is refused while the
queue moves the arm. A queued command waits until a stream has come to rest.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.controller.plant import Reading
from lerobot_robot_yam.waldo.planning.jog import Play, State, Stream
from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.planning.planner import Planner

MOST_QUEUED = 1000  # maximum number of queued commands: a program with more probably lacks waits
_REMEMBERED = 100_000  # number of commands whose outcome is remembered for `wait_command`
_ARRIVED_RAD = 2e-3  # distance between the arm's own set-point and a plan's end that counts as arrived, rad
_SAME_RAD = 1e-6  # maximum distance between a plan's first point and the set-point, rad
_REST_RAD_S = 1e-6  # speed below which the set-point counts as at rest, rad/s: above rounding errors
_ARRIVE_S = 2.0  # maximum wait for the arm after a plan's end, s; after that, the arm counts as held back
_JAW_S = 3.0  # maximum duration of a jaw motion, s
_JAW_BEGINS_S = 0.15  # time after a command during which still jaws do not count as arrived, s


class End(Enum):
    """Outcome of a command."""

    DONE = "done"
    CANCELLED = "cancelled"


@dataclass
class Command:
    """Entry of the queue: an arm motion, a jaw motion, or a checkpoint.

    Attributes:
        name, text: name and arguments shown in the status.
        plan: motion of the arm; None: the arm stays.
        opening: target of the jaws, 0 closed … 1 open; None: the jaws stay.
        label: label of a checkpoint.
        radius_m: distance to the motion's end at which the next motion may begin, m; 0: this motion ends at rest.
        index: number of the command, assigned when it is queued.
    """

    name: str
    text: str = ""
    plan: Plan | None = None
    opening: float | None = None
    label: str = ""
    radius_m: float = 0.0
    index: int = -1


class Blend(NamedTuple):
    """Blend of two motions: the first motion, and the plan of both joined."""

    first: Plan
    joined: Plan


class Motion:
    """Set-point of one arm, and the commands that move it.

    `planner`: the arm's planner, used for stops; `reading`: current state of the arm.

    Attributes:
        q, dq: set-point (n,) and its speed, rad and rad/s.
        opening: set-point of the gripper, 0 closed … 1 open; None without a gripper.
        running: command that is running, or None.
        completed: index of the last completed command, initially -1.
        checkpoint: label of the last checkpoint passed.
        epoch: counter that grows when commands are cancelled. Plans from an earlier epoch must not be queued.
    """

    def __init__(self, planner: Planner, reading: Reading):
        self._planner = planner
        self._queue: deque[Command] = deque()
        self._ends: dict[int, End] = {}
        self._next_index, self._began_s = 0, 0.0
        self._last_s: float | None = None
        self._free_s: float | None = None  # start time of the next command, s; None: its first tick
        self._late = False
        self._stream: Stream | None = None
        self._stopping = False  # whether the stream is only a stop
        self.running: Command | None = None
        self.completed, self.checkpoint, self.epoch = -1, "", 0
        self.take_over(reading)

    def take_over(self, reading: Reading) -> None:
        """Restart from the arm's own set-point, at rest. Cancel all queued and streamed commands."""
        self._cancel()
        self._stream, self._free_s = None, None
        self.q, self.dq = np.array(reading.setpoint_q), np.zeros(len(reading.setpoint_q))
        self.opening = reading.asked_opening

    @property
    def setpoint(self) -> State:
        """Set-point (n,), rad, and its speed (n,), rad/s."""
        return self.q, self.dq

    @property
    def planned(self) -> bool:
        """Whether any command is running or queued."""
        return self.running is not None or bool(self._queue)

    @property
    def streams(self) -> bool:
        """Whether a stream moves the arm or brings it to rest."""
        return self._stream is not None

    @property
    def waiting(self) -> list[Command]:
        """The running command and all queued commands, in order."""
        return [*([self.running] if self.running else []), *self._queue]

    @property
    def end_q(self) -> np.ndarray:
        """Joints (n,), rad, at the end of the queue."""
        plans = [command.plan for command in self.waiting if command.plan is not None]
        return plans[-1].q[-1] if plans else self.q

    def end_of(self, index: int) -> End | None:
        """Return the outcome of a command; None if it has not ended or is unknown."""
        return self._ends.get(index)

    @property
    def blending(self) -> Plan | None:
        """Last motion in the queue if the next motion may be blended with it, else None."""
        last = self.waiting[-1] if self.planned else None
        return last.plan if last is not None and last.radius_m > 0.0 else None

    def add(self, command: Command, epoch: int, blend: Blend | None = None) -> int:
        """Queue a command that was planned from `end_q` in this epoch; return its index.

        `blend`: this motion joined to the previous one; used unless the previous motion has passed the blend's start.

        Raises:
            ControllerError: since planning, commands were cancelled or the arm was moved; or the queue is full.
        """
        if epoch != self.epoch:
            raise ControllerError(f"{command.name}: the arm was stopped meanwhile; nothing moves")
        if command.plan is not None and (self.streams or np.abs(command.plan.q[0] - self.end_q).max() > _SAME_RAD):
            raise ControllerError(f"{command.name}: the arm was jogged meanwhile; give the command again")
        if len(self._queue) >= MOST_QUEUED:
            raise ControllerError(f"{command.name}: {MOST_QUEUED} commands wait already; wait for some of them")
        if blend is not None and blend.first is self.blending:
            self._round(self.waiting[-1], command, blend.joined)
        command.index = self._next_index
        self._next_index += 1
        self._queue.append(command)
        return command.index

    def _round(self, before: Command, command: Command, joined: Plan) -> None:
        """Blend two motions, unless the first one has passed the start of the blend."""
        assert before.plan is not None and command.plan is not None
        overlap_s = before.plan.duration_s + command.plan.duration_s - joined.duration_s
        begins_s = before.plan.duration_s - overlap_s
        if before is self.running and (self._last_s or 0.0) - self._began_s >= begins_s:
            return
        before.plan, command.plan = joined.cut(begins_s + overlap_s / 2)

    def stream(self, begin: Callable[[], Stream]) -> None:
        """Start a stream, or renew the current stream with it. `begin`: function that creates the stream.

        Raises:
            ControllerError: a queued command moves the arm.
            PlanError: `begin` failed. The current stream continues.
        """
        if any(command.plan is not None for command in self.waiting):
            raise ControllerError("a queued command moves the arm: stop it, or wait until it has ended")
        newer = begin()
        if self._stream is None or not self._stream.renewed_by(newer):
            self._stream, self._stopping = newer, False

    def end_stream(self) -> None:
        """Bring a stream to rest, so that a planned command can follow."""
        if self._stream is not None and not self._stopping:
            self._come_to_rest(self._planner.stop(self.q, self.dq))

    def stop(self, now: float) -> None:
        """Cancel everything and come to rest as soon as the limits allow, on the path of the running plan."""
        running = self.running.plan if self.running is not None else None
        self._cancel()
        if running is not None:
            self._come_to_rest(self._planner.stop_on(running, (self._last_s or now) - self._began_s))
        else:
            self.end_stream()

    def _come_to_rest(self, plan: Plan) -> None:
        self._stream, self._stopping = Play(plan), True

    def _cancel(self) -> None:
        for command in self.waiting:
            self._end(command, End.CANCELLED)
        self._queue.clear()
        self.running = None
        self.epoch += 1

    def _end(self, command: Command, end: End) -> None:
        self._ends[command.index] = end
        self._ends.pop(command.index - _REMEMBERED, None)

    def step(self, now: float, reading: Reading) -> bool:
        """Advance the set-point; return whether the arm or its jaws move or will move.

        Raises:
            ControllerError: the arm does not reach the end of a plan. All commands are cancelled.
        """
        dt_s = 0.0 if self._last_s is None else now - self._last_s
        self._last_s, moved = now, self.streams or self.planned
        if self._stream is not None and dt_s > 0.0:
            self.q, self.dq = self._stream.step(self.q, self.dq, now, dt_s)
            if not self.dq.any() and self._stream.ended(now):
                self._stream = None
        if self.streams:
            self._free_s = None
        else:
            while self._advance(now, reading):
                pass
        return moved or self.streams or not reading.jaw_still

    def _advance(self, now: float, reading: Reading) -> bool:
        """Advance the queue; return True if a command has ended, so that the next one may start in the same tick."""
        if self.running is None:
            free_s, self._free_s = self._free_s, now
            if not self._queue:
                return False
            self.running, self._began_s, self._late = self._queue.popleft(), now if free_s is None else free_s, False
        command, past_s = self.running, now - self._began_s
        if command.plan is not None:
            self.q, self.dq = command.plan.at(past_s)
            over_s = past_s - command.plan.duration_s
            if over_s < 0.0:
                return False
            rests = np.abs(command.plan.dq[-1]).max() < _REST_RAD_S  # a blended motion does not end at rest
            if rests and np.abs(reading.setpoint_q - self.q).max() > _ARRIVED_RAD:
                if over_s > _ARRIVE_S:
                    self._cancel()
                    raise ControllerError(f"{command.name}: the arm is held back, or something is in its way")
                self._late = True
                return False
            self._free_s = now if self._late else self._began_s + command.plan.duration_s
        elif command.opening is not None:
            self.opening = command.opening
            if past_s < _JAW_BEGINS_S or (not reading.jaw_still and past_s < _JAW_S):
                return False
            self._free_s = now
        else:
            self.checkpoint = command.label
            self._free_s = self._began_s
        self._end(command, End.DONE)
        self.completed, self.running = command.index, None
        return True
