"""Whole ticks in one pass: the same bytes and the same world as frame by frame, for a fraction of the calls."""

from functools import cache

import numpy as np
import pytest

from lerobot_robot_yam.damiao import codec, registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID, encode_report_request
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import REGISTER_ID, ControlMode
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.fault_operations import CHANNEL_KINDS, KINDS
from lerobot_robot_yam.rig.simulation.rig_operations import perform
from scripts.soak.injected_faults import MATRIX

TICK_S = 0.004
FAULTS = {  # kind → value and details: what makes no trouble, or so slowly that these ticks would not see it
    "power": (False, {}),
    "storing": ("reverts", {}),
    "loss_rate": (0.5, {}),
    "command_loss_rate": (0.5, {}),
    "temperatures_c": ([70.0, 300.0], {}),
    "temperature_ramp": ({"rate_c_per_s": 200.0, "from_c": 60.0}, {}),
    "torque_bias_nm": (1.0, {}),
    "stuck": (True, {}),
    "friction_nm": (0.5, {}),
    "register": (30.0, {"register": int(Register.VMAX)}),
    "latency_s": (0.005, {}),
    "hold_back": ({"seconds": 0.01, "every_s": 0.03}, {}),
    "payload_kg": (0.5, {}),
}
FAULTS = {row.kind: (row.value, row.details) for row in reversed(MATRIX.values())} | FAULTS
ELSEWHERE = {"encoders_silent", "switches", "brake_slips"}  # a leader without motors and a rail's board have no ticks


@cache
def scene(channel):
    return load_scene(options={"arms": [channel]})


class Ear:
    """A client that keeps its packets."""

    def __init__(self):
        self.heard = []

    def send(self, data, flags=0):
        self.heard.append(data)
        return len(data)


class Pair:
    """The same rig twice: one gets packets, the other their frames. Both must always stay the same."""

    def __init__(self, channel, seed=0):
        self.now_s = 100.0
        self.random = np.random.default_rng(seed)
        self.devices = [RigDevice(scene(channel), self) for _ in range(2)]
        self.channels = [device.channels[channel] for device in self.devices]
        self.ears = [Ear(), Ear()]
        for device, one, ear in zip(self.devices, self.channels, self.ears, strict=True):
            device.world.start(self.now_s)
            one.clients.append(ear)
        self.channel = self.channels[0]
        self.send([(motor.can_id, SpecialCommand.ENABLE.value) for motor in self.channel.motors])

    def now(self):
        return self.now_s

    def send(self, frames, stamps_s=None):
        stamps_s = [self.now_s] * len(frames) if stamps_s is None else stamps_s
        sent = [Frame(stamp, ident, data) for stamp, (ident, data) in zip(stamps_s, frames, strict=True)]
        plain, general = self.channels
        plain.receive_packet(self.ears[0], packets.pack(sent), self.now_s)
        general.receive(self.ears[1], sent, self.now_s)

    def tick(self):
        """Any commands to all motors, and the handle's request, then 4 ms."""
        frames = []
        for motor in self.channel.motors:
            p, v, t, kp, kd = codec.ranges_of(motor.kind)
            near = motor.motor_angle_rad + self.random.normal(0.0, 0.05)
            values = (near, *self.random.uniform((-v, 0, 0, -t), (v, 0.3 * kp, kd, t)) * self.random.choice([0.1, 1.0]))
            frames.append((motor.can_id, codec.encode_mit(motor.kind, *map(float, values))))
        if self.channel.handle is not None:
            frames.append((REQUEST_ID, encode_report_request()))
        self.send(frames, [self.now_s - self.random.uniform(0.0, 0.002)] * len(frames))
        self.pass_time()

    def pass_time(self):
        self.now_s += TICK_S
        for device in self.devices:
            device.advance(self.now_s)

    def ask(self, **request):
        for device in self.devices:
            perform(device, request)

    def check(self):
        """Bytes, times, world and counters are the same."""
        one, other = self.ears
        assert b"".join(one.heard) == b"".join(other.heard)
        worlds = [device.world for device in self.devices]
        for field in ("qpos", "qvel", "ctrl", "actuator_force"):
            ours, theirs = (getattr(world.data, field).tobytes() for world in worlds)
            assert ours == theirs, field
        assert worlds[0].model.actuator_biasprm.tobytes() == worlds[1].model.actuator_biasprm.tobytes()
        assert len({channel.wire.frames for channel in self.channels}) == 1
        assert len({channel.wire.free_at_s for channel in self.channels}) == 1
        assert len({tuple(motor.last_command_s for motor in channel.motors) for channel in self.channels}) == 1


@pytest.mark.parametrize("channel", ["follower_left", "leader_right"])
@pytest.mark.parametrize("seed", range(3))
def test_whole_ticks_equal_their_frames(channel, seed):
    pair = Pair(channel, seed)
    for _ in range(150):
        pair.tick()
    pair.check()
    assert len(pair.ears[0].heard) == 151


def test_beyond_the_range_of_a_frame_too():
    pair = Pair("follower_left")
    for channel in pair.channels:
        channel.motors[1].zero_rad, channel.motors[3].zero_rad = 14.0, -30.0  # as if the encoders had counted up
    for _ in range(20):
        pair.tick()
    pair.check()


def test_between_other_frames_too():
    pair = Pair("leader_left")
    ids = [motor.can_id for motor in pair.channel.motors]
    others = (
        [(ids[2], SpecialCommand.DISABLE.value)],
        [(ids[2], SpecialCommand.ENABLE.value)],
        [(ident, SpecialCommand.ENABLE.value) for ident in ids],
        [(ids[0], SpecialCommand.ZERO.value)],
        [(REGISTER_ID, registers.encode_write(ids[4], Register.CTRL_MODE, int(ControlMode.VELOCITY)))],
        [(0x200 + ids[4], bytes(8))],
        [(REGISTER_ID, registers.encode_write(ids[4], Register.CTRL_MODE, int(ControlMode.MIT)))],
        [(REGISTER_ID, registers.encode_write(ids[5], Register.MST_ID, 0x77))],
        [(REGISTER_ID, registers.encode_write(ids[5], Register.PMAX, 20.0))],
        [(REGISTER_ID, registers.encode_refresh(ident)) for ident in (*ids, ids[0])],  # as long as a tick
        [(ident, SpecialCommand.DISABLE.value) for ident in ids],
    )
    for frames in others:
        for _ in range(3):
            pair.tick()
        pair.send(frames)
        pair.tick()
    frames = [(ident, codec.encode_mit("DM4310", 0.1, 0.0, 1.0, 0.1, 0.0)) for ident in ids]
    frames.append((REQUEST_ID, encode_report_request()))
    pair.send(frames, [pair.now_s - 0.001 * i for i in range(len(frames))])  # not all at once
    pair.send(frames[:-1] + [(REQUEST_ID, bytes(2))])
    pair.check()


def test_every_kind_of_fault_is_listed_here():
    assert set(FAULTS) | ELSEWHERE == set(KINDS)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_is_felt_at_once(kind):
    pair = Pair("leader_left" if kind == "handle_silent" else "follower_left")
    for _ in range(5):
        pair.tick()
    value, details = FAULTS[kind]
    place = {"channel": pair.channel.name, "motor": None if kind in CHANNEL_KINDS else "joint_2"}
    pair.ask(op="fault", kind=kind, value=value, **place, **details)
    for _ in range(20):
        pair.tick()
    pair.check()
    pair.ask(op="clear_faults", channel=pair.channel.name)
    for _ in range(20):
        pair.tick()
    pair.check()


def test_a_second_client_hears_whole_ticks():
    pair = Pair("follower_left")
    listeners = [Ear(), Ear()]
    for channel, ear in zip(pair.channels, listeners, strict=True):
        channel.clients.append(ear)
    for _ in range(3):
        pair.tick()
    pair.check()
    heard = [b"".join(ear.heard) for ear in listeners]
    assert heard[0] == heard[1] and len(heard[0]) == 3 * 14 * packets.RECORD_SIZE
