"""Bytes and pictures are openpi's own."""

import tracemalloc

import msgpack
import numpy as np
import pytest
import torch
from PIL import Image

from lerobot_robot_yam.face.openpi.messages import decode_message, encode_message, resize_with_pad

# Made with msgpack_numpy.packb of the published openpi-client 0.1.2 (under NumPy 2, which its metadata forbid).
GOLDEN_QUESTION = {
    "observation/image": np.arange(6, dtype=np.uint8).reshape(1, 2, 3),
    "observation/state": np.array([0.0, 0.5, -1.0], dtype=np.float32),
    "prompt": "lift the cube",
}
GOLDEN_ANSWER = {
    "actions": np.array([[0.1, -0.2], [0.3, 1.0]]),
    "state": np.array([1, 2], dtype=np.int32),
    "policy_timing": {"infer_ms": 12.5},
    "ok": np.bool_(True),
}
GOLDEN_METADATA = {"reset_pose": [0, -1.5, 1.5, 0, 0, 0]}
GOLDEN = [
    (
        GOLDEN_QUESTION,
        "83b16f62736572766174696f6e2f696d61676584c40b5f5f6e6461727261795f5fc3c40464617461c406000102030405c4056474797065"
        "a37c7531c405736861706593010203b16f62736572766174696f6e2f737461746584c40b5f5f6e6461727261795f5fc3c40464617461c4"
        "0c000000000000003f000080bfc4056474797065a33c6634c40573686170659103a670726f6d7074ad6c696674207468652063756265",
    ),
    (
        GOLDEN_ANSWER,
        "84a7616374696f6e7384c40b5f5f6e6461727261795f5fc3c40464617461c4209a9999999999b93f9a9999999999c9bf333333333333d3"
        "3f000000000000f03fc4056474797065a33c6638c4057368617065920202a5737461746584c40b5f5f6e6461727261795f5fc3c4046461"
        "7461c4080100000002000000c4056474797065a33c6934c40573686170659102ad706f6c6963795f74696d696e6781a8696e6665725f6d"
        "73cb4029000000000000a26f6b83c40d5f5f6e7067656e657269635f5fc3c40464617461c3c4056474797065a37c6231",
    ),
    (GOLDEN_METADATA, "81aa72657365745f706f73659600cbbff8000000000000cb3ff8000000000000000000"),
]


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and np.array_equal(one, other)
    else:
        assert one == other


@pytest.mark.parametrize("message, golden", GOLDEN, ids=["question", "answer", "metadata"])
def test_bytes_are_those_of_openpi(message, golden):
    assert encode_message(message).hex() == golden
    assert_same(decode_message(bytes.fromhex(golden)), message)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        bytes.fromhex(GOLDEN[0][1])[:-3],
        encode_message({"a": np.zeros(3)}).replace(b"<f8", b"|O8"),  # pointers, as openpi's own reader would make them
        encode_message({"a": np.zeros(3)}).replace(b"<f8", b"<zz"),
        encode_message({"a": np.zeros(3)}).replace(b"dtype", b"ditty"),
        encode_message({"a": np.zeros(3)}).replace(b"<f8", b"<f4"),  # twice as many numbers as the shape says
        # few bytes that say they are many
        msgpack.packb({b"__npgeneric__": True, b"data": 10**8, b"dtype": "|S1"}),
        msgpack.packb({b"__npgeneric__": True, b"data": [0.0] * 100, b"dtype": "<f8"}),
        msgpack.packb({b"__ndarray__": True, b"data": b"", b"dtype": "|S2000000000", b"shape": [0]}),
        msgpack.packb({b"__ndarray__": True, b"data": b"", b"dtype": "<f4", b"shape": [0, 10**15]}),
        b"\xdd" + (500_000).to_bytes(4) + b"\x80" * 500_000,
        (b"\xdc" + (9_000).to_bytes(2) + b"\x80" * 9_000).join([b"\xdc" + (50).to_bytes(2), *[b""] * 50]),
    ],
    ids=lambda data: f"{len(data)} bytes",
)
def test_other_bytes_are_refused_and_take_no_memory(data):
    tracemalloc.start()
    try:
        with pytest.raises(ValueError):
            decode_message(data)
        assert tracemalloc.get_traced_memory()[1] < 2 * len(data) + 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("value", [object(), np.array([object()]), np.array([1j]), {"a": torch.zeros(2)}])
def test_nothing_else_is_sent(value):
    with pytest.raises(TypeError, match="no place in a message"):
        encode_message({"a": value})


def test_images_are_padded_as_in_training():
    image = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    padded = resize_with_pad(image, 224, 224)
    inner = np.asarray(Image.fromarray(image).resize((224, 168), Image.Resampling.BILINEAR))
    assert np.array_equal(padded[28:196], inner) and not padded[:28].any() and not padded[196:].any()
    tall = resize_with_pad(image.transpose(1, 0, 2).copy(), 100, 200)
    assert tall.shape == (100, 200, 3) and tall[:, 62:137].any(axis=(1, 2)).all() and not tall[:, :62].any()
    assert resize_with_pad(image, 240, 320) is image
