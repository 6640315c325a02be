# SPDX-License-Identifier: Apache-2.0
"""INA219, INA226, INA228 and INA238 as their data sheets have them, on a bus of registers that this
file keeps."""

import math

import pytest

from motord_hal.base.errors import BadReply, PortError
from motord_hal.i2c.bus import I2cDevice
from motord_hal.i2c.ina import Ina


class Bus:
    """A device's registers as they are after power-on."""

    def __init__(self, **words):
        self.words = {int(name[1:], 16): value for name, value in words.items()}
        self.closed = False

    def read_word(self, register):
        return self.words.get(register, 0)

    def write_word(self, register, value):
        self.words[register] = value

    def read_row(self, register, size):
        return self.words.get(register, 0).to_bytes(size, "big")

    def close(self):
        self.closed = True


def ina219(**words):
    return Bus(x00=0x399F, **words)


def ina226(**words):
    return Bus(x00=0x4127, xFE=0x5449, xFF=0x2260, **words)


def ina228(**words):
    """Return a chip with ADC_CONFIG as after power-on, and a range that another program has set."""
    return Bus(x00=0x0010, x01=0xFB68, x3E=0x5449, x3F=0x2281, **words)


def ina238(**words):
    return Bus(x00=0x0000, x01=0xFB68, x3E=0x5449, x3F=0x2381, **words)


def test_an_ina219_measures_4_mv_and_10_uv_a_count():
    # 20 mV over 0.1 Ohm; the bus register's lower three bits are no voltage
    chip = Ina("ina219", ina219(x02=(1492 << 3) | 2, x01=2000), 0.1)
    power = chip.read()
    assert power.voltage_v == pytest.approx(5.968)
    assert power.current_a == pytest.approx(0.2)


def test_an_ina226_measures_1_25_mv_and_2_5_uv_a_count():
    # 0x2570 = 9584 counts; 0x1F40 = 8000 counts: 20 mV over 2 mOhm
    power = Ina("ina226", ina226(x02=0x2570, x01=0x1F40), 0.002).read()
    assert power.voltage_v == pytest.approx(11.98)
    assert power.current_a == pytest.approx(10.0)


def test_an_ina228_measures_195_3125_uv_312_5_nv_and_7_8125_mk_a_count():
    # 48 V are 245760 counts, 20 mV over 0.5 mOhm 64000, 25 °C 3200; 20 of 24 bits
    bus = ina228(x05=245760 << 4, x04=64000 << 4, x06=3200)
    power = Ina("ina228", bus, 0.0005).read()
    assert power.voltage_v == pytest.approx(48.0)
    assert power.current_a == pytest.approx(40.0)
    assert power.chip_c == pytest.approx(25.0)
    assert bus.words[0] == 0  # the wide range, though another program had set the narrow one


def test_an_ina238_measures_3_125_mv_5_uv_and_an_eighth_of_a_kelvin_a_count():
    # 48 V are 15360 counts, 20 mV 4000; -10 °C are -80 in bits 15 to 4
    power = Ina("ina238", ina238(x05=15360, x04=4000, x06=0x10000 - (80 << 4)), 0.0005).read()
    assert power.voltage_v == pytest.approx(48.0)
    assert power.current_a == pytest.approx(40.0)
    assert power.chip_c == pytest.approx(-10.0)


def test_a_chip_without_a_thermometer_reports_no_temperature():
    assert math.isnan(Ina("ina226", ina226(x02=0x2570), 0.002).read().chip_c)


@pytest.mark.parametrize(("kind", "other"), [("ina228", ina238()), ("ina238", ina228())])
def test_the_two_with_a_thermometer_are_not_taken_for_each_other(kind, other):
    with pytest.raises(BadReply, match=f"no {kind}: register 0x3F reads"):
        Ina(kind, other, 0.01)


def test_a_chip_whose_range_changes_later_reports_nothing():
    bus = ina228(x05=245760 << 4)
    chip = Ina("ina228", bus, 0.01)
    bus.words[0] = 0x0010
    with pytest.raises(BadReply, match=r"0x0010.*0x0000"):
        chip.read()


def test_a_current_that_flows_back_is_negative():
    power = Ina("ina226", ina226(x02=0x2570, x01=0x10000 - 0x1F40), 0.002).read()
    assert power.current_a == pytest.approx(-10.0)
    power = Ina("ina228", ina228(x04=(1 << 24) - (64000 << 4)), 0.0005).read()
    assert power.current_a == pytest.approx(-40.0)


@pytest.mark.parametrize(
    ("kind", "bus"),
    [
        ("ina219", ina219(x02=3000 << 3, x01=32000)),
        ("ina219", ina219(x02=(3000 << 3) | 1, x01=100)),
        ("ina226", ina226(x02=9600, x01=0x7FFF)),
        ("ina226", ina226(x02=9600, x01=0x8000)),
        ("ina228", ina228(x05=61440 << 4, x04=0x7FFFF0)),
        ("ina228", ina228(x05=61440 << 4, x04=0x800000)),
        ("ina238", ina238(x05=3840, x04=0x7FFF)),
    ],
    ids=["219", "219's overflow bit", "226", "226's other end", "228", "228's other end", "238"],
)
def test_a_current_beyond_the_scale_is_nan_and_the_voltage_is_still_measured(kind, bus):
    power = Ina(kind, bus, 0.01).read()
    assert math.isnan(power.current_a)
    assert power.voltage_v == pytest.approx(12.0)


def test_an_ina226_is_identified_by_its_maker_before_anything_is_written():
    stranger = Bus(x00=0x1234, xFE=0xFFFF)
    with pytest.raises(BadReply, match="no ina226: register 0xFE reads 0xFFFF"):
        Ina("ina226", stranger, 0.01)
    assert stranger.words[0] == 0x1234


def test_a_chip_that_lost_power_reports_nothing_until_it_is_set_up_again():
    bus = ina219(x02=1492 << 3)
    chip = Ina("ina219", bus, 0.1)
    bus.words[0] = 0x399F
    with pytest.raises(BadReply, match=r"0x399F.*0x3FFF"):
        chip.read()
    assert Ina("ina219", bus, 0.1).read().voltage_v == pytest.approx(5.968)


def test_a_chip_that_keeps_no_configuration_is_refused():
    class Stubborn(Bus):
        def write_word(self, register, value):
            """Acknowledge the write, and keep the old value."""

    with pytest.raises(BadReply, match="another chip"):
        Ina("ina219", Stubborn(x00=0x399F), 0.1)


def test_a_missing_bus_is_named_with_the_remedy(tmp_path):
    with pytest.raises(PortError, match=r"i2c-9 at 0x40: there is no such I2C bus: switch I2C on"):
        I2cDevice.open(tmp_path / "i2c-9", 0x40)


def test_a_file_that_is_not_a_bus_is_refused_and_closed(tmp_path):
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(PortError, match=r"file at 0x40: Inappropriate ioctl"):
        I2cDevice.open(path, 0x40)
