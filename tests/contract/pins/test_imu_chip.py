# SPDX-License-Identifier: Apache-2.0
"""Inertial sensors as their data sheets have them, on a bus of registers that this file keeps."""

import math
import random
import struct
import threading
from types import SimpleNamespace

import pytest
from smbus2.smbus2 import I2C_SMBUS

from motord_hal.base.errors import BadReply, NoReply, PortError
from motord_hal.fieldbus.ports import Mounting
from motord_hal.i2c import imu_reader
from motord_hal.i2c.bus import I2cDevice
from motord_hal.i2c.imu import STUCK_SAMPLES, ImuChip
from motord_hal.i2c.imu_reader import ImuReader, ImuSpec
from motord_hal.realtime.exchange import Exchange


class Chip:
    """A sensor: a reset restores its registers' defaults, it sleeps until it is woken, and its
    numbers have noise in their last bit. `gyro` and `acceleration` are counts."""

    def __init__(self, identity):
        self.identity = identity
        self.gyro, self.acceleration = [0, 0, 0], [0, 0, 0]
        self.noise = random.Random(1)
        self.noisy = True
        self.failing = 0
        self.log = []
        self.closed = False
        self.power_up()

    def read_byte(self, register):
        return self.identity if register == self.ID else self.registers.get(register, 0)

    def write_byte(self, register, value):
        self.log.append((register, value))
        if (register, value) == self.RESET:
            self.power_up()
        else:
            self.registers[register] = value

    def read_row(self, register, size):
        if self.failing:
            self.failing -= 1
            raise NoReply("no answer")
        data = self.row() if self.awake() else bytes(self.SIZE)
        assert (register, size) == (self.FIRST, self.SIZE)
        return data

    def jitter(self, counts):
        top = 1 if self.noisy else 0
        return [max(-32768, min(32767, n + self.noise.randint(0, top))) for n in counts]

    def close(self):
        self.closed = True


class Mpu(Chip):
    """MPU-6050 and its successors: asleep after power-on (PWR_MGMT_1 = 0x40), high byte first."""

    ID, RESET, FIRST, SIZE = 0x75, (0x6B, 0x80), 0x3B, 14

    def power_up(self):
        self.registers = {0x6B: 0x40}

    def awake(self):
        return not self.registers[0x6B] & 0x40

    def row(self):
        felt, turned = self.jitter(self.acceleration), self.jitter(self.gyro)
        return struct.pack(">7h", *felt, 1234, *turned)

    def full_scale_dps(self):
        return 250 << (self.registers.get(0x1B, 0) >> 3 & 3)


class Lsm(Chip):
    """LSM6DS: gyro and accelerometer are off until they get a rate, low byte first."""

    ID, RESET, FIRST, SIZE = 0x0F, (0x12, 0x01), 0x22, 12

    def power_up(self):
        self.registers = {0x12: 0x04}

    def awake(self):
        return self.registers.get(0x11, 0) >> 4 != 0 and self.registers.get(0x10, 0) >> 4 != 0

    def row(self):
        return struct.pack("<6h", *self.jitter(self.gyro), *self.jitter(self.acceleration))

    def full_scale_dps(self):
        return 250 << (self.registers.get(0x11, 0) >> 2 & 3)


KINDS = [
    ("mpu6050", Mpu, 0x68, 131.0, 8192.0),
    ("mpu6500", Mpu, 0x70, 131.0, 8192.0),
    ("mpu9250", Mpu, 0x71, 131.0, 8192.0),
    ("mpu9250", Mpu, 0x73, 131.0, 8192.0),
    ("lsm6ds3", Lsm, 0x69, 1000.0 / 8.75, 1000.0 / 0.122),
    ("lsm6ds3", Lsm, 0x6A, 1000.0 / 8.75, 1000.0 / 0.122),
    ("lsm6dso", Lsm, 0x6C, 1000.0 / 8.75, 1000.0 / 0.122),
    ("ism330dhcx", Lsm, 0x6B, 1000.0 / 8.75, 1000.0 / 0.122),
]
"""Kind, model, identity, counts per °/s at full scale 250 °/s, counts per g at 4 g."""
each_kind = pytest.mark.parametrize(("kind", "model", "identity", "per_dps", "per_g"), KINDS)


def opened(kind, device, range_rad_s=8.0, rate_hz=100.0):
    return ImuChip(kind, device, rate_hz=rate_hz, range_rad_s=range_rad_s, sleep=lambda _: None)


@each_kind
@pytest.mark.parametrize("range_dps", [250, 500, 1000, 2000])
def test_counts_are_those_of_the_data_sheet_at_each_scale(
    kind, model, identity, per_dps, per_g, range_dps
):
    device = model(identity)
    device.noisy = False
    chip = opened(kind, device, math.radians(range_dps * 0.9))
    assert device.full_scale_dps() == range_dps
    wanted_dps, scale = (12.0, -40.0, 100.0), 250.0 / range_dps
    device.gyro = [round(rate * per_dps * scale) for rate in wanted_dps]
    device.acceleration = [0, round(-0.5 * per_g), round(per_g)]
    sample = chip.read()
    step = math.radians(1.0 / (per_dps * scale))
    wanted_rad_s = [math.radians(rate) for rate in wanted_dps]
    assert sample.angular_rad_s == pytest.approx(wanted_rad_s, rel=1e-3, abs=step)
    assert sample.acceleration_m_s2 == pytest.approx([0.0, -4.903, 9.807], abs=0.01)
    assert not sample.saturated


@each_kind
def test_an_unknown_chip_is_not_written_to(kind, model, identity, per_dps, per_g):
    device = model(0x42)
    with pytest.raises(BadReply, match=f"no {kind}: register 0x{device.ID:02X} reads 0x42"):
        opened(kind, device)
    assert device.log == []


def test_a_related_chip_is_named():
    with pytest.raises(BadReply, match=r"no mpu6050: .* it is an mpu6500"):
        opened("mpu6050", Mpu(0x70))


@each_kind
@pytest.mark.parametrize("count", [32767, -32768])
def test_a_rate_at_the_end_of_the_scale_is_reported(kind, model, identity, per_dps, per_g, count):
    device = model(identity)
    chip = opened(kind, device)
    device.gyro = [0, 0, count]
    assert chip.read().saturated


@each_kind
def test_a_chip_that_lost_its_power_is_noticed(kind, model, identity, per_dps, per_g):
    device = model(identity)
    chip = opened(kind, device)
    chip.read()
    device.power_up()
    with pytest.raises(BadReply, match=r"has lost its set-up|stands still"):
        for _ in range(200):
            chip.read()


def test_a_sensor_that_repeats_one_sample_is_an_error():
    device = Mpu(0x68)
    chip = opened("mpu6050", device)
    device.noisy = False
    with pytest.raises(BadReply, match="stands still"):
        for _ in range(STUCK_SAMPLES + 2):
            chip.read()


@pytest.mark.parametrize("rate_hz", [20.0, 104.0, 150.0, 400.0])
def test_the_lsm_samples_at_least_twice_as_often_as_it_is_read(rate_hz):
    device = Lsm(0x69)
    opened("lsm6ds3", device, rate_hz=rate_hz)
    sampled_hz = 13.0 * 2 ** ((device.registers[0x11] >> 4) - 1)
    assert sampled_hz >= 2 * rate_hz


def test_a_missing_bus_is_reported_with_the_remedy(tmp_path):
    with pytest.raises(PortError, match="there is no such I2C bus: switch I2C on"):
        I2cDevice.open(tmp_path / "i2c-7", 0x68)


def test_a_row_that_the_adapter_has_cut_short_is_a_bad_reply(monkeypatch):
    """An SMBus controller may end a transfer early; then only its count shows it."""
    adapter = SimpleNamespace(fd=-1)
    device = I2cDevice(adapter, 0x68, "i2c-1 at 0x68")

    def answering(count):
        def ioctl(fd, request, argument):
            if request == I2C_SMBUS:
                argument.data.contents.block[:4] = [count, 7, 8, 9]

        monkeypatch.setattr("motord_hal.i2c.bus.fcntl.ioctl", ioctl)

    answering(3)
    assert device.read_row(0x3B, 3) == bytes([7, 8, 9])
    answering(2)
    with pytest.raises(BadReply, match="register 0x3b: 2 bytes of 3"):
        device.read_row(0x3B, 3)


# ------------------------------------------------------------------------------------ the thread
def spec(**changes):
    values = {"kind": "mpu6050", "rate_hz": 400.0, "range_rad_s": 8.0, "mounting": Mounting()}
    return ImuSpec(**values | changes)


class Running:
    """The reader in a thread of its own, as in the daemon."""

    def __init__(self, device, **changes):
        self.exchange = Exchange.private()
        self.reader = ImuReader(spec(**changes), lambda: device, self.exchange)
        self.error = None
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        try:
            self.reader.run()
        except (NoReply, BadReply) as error:
            self.error = error

    def until(self, condition):
        for _ in range(3000):
            if condition():
                return
            threading.Event().wait(0.01)
        raise AssertionError("waited in vain")

    def stop(self):
        self.reader.stop()
        self.thread.join(30)
        assert not self.thread.is_alive()


def test_samples_reach_the_loop_in_the_bases_axes_and_the_device_is_closed_at_the_end():
    device = Mpu(0x68)
    device.gyro, device.acceleration = [0, 6550, 0], [0, -8192, 0]
    running = Running(device, mounting=Mounting(up="-y", forward="x"))
    running.until(lambda: running.reader.samples > 3)
    running.stop()
    sample = running.exchange.take_imu()
    assert sample.angular_rad_s == pytest.approx((0.0, 0.0, -math.radians(100.0)), abs=0.001)
    assert sample.acceleration_m_s2 == pytest.approx((0.0, 0.0, 9.807), abs=0.01)
    assert sample.epoch == 1
    assert device.closed


def test_two_missing_answers_do_not_close_the_sensor_and_three_do():
    device = Mpu(0x68)
    running = Running(device)
    running.until(lambda: running.reader.samples > 3)
    device.failing = 2
    before = running.reader.samples
    running.until(lambda: running.reader.samples > before + 3)
    device.failing = 1000
    running.thread.join(30)
    assert isinstance(running.error, NoReply)
    assert device.closed


def test_a_chip_that_is_opened_again_has_a_new_epoch():
    device = Mpu(0x68)
    running = Running(device)
    running.until(lambda: running.reader.samples > 3)
    device.failing = 1000
    running.thread.join(30)
    device.failing = 0
    before = running.reader.samples
    running.thread = threading.Thread(target=running.run)
    running.thread.start()
    running.until(lambda: running.reader.samples > before)
    running.stop()
    assert running.exchange.take_imu().epoch == 2


def test_a_bus_on_which_every_transfer_is_late_is_reported_and_gives_no_samples(monkeypatch):
    monkeypatch.setattr(imu_reader, "LATE_NS", -1)
    running = Running(Mpu(0x68))
    running.thread.join(30)
    assert "transfers in a row took more than" in str(running.error)
    assert running.reader.samples == running.exchange.take_imu().stamp_ns == 0


# ------------------------------------------------------------------------------------ the mounting
AXES = ("x", "-x", "y", "-y", "z", "-z")
MOUNTINGS = [(up, forward) for up in AXES for forward in AXES if up[-1] != forward[-1]]


@pytest.mark.parametrize(("up", "forward"), MOUNTINGS)
def test_every_mounting_is_a_rotation_and_can_be_inverted(up, forward):
    mounting = Mounting(up=up, forward=forward)
    rows = [mounting.to_base(unit) for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    (a, b, c), (d, e, f), (g, h, i) = rows
    assert a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) == 1.0
    assert mounting.from_base(mounting.to_base((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)
    sample = dict(zip("xyz", (1.0, 2.0, 3.0), strict=True))
    along = mounting.to_base((1.0, 2.0, 3.0))
    for axis, value in ((forward, along[0]), (up, along[2])):
        assert value == (-1.0 if axis.startswith("-") else 1.0) * sample[axis[-1]]
