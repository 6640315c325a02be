# SPDX-License-Identifier: Apache-2.0
"""An error of the system that a kind of line has missed: its drives are stopped, the line is lost,
the log says that it is a bug, and the line is opened again. Its task goes on."""

import logging
import termios

import pytest
from loop_side import running, until
from modbus_rig import registers_of, spec_of
from scripted_gateway import peer_on
from scripted_slave import Unit

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import EventKind, JointSpec

TARGET, ENABLE, STATUS = 0x0200, 0x0201, 0x0202
ON, OFF = 1, 0
WHEEL = JointSpec(index=0, name="wheel", profile=find_profile("speed-register"), unit=1)
ERRORS = [OSError(9, "Bad file descriptor"), termios.error(5, "Input/output error")]


@pytest.fixture(params=["asyncio", "rt", "modbus-tcp", "rtu-over-tcp"])
async def peer(tmp_path, request):
    peer = peer_on(request.param, tmp_path)
    peer.units[1] = Unit(registers_of("speed-register"))
    yield peer
    peer.pull()


@pytest.fixture
async def rig(peer):
    """A line whose drive turns."""
    unit = peer.units[1]
    async with running(spec_of(peer, [WHEEL])) as rig:

        def switch(address, value):
            if address == ENABLE:
                unit.registers[STATUS] = value

        unit.on_write = switch
        rig.loop.velocity_rad_s = {0: 20.0}
        await rig.drive(lambda: unit.registers[TARGET] > 0, "it drives")
        yield rig


def fails_once(monkeypatch, line, method, error):
    """Give the class of this line a method with a mistake in it."""
    sound, left = getattr(type(line), method), [error]

    def mistaken(self, *values):
        if left:
            raise left.pop()
        return sound(self, *values)

    monkeypatch.setattr(type(line), method, mistaken)


@pytest.mark.parametrize("error", ERRORS, ids=["OSError", "termios.error"])
async def test_a_missed_error_stops_the_drives_and_loses_the_line_alone(
    rig, peer, error, monkeypatch, caplog
):
    opened_at_off = []
    unit, switch = peer.units[1], peer.units[1].on_write

    def note(address, value):
        if (address, value) == (ENABLE, OFF):
            opened_at_off.append(rig.kinds().count(EventKind.LINE_OPEN))
        switch(address, value)

    unit.on_write = note
    fails_once(monkeypatch, rig.line, "_look", error)
    await until(lambda: rig.kinds().count(EventKind.LINE_OPEN) == 2, "it is opened again")
    assert rig.kinds().count(EventKind.LINE_LOST) == 1
    assert opened_at_off[0] == 1, "the power goes off before the line is closed"
    rig.loop.enabled = False
    await rig.ready()
    assert (unit.registers[TARGET], unit.registers[ENABLE]) == (0, OFF)
    (logged,) = [one for one in caplog.records if one.levelno == logging.ERROR]
    assert "a bug of motord" in logged.getMessage()
    assert logged.exc_info[1] is error


async def test_an_error_that_comes_with_the_end_does_not_keep_the_line_from_ending(
    rig, peer, monkeypatch
):
    fails_once(monkeypatch, rig.line, "_look", ERRORS[0])
    rig.task.cancel()
    await until(rig.task.done, "the line ends")
    assert rig.task.cancelled()
    assert peer.units[1].registers[ENABLE] == OFF
