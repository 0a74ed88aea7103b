import pytest

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder

# Worked examples, checked against the vendor's reader: frame, position, velocity, trigger, buttons.
EXAMPLES = [
    ("010000000000", 0.0, 0.0, 0.0, (False, False)),
    ("010064000501", 0.15339807878856412, 0.007669903939428206, 0.2191401125550916, (True, False)),
    ("01ff1cffd802", -0.34974761963792617, -0.06135923151542565, 0.4996394566256088, (False, True)),
    ("0101c8000003", 0.6994952392758523, 0.0, 0.9992789132512176, (True, True)),
    ("0101c9000c00", 0.701029220063738, 0.018407769454627694, 1.0, (False, False)),
    ("01f830012c01", -3.067961575771282, 0.46019423636569234, 1.0, (True, False)),
]


@pytest.mark.parametrize(("frame", "position", "velocity", "trigger", "buttons"), EXAMPLES)
def test_worked_examples(frame, position, velocity, trigger, buttons):
    report = handle_encoder.decode_report(bytes.fromhex(frame))
    assert report.position_rad == pytest.approx(position, abs=1e-12)
    assert report.velocity_rad_s == pytest.approx(velocity, abs=1e-12)
    assert report.trigger == pytest.approx(trigger, abs=1e-12)
    assert report.buttons == buttons
    assert handle_encoder.encode_report(position, velocity, buttons).hex() == frame


def test_a_third_input_is_not_the_second_button():
    assert handle_encoder.decode_report(bytes.fromhex("010000000004")).buttons == (False, False)
    assert handle_encoder.decode_report(bytes.fromhex("010000000006")).buttons == (False, True)


def test_angles_beyond_the_counter_saturate():
    report = handle_encoder.decode_report(handle_encoder.encode_report(1e3, -1e3, (False, False)))
    assert report.position_rad == pytest.approx(0x7FFF * handle_encoder.RAD_PER_COUNT)
    assert report.velocity_rad_s == pytest.approx(-0x8000 * handle_encoder.RAD_PER_COUNT)


def test_requests_as_documented():
    assert handle_encoder.encode_report_request().hex() == "ff02"
    assert handle_encoder.encode_version_request().hex() == "ff03"
    assert handle_encoder.encode_eeprom_read(25).hex() == "ff0719"
    assert handle_encoder.encode_report_frequency(0).hex() == "ff0100"
    assert handle_encoder.encode_report_frequency(600).hex() == "ff010258"


def test_configuration_replies():
    assert handle_encoder.decode_version(bytes.fromhex("0183020400")) == (2, 4, 0)
    assert handle_encoder.decode_version(handle_encoder.encode_version((2, 2, 12))) == (2, 2, 12)
    assert handle_encoder.decode_eeprom_byte(handle_encoder.encode_eeprom_byte(99)) == 99
    assert handle_encoder.decode_version(handle_encoder.encode_eeprom_byte(99)) is None
    assert handle_encoder.decode_eeprom_byte(handle_encoder.encode_version((2, 4, 0))) is None
    assert handle_encoder.decode_frequency(200, 0xFF) == 200
    assert handle_encoder.decode_frequency(0x58, 0x02) == 600


def test_the_encoder_keeps_the_newest_report_and_ignores_other_lengths():
    handle = HandleEncoder()
    assert handle.accept(bytes.fromhex("0101c9000c00"), 5.0)
    assert not handle.accept(bytes(8), 6.0)
    assert handle.report.trigger == 1.0
    assert handle.stamp_s == 5.0
