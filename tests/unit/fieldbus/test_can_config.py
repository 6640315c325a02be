# SPDX-License-Identifier: Apache-2.0
"""CAN drives in profiles and robot files: mistakes and a bus that is too full are reported."""

import math
from dataclasses import replace

import pytest

from motord.config import load_robot
from motord.config.drives.load import find_profile, load_profile
from motord.config.problems import ConfigError
from motord.config.rules.wiring.can import bus_load
from motord.config.wiring import line_specs
from motord_hal.base.errors import HalError, ProfileError
from motord_hal.base.paths import config_dir
from motord_hal.can.address import bus_arguments
from motord_hal.can.codec import build, parse
from motord_hal.can.plan import CanPlan
from motord_hal.drives.can_profile import signals_of
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.exchange import Exchange, JointSetpoint
from motord_hal.realtime.table import FieldKind
from motord_hal.rt_engine.can.table import drive_table

CIA402 = config_dir() / "robots" / "cia402-two.toml"
ROBOT = config_dir() / "robots" / "odrive-two.toml"


def problems(tmp_path, right, wrong, count=1, drive="odrive-0.5"):
    text = (config_dir() / "drives" / f"{drive}.toml").read_text(encoding="utf-8")
    assert right in text
    path = tmp_path / f"{drive}.toml"
    path.write_text(text.replace(right, wrong, count), encoding="utf-8")
    with pytest.raises(ProfileError) as error:
        load_profile(path)
    return str(error.value)


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('frame = "heartbeat"', 'frame = "hartbeat"', 'did you mean "heartbeat"?'),
        ("start_bit = 32", "start_bit = 64", "reaches beyond the 8 bytes"),
        ("start_bit = 32", "start_bit = 30", "overlaps axis_error"),
        ("node_max = 63", "node_max = 64", "with node 64 it is beyond 0x7ff"),
        ("silence_s = 0.35", "silence_s = 0.1", "shorter than two periods"),
        ("period_s = 0.01\nsilence_s = 0.2", "period_s = 0.01", "silence_s: is missing"),
        ('ask = "rtr"\nperiod_s = 0.01', "", "has neither period_s"),
        ('ask = "rtr"', 'ask = "heartbeat"', "is not a frame that motord sends"),
        ("id = 0x003", "id = 0x001", "cannot be distinguished from frame heartbeat"),
        ('sender = "motord"', 'sender = "motord"\nperiod_s = 1', "only for frames of the drive"),
        ("bitrate = 250000", "bitrate = 9", "can.bitrate: 9 is out of range"),
        ('type = "u32"', 'type = "u64"', '"u64" is unknown ("u8"'),
        ('unit = "turn"', 'unit = "v"', "must be"),
        ("id = 0x001", "id = 0x001\nbegins = [1, 256]", "256 is out of range (-1 to 255)"),
        (
            'protocol = "can"',
            'protocol = "can"\nregister = {}',
            'register: is not for protocol "can"',
        ),
    ],
)
def test_a_mistake_in_a_profile_is_reported(tmp_path, right, wrong, message):
    assert message in problems(tmp_path, right, wrong)


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('\nvelocity = "velocity"', "", "torque_setpoint needs velocity"),
        ("minimum = -1.5\n", "", '"target_torque" needs minimum and maximum'),
        ('unit = "n_m"', 'unit = "percent"', 'must be "n_m"'),
        (
            'torque_setpoint = "target_torque"',
            'torque_setpoint = "target_torque"\nduty_setpoint = "target_torque"',
            "exactly one of velocity_setpoint, duty_setpoint, torque_setpoint",
        ),
    ],
)
def test_a_torque_needs_what_its_speed_loop_is_closed_over(tmp_path, right, wrong, message):
    assert message in problems(tmp_path, right, wrong, drive="cia402-torque")


def test_a_torque_is_divided_by_the_gear_that_multiplies_it():
    joint = JointSpec(
        index=0, name="w", profile=find_profile("cia402-torque"), unit=3, gear_ratio=20.0,
        inverted=True,
    )  # fmt: skip
    plan = CanPlan([joint])
    assert plan.setpoints({0: JointSetpoint(5.0, 1.0, 8.0)}) == {"target_torque": -400}
    assert plan.setpoints({0: JointSetpoint(5.0, 1.0, -80.0)}) == {"target_torque": 1500}
    assert plan.setpoints({0: JointSetpoint(5.0, 1.0, math.nan)}) == {"target_torque": 0}


def loaded(*overrides):
    robot = load_robot(ROBOT, overrides)
    profiles = robot.profiles
    return robot, line_specs(robot, profiles)[0]


def wrong(*overrides):
    with pytest.raises(ConfigError) as error:
        load_robot(ROBOT, overrides)
    return "\n".join(map(str, error.value.problems))


def test_the_hardware_layer_gets_the_settings_of_a_can_line():
    _, spec = loaded("line.can0.data_bitrate=2000000")
    assert (spec.kind, spec.port, spec.baudrate) == ("can", "socketcan:can0", 500_000)
    assert spec.data_baudrate == 2_000_000


def test_a_watchdog_set_by_the_maker_s_tool_is_checked_against_the_robot_file():
    both = [f"joint.{name}.drive_watchdog_s=0.5" for name in ("left", "right")]
    robot, _ = loaded()
    assert any("without a communication watchdog" in w.text for w in robot.warnings)
    robot, _ = loaded(both[0])
    assert any("without a communication watchdog" in w.text for w in robot.warnings)
    robot, _ = loaded(*both)
    assert not any("without a communication watchdog" in w.text for w in robot.warnings)
    assert "0.5 s is not safety.drive_watchdog_s (0.3 s)" in wrong(
        *both, "safety.drive_watchdog_s=0.3"
    )
    assert "shorter than three cycles" in wrong("joint.left.drive_watchdog_s=0.015")


def test_a_watchdog_that_motord_sets_or_that_is_on_no_can_bus_is_not_reported():
    with pytest.raises(ConfigError, match="is not used: motord sets that of drive"):
        load_robot(CIA402, ("joint.left.drive_watchdog_s=0.5",))
    with pytest.raises(ConfigError, match="is only for a drive on a CAN bus"):
        load_robot(config_dir() / "robots" / "demo.toml", ("joint.left.drive_watchdog_s=0.5",))


def test_an_adapter_whose_driver_may_block_is_refused_with_the_one_that_works():
    message = wrong("line.can0.interface=gs_usb", "line.can0.channel=0")
    assert "line.can0.interface" in message
    assert 'interface = "socketcan", channel = "can0"' in message


def test_an_adapter_that_carries_no_can_fd_is_refused_where_it_is_required():
    slcan = ("line.can0.interface=slcan", "line.can0.channel=/dev/ttyACM0")
    loaded(*slcan)
    assert "slcan carries no CAN FD" in wrong(*slcan, "line.can0.data_bitrate=2000000")
    _, spec = loaded(*slcan)
    with pytest.raises(HalError, match="slcan carries no CAN FD"):
        open_line(replace(spec, data_baudrate=2_000_000), Exchange.private(), print)


def test_an_adapter_of_python_can_s_own_gets_the_can_fd_settings():
    assert "fd" not in bus_arguments("kvaser:0", 500_000, None)
    fd = bus_arguments("kvaser:0", 500_000, 2_000_000)
    assert (fd["fd"], fd["data_bitrate"], fd["bitrate"]) == (True, 2_000_000, 500_000)


def test_the_bus_load_is_that_of_the_frames():
    """At 500 kbit/s: a frame of set-points has 135 bits, and each drive sends 100 + 10 frames of
    135 bits a second."""
    _, spec = loaded()
    own, cycle_s = bus_load(spec)
    assert own == pytest.approx(2 * 110 * 135 / 500_000)
    assert 2 * 135 / 500_000 < cycle_s < 1.5 * 2 * 135 / 500_000


def test_a_bus_that_is_too_full_is_an_error_with_what_would_help():
    message = wrong("line.can0.bitrate=50000")
    assert "load the CAN bus with 1" in message
    assert "or bitrate = 125000" in message


def test_a_bus_that_is_nearly_full_is_warned_of():
    robot, _ = loaded("line.can0.bitrate=62500", "line.can0.cycle_hz=80")
    assert any("load the CAN bus" in warning.text for warning in robot.warnings)


def test_a_node_that_the_drive_cannot_have_is_an_error():
    assert "64 is not an address of drive" in wrong("joint.left.unit=64")
    loaded("joint.left.unit=0")


def test_counts_for_a_drive_that_reports_turns_are_an_error():
    assert "reports its position in turns" in wrong("joint.left.counts_per_turn=4096")


def test_a_drive_of_another_protocol_is_not_for_this_line():
    assert "speaks modbus-rtu, its line can" in wrong('joint.left.drive="zlac8015d"')


def test_a_feedback_time_out_shorter_than_three_cycles_is_an_error():
    assert "three cycles" in wrong("safety.feedback_timeout_s=0.015")


def test_the_real_time_engine_is_for_the_kernel_s_adapters():
    assert "needs SocketCAN" in wrong('line.can0.engine="rt"', 'line.can0.interface="slcan"')
    for interface, engine in (("socketcan", "rt"), ("slcan", "asyncio"), ("unix", "rt")):
        _, spec = loaded(f'line.can0.interface="{interface}"')
        line = open_line(spec, Exchange.private(), lambda event: None)
        assert line.engine == engine


def test_the_thread_of_a_bus_stays_below_the_loop():
    assert "not below the loop's" in wrong("line.can0.priority=90", "loop.priority=80")
    _, spec = loaded("line.can0.priority=60", "line.can0.cpu=[1]")
    assert (spec.priority, spec.cpu) == (60, (1,))
    _, spec = loaded("loop.priority=50")
    assert spec.priority == 49


def test_a_serial_drive_on_a_can_line_is_refused_by_the_line_too():
    _, spec = loaded()
    profile = find_profile("duty-register")
    joints = tuple(
        type(joint)(index=joint.index, name=joint.name, profile=profile, unit=joint.unit)
        for joint in spec.joints
    )
    changed = type(spec)(**{**{f: getattr(spec, f) for f in spec.__slots__}, "joints": joints})
    with pytest.raises(HalError, match="no drive on a CAN bus"):
        open_line(changed, Exchange.private(), lambda event: None)


def test_a_cycle_that_a_synchronous_drive_cannot_hold_is_reported_with_its_line():
    csv = ("joint.left.drive=cia402-csv", "joint.right.drive=cia402-csv")
    load_robot(CIA402, csv)
    with pytest.raises(ConfigError) as error:
        load_robot(CIA402, (*csv, "line.can0.cycle_hz=30"))
    message = "cycle_hz: cia402-csv: interpolation_time cannot hold the line's cycle, 33.33 ms"
    assert message in "\n".join(map(str, error.value.problems))


CSV = (config_dir() / "drives" / "cia402-csv.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('sync = "sync"', 'sync = "rpdo_1"', '"rpdo_1" must be sent by motord, with addressed'),
        ('sync = "sync"', 'sync = "synk"', 'did you mean "sync"?'),
        ('"interpolation_time", cycle', '"mode", cycle', "cycle is for a time"),
        ('"interpolation_time", cycle = true', '"interpolation_time"', "value: is missing"),
        ('"status_object"\nso', '"status_objekt"\nso', 'did you mean "status_object"?'),
        ('"status_object"\nso', '"control_word"\nso', '"control_word" cannot be read'),
        ('"status_object"\nso', '"mode_shown"\nso', "mode_shown has another type, scale or unit"),
    ],
)
def test_a_mistake_about_sync_or_an_object_is_reported(tmp_path, right, wrong, message):
    assert right in CSV
    path = tmp_path / "cia402-csv.toml"
    path.write_text(CSV.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(ProfileError) as error:
        load_profile(path)
    assert message in str(error.value)


PP = (config_dir() / "drives" / "cia402-pp.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('register = "control_word"', 'register = "nmt_command"', "is not in the frame of the set"),
        ('register = "control_word"', 'register = "controlword"', 'did you mean "control_word"?'),
        ("mask = 0x10\n", "mask = 0x30\n", "0x30 is not one bit"),
        ("mask = 0x10\n", "mask = 0x10000\n", "0x10000 does not fit control_word"),
        ('acknowledged = "status_word"', 'acknowledged = "position"', 'has the unit "count"'),
        ("acknowledged_mask = 0x1000", "acknowledged_mask = 0x10000", "does not fit status_word"),
        ('position_setpoint = "target_position"', 'velocity_setpoint = "velocity"',
         "is for a position_setpoint on a CAN bus"),
    ],
)  # fmt: skip
def test_a_mistake_about_a_handshake_is_reported(tmp_path, right, wrong, message):
    assert right in PP
    path = tmp_path / "cia402-pp.toml"
    path.write_text(PP.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(ProfileError) as error:
        load_profile(path)
    assert message in str(error.value)


@pytest.mark.parametrize(("big_endian", "start_bit"), [(False, 36), (True, 43)])
def test_a_handshake_is_a_bit_of_its_word(big_endian, start_bit):
    profile = find_profile("cia402-pp")
    word = replace(profile.registers["control_word"], big_endian=big_endian)
    profile = replace(profile, registers={**profile.registers, "control_word": word})
    joint = JointSpec(index=0, name="turret", profile=profile, unit=5, position_velocity_rad_s=1.0)
    _, spec = loaded()
    drive = drive_table(CanPlan([joint]), spec)
    trigger = drive["output"][0]["setpoint"][0]["trigger"]
    assert (trigger["start_bit"], trigger["length"]) == (start_bit, 1)
    taken = [field["meaning"] for one in drive["input"] for field in one["field"]
             if field["meaning"]["kind"] == FieldKind.TAKEN]  # fmt: skip
    assert [(one["joint"], one["equals_mask"], one["equals"]) for one in taken] == [
        (0, 0x1000, 0x1000)
    ]


MOTEUS = (config_dir() / "drives" / "moteus.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('answers = "command"', 'answers = "reply"', '"reply" is not a frame that motord sends'),
        ('ask = "query"', 'ask = "queri"', 'did you mean "query"?'),
        ('reply = "reply"', 'reply = "query"', "is the drive's frame for a signal"),
        ("start_bit = 120", "start_bit = 100", "overlaps"),
        ("bytes = 48", "bytes = 16", "watchdog reaches beyond the 16 bytes"),
        ("0x21, 0x00, -1,", "0x21, 0x00, -2,", "-2 is out of range (-1 to 255)"),
        ("node_shift = 8", "node_shift = 24", "with node 127 it is beyond 0x1fffffff"),
    ],
)
def test_a_mistake_about_frames_that_answer_is_reported(tmp_path, right, wrong, message):
    assert right in MOTEUS
    path = tmp_path / "moteus.toml"
    path.write_text(MOTEUS.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(ProfileError) as error:
        load_profile(path)
    assert message in str(error.value)


def test_a_reply_is_recognized_by_every_byte_that_is_not_a_signal():
    profile = find_profile("moteus")
    reply, signals = profile.can.frames["reply"], signals_of(profile.registers, "reply")
    data = bytearray(build(reply, signals, {"mode_shown": 10, "fault": 33}))
    assert parse(reply, signals, bytes(data))["fault"] == 33
    for at, byte in enumerate(reply.begins):
        other = bytearray(data)
        other[at] ^= 0xFF
        assert (parse(reply, signals, bytes(other)) is None) == (at not in reply.open_at), byte


def test_a_short_identifier_goes_with_11_bits_where_the_drive_sends_it_so():
    reply = find_profile("moteus").can.frames["reply"]
    assert [reply.is_extended(node) for node in (1, 7, 8, 127)] == [False, False, True, True]
    assert reply.identifier(8) == 0x800


def test_a_bus_of_classic_frames_is_no_bus_for_a_drive_that_speaks_can_fd():
    moteus = ("joint.left.drive=moteus", "joint.right.drive=moteus")
    load_robot(ROBOT, (*moteus, "line.can0.data_bitrate=5000000"))
    assert 'is missing: drive "moteus" speaks CAN FD' in wrong(*moteus)
