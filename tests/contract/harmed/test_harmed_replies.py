# SPDX-License-Identifier: Apache-2.0
"""Lines of every kind, of whose replies every fiftieth is lost, damaged or late. With the default
feedback_timeout_s, or the shortest one without a warning of `motord check`, that is no fault: every
drive stays armed, and no feedback becomes stale."""

import asyncio
import contextlib
from dataclasses import dataclass, replace

import pytest
from gateway_rig import served
from loop_side import running, until
from sim_bench import simulated, spec_of
from tests.long_cases import long_but
from tests.shipped import shipped_profile

from motord.config.rules.wiring.times import longest_gap_s
from motord.config.sections.model import Safety
from motord_hal.fieldbus.ports import DriveState, EventKind

TICK_S = 0.01
"""Time between two looks. They are counted: on a busy machine they are further apart, and so are
the cycles of the line."""
NTH = 50
HARMED_LEAST, EPISODES_MAX = 4, 40
"""Number of harmed replies that have to be no fault, and that are tried at most."""
ERRORS_A_HIT = 2
"""Errors of each joint that one harmed reply explains: replies behind a late one are late, too."""
TICKS_AFTER = 40
CYCLE_HZ = 50.0
UART_LATE_MS, GATEWAY_LATE_MS = 15, 60
"""Delays of a late reply: what an adapter, and what a network adds at most, or nearly so."""
GATEWAY_WAITS_S = 0.1
"""Response timeout of the gateway, as docs/rs485.md recommends it: it serves nothing meanwhile."""
HARM = {"lost": "drop:", "damaged": "corrupt:", "late": "delay:ms={},"}
GOOD = (EventKind.LINE_OPEN, EventKind.DRIVE_READY)


@dataclass(frozen=True)
class Medium:
    """A kind of line, and a drive on it."""

    drive: str
    kind: str = ""
    rt: bool = False
    joints: int = 2


MEDIA = {
    "modbus-rtu rt": Medium("zlac8015d", rt=True),
    "modbus-rtu asyncio": Medium("zlac8015d"),
    "modbus-rtu rt, two drives": Medium("bld-305s", rt=True),
    "modbus-rtu asyncio, two drives": Medium("bld-305s"),
    "modbus-tcp": Medium("zlac8015d", "modbus-tcp"),
    "rtu-over-tcp": Medium("zlac8015d", "rtu-over-tcp"),
    "ddsm": Medium("ddsm115", rt=True),
    "roboclaw": Medium("roboclaw", rt=True),
    **{f"feetech {n}": Medium("sts3215", rt=True, joints=n) for n in (2, 6, 8)},
    "feetech without sync read": Medium("scs0009", rt=True),
    **{f"dynamixel {n}": Medium("xm430", rt=True, joints=n) for n in (2, 6, 8)},
    "odrive rt": Medium("odrive-0.6", rt=True),
    "odrive asyncio": Medium("odrive-0.6"),
    "cia402 rt": Medium("cia402", rt=True),
    "cia402 asyncio": Medium("cia402"),
    "rmd rt": Medium("rmd", rt=True),
    "rmd asyncio": Medium("rmd"),
    "moteus rt": Medium("moteus", rt=True),
    "moteus asyncio": Medium("moteus"),
    "vesc rt": Medium("vesc", rt=True),
    "mcu": Medium("mcu-velocity", rt=True),
    "ascii": Medium("ascii-velocity", rt=True),
    "hoverboard": Medium("hoverboard", rt=True),
}
CASES = {
    f"{medium}: {harm}": (medium, harm)
    for medium in MEDIA
    for harm in HARM
    # a controller drops a damaged CAN frame: it is lost
    if not (harm == "damaged" and shipped_profile(MEDIA[medium].drive).can is not None)
}
FEW = tuple(case for case in CASES if case.startswith(("feetech 2", "modbus-tcp", "odrive rt")))


@pytest.fixture(autouse=True)
def media(monkeypatch):
    """The pseudo-terminals stand for UARTs, which deliver a reply sooner than a program may."""
    monkeypatch.setattr("motord_hal.sim.rs485.gateway.REPLY_TIMEOUT_S", GATEWAY_WAITS_S)
    monkeypatch.setattr("motord_hal.rt_engine.rs485.line.is_pty", lambda _fd: False)


@contextlib.asynccontextmanager
async def armed_line(medium, folder):
    """Yield a line that is armed, with the times of the product, and its simulator."""
    profile = replace(shipped_profile(medium.drive), parity="none")
    with contextlib.ExitStack() as cleanup:
        options = {"joints": medium.joints}
        spec = spec_of(profile, folder, cycle_hz=CYCLE_HZ, **options)
        if medium.kind:
            raw = medium.kind == "rtu-over-tcp"
            control, (host, port) = cleanup.enter_context(served(folder, raw=raw))
            spec = replace(spec, kind=medium.kind, port=f"{host}:{port}", engine="asyncio")
        else:
            control = cleanup.enter_context(simulated(profile, folder, **options))
            spec = replace(spec, engine="rt" if medium.rt else "asyncio", priority=0)
        async with running(spec, in_haste=True) as rig:
            await rig.arm()
            rig.loop.enabled = True
            await until(lambda: all(stamps(rig)))
            yield rig, control


def stamps(rig):
    return [rig.loop.exchange.take_feedback(one.index).stamp_ns for one in rig.line.spec.joints]


def harmed(control):
    return sum(fault["fired"] for fault in control.stats()["faults"])


@dataclass
class Episode:
    """What happened around one harmed reply, or several."""

    hits: int
    errors: int
    ticks: int
    """Most looks in a row in which a joint had no new feedback."""
    events: list[str]

    def is_explained(self, joints):
        """Return whether the harm explains every error. Others came from a busy machine, on which
        simulated drives answer late, too."""
        return self.errors <= ERRORS_A_HIT * joints * self.hits


def errors(rig):
    return sum(rig.line.stats().errors.values())


async def episode(rig, control):
    """Look until a reply was harmed, and for TICKS_AFTER looks more."""
    before, first, seen = harmed(control), errors(rig), len(rig.events)
    newest, ticks, most, left = stamps(rig), [0] * len(rig.line.spec.joints), 0, TICKS_AFTER
    while left:
        now = stamps(rig)
        pairs = zip(ticks, newest, now, strict=True)
        ticks = [count + 1 if old == new else 0 for count, old, new in pairs]
        newest, most = now, max(most, *ticks)
        left -= harmed(control) > before
        await asyncio.sleep(TICK_S)
    events = [event.text for event in rig.events[seen:] if event.kind not in GOOD]
    return Episode(harmed(control) - before, errors(rig) - first, most, events)


async def armed_again(rig):
    if rig.states() != {DriveState.ARMED}:
        rig.loop.enabled = False
        rig.loop.put()
        await rig.arm()
        rig.loop.enabled = True


@pytest.mark.parametrize("case", long_but(FEW, CASES))
async def test_one_harmed_reply_of_fifty_is_no_fault(case, tmp_path):
    medium, harm = MEDIA[CASES[case][0]], HARM[CASES[case][1]]
    folder = tmp_path / ("rt" if medium.rt else "asyncio")
    folder.mkdir()
    async with armed_line(medium, folder) as (rig, control):
        late_ms = GATEWAY_LATE_MS if medium.kind else UART_LATE_MS
        control.inject(f"{harm.format(late_ms)}nth={NTH}")
        stale_s = max(Safety().feedback_timeout_s, longest_gap_s(rig.line.spec))
        explained = 0
        for _ in range(EPISODES_MAX):
            found = await episode(rig, control)
            print(f"{case}: {found}, stale after {stale_s:.3f} s")
            if found.is_explained(medium.joints):
                assert found.events == []
                assert rig.states() == {DriveState.ARMED}
                assert found.ticks < stale_s / TICK_S
                explained += 1
            if explained == HARMED_LEAST:
                return
            await armed_again(rig)
        raise AssertionError("each harmed reply led to more errors")
