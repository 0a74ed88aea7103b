"""The rig without sockets: world, channels with motors and handles, hands, pushes, judge and event log."""

import itertools
import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS
from lerobot_robot_yam.arm.profile import ArmMotor, GripperMotor
from lerobot_robot_yam.damiao.tables import ControlMode
from lerobot_robot_yam.mobile.rail_profile import RAIL_MOTOR
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.devices.board_frames import board_channel
from lerobot_robot_yam.rig.devices.rail_board import SimRailBoard
from lerobot_robot_yam.rig.devices.simulated_handle import SimEncoders, SimHandle
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.scene.scene import ArmPlacement, BasePlacement, Scene, serial_number
from lerobot_robot_yam.rig.simulation.grips import FirmGrip, SoftGrip
from lerobot_robot_yam.rig.simulation.hand import ButtonPresses, Hand
from lerobot_robot_yam.rig.simulation.judge import Judge
from lerobot_robot_yam.rig.world.outer_forces import Ballast, OuterForces
from lerobot_robot_yam.rig.world.shafts import Drive
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import gripper_stroke
from lerobot_robot_yam.system.clock import SYSTEM, Clock

_SLOW_PERIOD_S = 0.005  # period of watchdogs and the judge, in simulated time
_EVENTS_KEPT = 20_000
BASE_SERIALS = 90_000  # serial numbers of a base's motors, minus their ids; arms have smaller ones


class EventLog:
    """Numbered events in order, with simulated time and the time of the rig's clock; the oldest are dropped.

    next_number: number of the next event.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world, self._clock = world, clock
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS_KEPT)
        self.next_number = 0

    def add(self, kind: str, **details: Any) -> None:
        """Log an event of `kind`; `details` must be serialisable as JSON."""
        times = {"sim_s": round(self._world.sim_s, 4), "monotonic_s": self._clock.now()}
        event = {**details, "number": self.next_number, **times, "kind": kind}
        self._events.append(event)
        self.next_number += 1

    def since(self, number: int, limit: int | None = None) -> list[dict[str, Any]]:
        """Return the events from `number` on, at most `limit` of them."""
        return list(itertools.islice((event for event in self._events if event["number"] >= number), limit))


class RigDevice:
    """Everything that is simulated. Owned by one thread, which calls `advance` with the time of `clock`.

    Attributes:
        operations: name → additional operation for clients, besides those of `RigOperations`.
        each_step: callbacks after each physics step; if there are any, the physics is simulated step by step.
        each_advance: callbacks after each `advance` that has simulated at least one step.
        loaded: files that `RigOperations.load` has run.
        asked_drive: simulated time, s, and velocity (3,) at which the operator last asked to drive the base.
        drive_reader: simulated time, s, and episode at which a teleoperator last read that.
    """

    def __init__(self, scene: Scene, clock: Clock = SYSTEM):
        self.scene, self.clock = scene, clock
        self.world = World(scene)
        self.events = EventLog(self.world, clock)
        self.channels: dict[str, Channel] = {}
        self.hands: dict[str, Hand] = {}
        self.ballast: dict[str, Ballast] = {}
        self.forces = OuterForces(self.world)
        for index, row in enumerate(scene.arms):
            gripper = self.world.profiles[row.channel][1]
            handle = SimHandle() if gripper.handle_encoder else None
            if row.passive is not None:
                handle = SimEncoders(self.world, row.channel, JOINT_SIGNS[row.passive])
            seed = scene.options.seed + index
            motors = self._motors(row) if row.passive is None else []
            channel = Channel(row.channel, motors, handle, scene.options.latency_s, seed)
            self.channels[row.channel] = channel
            self.ballast[row.channel] = Ballast(self.world, row.channel)
            self.hands[row.channel] = self._hand(row, handle)
        self.board: SimRailBoard | None = None
        if scene.base is not None:
            self._add_base(scene.base)
        self.leaders = [row.channel for row in scene.arms if row.role == "leader"]
        self.judge = Judge(self.world)
        self.presses = ButtonPresses(self._log_button)
        self._pushes: dict[str, float] = {}  # source → simulated end time
        self._all_motors = [motor for channel in self.channels.values() for motor in channel.motors]
        self._adapters = [channel.adapter for channel in self.channels.values()]
        self.operations: dict[str, Callable[..., Any]] = {}
        self.each_step: list[Callable[[], None]] = []
        self.each_advance: list[Callable[[], None]] = []
        self.loaded: set[str] = set()
        self.asked_drive: tuple[float, list[float]] = (-math.inf, [0.0] * 3)
        self.drive_reader: tuple[float, float | None] = (-math.inf, None)
        self._next_slow_s = 0.0
        if scene.options.operator in (task.name for task in scene.tasks):  # things lie as its first attempt has them
            self.judge.place(scene.options.operator, scene.options.seed)

    def _hand(self, row: ArmPlacement, handle: SimHandle | None) -> Hand:
        firm = FirmGrip(self.world, row.channel) if row.role == "leader" else None
        soft = SoftGrip(self.world, row.channel, self.forces, self.ballast[row.channel])

        def tell(kind: str) -> None:
            self.events.add(kind, channel=row.channel)

        return Hand(self.world, row.channel, handle, firm, soft, tell)

    def _motors(self, row: ArmPlacement) -> list[SimMotor]:
        arm, gripper = self.world.profiles[row.channel]
        shafts: list[tuple[ArmMotor | GripperMotor, tuple[str, ...], float, float]] = [
            (motor, (f"joint{i + 1}",), 0.0, 1.0) for i, motor in enumerate(arm.motors)
        ]
        if gripper.motor is not None:
            shafts.append((gripper.motor, gripper.finger_joints, *gripper_stroke(row, gripper)))
        zeros = np.zeros(len(shafts)) if row.zero_offset_rad is None else row.zero_offset_rad

        def log(kind: str, **details: Any) -> None:
            where = {"bodies": self.world.bodies(f"{row.channel}/")} if kind == "motor_disabled" else {}
            self.events.add(kind, channel=row.channel, **details, **where)

        found = []
        for zero, (motor, joints, base, coefficient) in zip(zeros.tolist(), shafts, strict=True):
            drive = Drive(self.world, row.channel, motor.name, joints, base, coefficient)
            found.append(SimMotor(motor, zero, drive, self.world, log, serial_number(self.scene, row, motor.can_id)))
        return found

    def _add_base(self, row: BasePlacement) -> None:
        """Add the channels of a base and of its rail's board."""
        options, seed, rail = self.scene.options, self.scene.options.seed + len(self.scene.arms), row.rail
        self.channels[row.channel] = Channel(row.channel, self._base_motors(row), None, options.latency_s, seed)
        if rail is not None:
            self.board, name = SimRailBoard(self.world, row.channel, rail), board_channel(row.channel)
            self.channels[name] = Channel(name, [], self.board, 0.0, seed + 1)

    def _base_motors(self, row: BasePlacement) -> list[SimMotor]:
        profile, rail = self.world.base, row.rail
        rows = [
            (spec, sign, float(row.steer_zero_rad[index // 2]) if index % 2 == 0 else 0.0, 1.0)
            for index, (spec, sign) in enumerate(zip(profile.motors(), profile.signs, strict=True))
        ]
        if rail is not None:
            rows.append((RAIL_MOTOR, 1, rail.zero_rad, 1.0 / rail.metres_per_rad))

        def log(kind: str, **details: Any) -> None:
            self.events.add(kind, channel=row.channel, **details)

        found = []
        for spec, sign, zero, coefficient in rows:
            motor = ArmMotor(spec.name, spec.can_id, spec.type, sign)
            drive = Drive(self.world, row.channel, spec.name, (spec.name,), 0.0, coefficient)
            serial = BASE_SERIALS + spec.can_id
            found.append(SimMotor(motor, zero, drive, self.world, log, serial, ControlMode.VELOCITY))
        return found

    def _log_button(self, channel: str, button: str, down: bool) -> None:
        self.events.add("button", channel=channel, button=button, down=down)

    @property
    def due_s(self) -> float:
        """Time at which an adapter next has a command to deliver; infinity if no command is queued."""
        return min([adapter.due_s for adapter in self._adapters])

    def advance(self, now_s: float) -> None:
        """Simulate up to time `now_s` of the clock."""
        while (due_s := self.due_s) <= now_s:
            self._simulate(due_s)
            for channel in self.channels.values():
                channel.pass_on(due_s)
        self._simulate(now_s)

    def _simulate(self, now_s: float) -> None:
        world = self.world
        slips = world.slips
        count = world.due(now_s)
        if world.slips != slips:
            self.events.add("slipped", seconds=world.slipped_s)
        if count == 0:
            return
        soft = []
        for name, hand in self.hands.items():
            if hand.gripping:
                if world.sim_s >= hand.due_s:
                    hand.advance(self._any_enabled(name))
                if hand.soft:
                    soft.append(hand)
        if soft or self.each_step:
            for _ in range(count):
                for hand in soft:
                    hand.step()
                world.step(1)
                for look in self.each_step:
                    look()
        else:
            world.step(count)
        sim_s = world.sim_s
        for look in self.each_advance:
            look()
        if sim_s >= self._next_slow_s:
            self._next_slow_s = sim_s + _SLOW_PERIOD_S
            self._slow(sim_s, now_s)

    def _slow(self, sim_s: float, now_s: float) -> None:
        for motor in self._all_motors:
            motor.look_after_itself()
        self.forces.refresh()
        for source, end_s in list(self._pushes.items()):
            if sim_s >= end_s:
                self.forces.end(source)
                del self._pushes[source]
        self.presses.advance(sim_s)
        for event in self.judge.update():
            self.events.add(event.pop("kind"), **event)
        for name, hand in self.hands.items():
            if hand.resisted and not self._any_enabled(name):
                hand.resisted = False
        for channel in self.channels.values():
            channel.poll(now_s)

    def _any_enabled(self, channel: str) -> bool:
        return any(motor.enabled for motor in self.channels[channel].motors)

    def push(self, body: int, force_n: np.ndarray, seconds: float, site: int | None = None) -> None:
        """Push a body with a force (3,), N, in world axes for `seconds`, at a site or at the centre of mass."""
        source = f"push {body}"
        self.forces.apply(source, body, force_n, site=site)
        self._pushes[source] = self.world.sim_s + seconds

    def leaders_energised(self) -> bool:
        """Return whether there are leaders, and all their motors are enabled."""
        return bool(self.leaders) and all(
            motor.enabled for channel in self.leaders for motor in self.channels[channel].motors
        )
