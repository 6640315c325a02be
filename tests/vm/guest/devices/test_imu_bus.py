# SPDX-License-Identifier: Apache-2.0
"""An inertial sensor on an I2C bus of the kernel (i2c-stub keeps its registers): its
identity, set-up and samples by real transfers.

Source: kernel, Documentation/i2c/i2c-stub.rst.
"""

import math
import struct
import subprocess
import threading
from pathlib import Path

import pytest
from shell import wait_until

from motord_hal.base.errors import BadReply
from motord_hal.fieldbus.ports import Mounting
from motord_hal.i2c.bus import I2cDevice
from motord_hal.i2c.imu_reader import ImuReader, ImuSpec
from motord_hal.realtime.exchange import Exchange

ADDRESS = 0x68
ROW = 0x3B


def stub():
    """Return the device file of the bus; None if the kernel has no such bus."""
    for name in Path("/sys/bus/i2c/devices").glob("i2c-*/name"):
        if "stub" in name.read_text():
            return Path("/dev", name.parent.name)
    return None


@pytest.fixture(scope="module")
def bus():
    loading = ("modprobe", "-a", "i2c-dev")
    subprocess.run(loading, check=False, capture_output=True, timeout=100)
    asked = ("modprobe", "i2c-stub", f"chip_addr=0x{ADDRESS:02x}")
    done = subprocess.run(asked, check=False, capture_output=True, text=True, timeout=100)
    if done.returncode != 0:
        pytest.skip(f"no i2c-stub: {done.stderr}")
    wait_until(lambda: (path := stub()) and path.exists(), "the bus's device file")
    yield stub()
    subprocess.run(("modprobe", "-r", "i2c-stub"), check=False, capture_output=True, timeout=100)


class Stub:
    """The sensor: it writes the registers, which the bus keeps."""

    def __init__(self, bus, identity=0x68):
        self.device = I2cDevice.open(bus, ADDRESS)
        self.device.write_byte(0x75, identity)
        self.turn = 0

    def say(self, gyro_z, up=8192):
        """Put a sample into the registers, with one count of noise as from a real chip."""
        self.turn ^= 1
        row = struct.pack(">7h", self.turn, 0, up, 0, 0, 0, gyro_z)
        for place, byte in enumerate(row):
            self.device.write_byte(ROW + place, byte)


def reading(bus, exchange):
    spec = ImuSpec(kind="mpu6050", rate_hz=50.0, range_rad_s=4.0, mounting=Mounting())
    return ImuReader(spec, lambda: I2cDevice.open(bus, ADDRESS), exchange)


def test_the_bus_belongs_to_the_group_of_the_daemon(bus):
    wait_until(lambda: bus.group() == "i2c", "the package's rule for the device file")
    assert bus.stat().st_mode & 0o777 == 0o660


@pytest.mark.smoke
def test_samples_come_over_the_kernels_bus_in_si(bus):
    chip, exchange = Stub(bus), Exchange.private()
    reader = reading(bus, exchange)
    thread = threading.Thread(target=reader.run)
    thread.start()

    def turning():
        chip.say(round(0.5 / math.radians(250.0) * 32768))
        sample = exchange.take_imu()
        return sample.stamp_ns > 0 and abs(sample.angular_rad_s[2] - 0.5) < 0.001

    try:
        wait_until(turning, "a sample")
        assert exchange.take_imu().acceleration_m_s2[2] == pytest.approx(9.807, abs=0.01)
        assert chip.device.read_byte(0x1A) == 0x03
        assert chip.device.read_byte(0x6B) == 0x01
    finally:
        reader.stop()
        thread.join(60)
    assert not thread.is_alive()


def test_another_chip_is_refused_by_its_identity(bus):
    Stub(bus, identity=0x19)
    with pytest.raises(BadReply, match="no mpu6050: register 0x75 reads 0x19"):
        reading(bus, Exchange.private()).run()
