# SPDX-License-Identifier: Apache-2.0
"""Drive profiles with an EDS file: objects are checked against the file, without a drive."""

import re
import tomllib

import pytest

from motord.config.drives.load import load_profile
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir

PROFILE = (config_dir() / "drives" / "cia402-csv.toml").read_text(encoding="utf-8")
TYPES = {"i8": 2, "i16": 3, "i32": 4, "u8": 5, "u16": 6, "u32": 7}
MAPPED = {
    (0x603F, 0): "u16",
    (0x6040, 0): "u16",
    (0x6041, 0): "u16",
    (0x6064, 0): "i32",
    (0x606C, 0): "i32",
    (0x6077, 0): "i16",
    (0x60FF, 0): "i32",
    (0x6502, 0): "u32",
}
MODES = 0x1A5
"""Bits in 6502h: profile position, profile velocity, homing, cyclic synchronous position and
velocity."""


def entry(section, kind, access, default, mapping):
    return (
        f"[{section}]\nParameterName=p{section}\nObjectType=0x7\nDataType=0x{TYPES[kind]:04X}\n"
        f"AccessType={access}\nDefaultValue={default}\nPDOMapping={mapping}\n\n"
    )


def sheet():
    """Return the EDS file of a drive that has all that the profile needs."""
    entries = {}
    for one in tomllib.loads(PROFILE)["object"].values():
        access = "ro" if one.get("access") == "r" else "rw"
        entries[one["index"], one["sub"]] = (one["type"], access, one.get("default", 0), 0)
    for place, kind in MAPPED.items():
        entries[place] = (kind, "rw", MODES if place[0] == 0x6502 else 0, 1)
    records = {index for index, sub in entries if sub}
    text = "[DeviceInfo]\nVendorName=none\n\n"
    for index in sorted(records):
        text += f"[{index:04X}]\nParameterName=r{index:04X}\nObjectType=0x9\nSubNumber=9\n\n"
        entries.setdefault((index, 0), ("u8", "rw", 0, 0))
    for (index, sub), rest in sorted(entries.items()):
        section = f"{index:04X}sub{sub:X}" if index in records else f"{index:04X}"
        text += entry(section, *rest)
    return text


EDS = sheet()


def written(folder, right="", wrong="", eds_right="", eds_wrong=""):
    assert right in PROFILE
    assert eds_right in EDS
    text = PROFILE.replace(right, wrong, 1) if right else PROFILE
    text = text.replace("\n[can]\n", '\n[eds]\nfile = "drive.eds"\n\n[can]\n', 1)
    path = folder / "cia402-csv.toml"
    path.write_text(text, encoding="utf-8")
    sheet_text = EDS.replace(eds_right, eds_wrong, 1) if eds_right else EDS
    (folder / "drive.eds").write_text(sheet_text, encoding="utf-8")
    return path


def problems(*arguments):
    with pytest.raises(ProfileError) as error:
        load_profile(written(*arguments))
    return str(error.value)


def part(section):
    """Return a section of EDS."""
    return re.search(rf"\[{section}\]\n(?:.+\n)+", EDS)[0]


def test_a_sheet_that_agrees_changes_nothing(tmp_path):
    plain = load_profile(config_dir() / "drives" / "cia402-csv.toml")
    assert load_profile(written(tmp_path)).registers == plain.registers


def test_types_and_start_values_may_come_from_the_sheet(tmp_path):
    no_type = 'index = 0x6079\nsub = 0\ntype = "u32"\naccess = "r"\nscale = 0.001\nunit = "v"\n'
    path = written(tmp_path, no_type + "default = 24000", no_type.replace('type = "u32"\n', ""))
    register = load_profile(path).registers["bus_voltage"]
    assert (register.type, register.default) == ("u32", 24000)


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("index = 0x605A", "index = 0x605B", "605Bh:00h is not in drive.eds"),
        ('sub = 5\ntype = "u16"', 'sub = 5\ntype = "u32"', '"u32" is not "u16"'),
        ("value = 0x60FF0020", "value = 0x60FE0020", "60FEh:00h is not in drive.eds"),
        ("value = 0x60FF0020", "value = 0x60FF0010", "60FFh:00h has 32 bits, not 16"),
        ("value = 0x60FF0020", "value = 0x60790020", "6079h:00h cannot be mapped into a PDO"),
        ('"mode", value = 9', '"mode", value = 10', "the drive has no mode 10 (6502h)"),
        ('index = 0x6079\nsub = 0\ntype = "u32"\naccess = "r"',
         'index = 0x6079\nsub = 0\ntype = "u32"', "cannot be written (ro)"),
    ],
)  # fmt: skip
def test_an_object_that_the_drive_lacks_is_reported(tmp_path, right, wrong, message):
    found = problems(tmp_path, right, wrong)
    assert message in found
    assert re.search(r"cia402-csv\.toml:\d+: ", found)


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("[DeviceInfo]\n", "", "drive.eds:1: eds: File contains no section headers"),
        (part("605A"), part("605A") * 2, "drive.eds:"),
        ("VendorName=none", "VendorName=none\nnothing", "drive.eds:3: eds: "),
        ("DataType=0x0003", "DataType=three", "drive.eds: eds: "),
    ],
)
def test_a_sheet_that_cannot_be_read_is_named(tmp_path, right, wrong, message):
    assert message in problems(tmp_path, "", "", right, wrong)


def test_a_sheet_that_is_not_there_is_named(tmp_path):
    path = written(tmp_path)
    (tmp_path / "drive.eds").unlink()
    with pytest.raises(ProfileError, match=r"drive\.eds: cannot be read: No such file"):
        load_profile(path)
