# SPDX-License-Identifier: Apache-2.0
"""The contract suite: every drive profile, its simulator, and the line between them.

Real time, a real pty, the shipped line; the simulator's truth shows how the wheels really moved.
"""

import contextlib
import math
from dataclasses import replace

import pytest
from loop_side import running, until
from sim_bench import (
    GEAR,
    RT,
    can_reverse,
    reports,
    simulated,
    spec_of,
    with_rt,
    without_power,
)
from tests.long_cases import long_but
from tests.shipped import NAMES, shipped_profile

from motord_hal.fieldbus.ports import DriveState, EventKind

SPEED_RAD_S = 6.0
"""Speed of the wheels, if the drive can reach it."""
DUTY = 0.5
# for slow drives, too: waiting half a minute would prove nothing more
BAUDRATE = 115200
TURNAROUND_S = 0.002


def profiles_that(have_it):
    """Return the drives for which `have_it` is true, of those that take a speed, duty or torque on
    a line. Bridges: test_simulated_pins.py; servos with positions: test_servo_positions.py."""
    found = {name: shipped_profile(name) for name in NAMES}
    turning = {
        name: one
        for name, one in found.items()
        if one.protocol != "pwm" and not one.goes_to_positions
    }
    return with_rt([name for name, one in turning.items() if have_it(one)])


def one_of_each_protocol(names):
    """Return a drive for each protocol and engine: faults of a wire do not depend on the drive."""
    found = {}
    for name in names:
        protocol = shipped_profile(name.removesuffix(RT)).protocol
        found.setdefault((protocol, name.endswith(RT)), name)
    return list(found.values())


def each_that(have_it):
    """Return the drives for which it is true; `make test` runs only one of each protocol."""
    names = profiles_that(have_it)
    return long_but(one_of_each_protocol(names), names)


SERIAL = profiles_that(lambda profile: profile.can is None)


@pytest.fixture(params=each_that(lambda _: True))
def variant(request):
    return request.param


@pytest.fixture
def profile(variant):
    found = shipped_profile(variant.removesuffix(RT))
    # a pty has no parity
    return replace(found, baudrate=BAUDRATE, turnaround_s=TURNAROUND_S, parity="none")


def speed_of(rig):
    """Return the speed that the wheels are sent; a slow drive gets less than it can reach."""
    profile = rig.line.spec.joints[0].profile
    setpoint = profile.channels[1].velocity_setpoint
    if setpoint is None:
        return SPEED_RAD_S
    return min(SPEED_RAD_S, 0.75 * profile.registers[setpoint].si_limits[1] / GEAR)


def wheels_rad_s(sim):
    return [joint.velocity_rad_s for joint in sim.truth().joints.values()]


async def rest(sim):
    await until(lambda: sim.truth().at_rest, "the wheels are at rest")


async def set_off(rig, sim, sign=1.0):
    """Arm, and bring both wheels to speed (a duty drive: the one of its speed-torque line)."""
    await rig.arm()
    await turn(rig, sim, sign)


async def turn(rig, sim, sign=1.0):
    speed_rad_s = speed_of(rig)
    rig.loop.velocity_rad_s = {0: sign * speed_rad_s, 1: sign * speed_rad_s}
    rig.loop.duty = {0: sign * DUTY, 1: sign * DUTY}
    low_rad_s, high_rad_s = 0.97 * speed_rad_s, 1.25 * speed_rad_s

    def fast():
        return all(low_rad_s < sign * speed < high_rad_s for speed in wheels_rad_s(sim))

    await rig.drive(fast, "both wheels turn as commanded")


def feedback(rig, joint):
    return rig.loop.exchange.take_feedback(joint.index)


# --------------------------------------------------------------------------------------- the suite
async def test_a_configured_drive_is_ready_at_rest_and_not_armed(rig, sim, profile):
    await rig.ready()
    truth = sim.truth()
    assert truth.at_rest
    assert truth.moved_max_m_s == 0.0
    says = None if profile.enabled is None else False
    for joint in rig.line.spec.joints:
        await until(lambda joint=joint: feedback(rig, joint).stamp_ns > 0, "feedback has come")
        await until(lambda joint=joint: feedback(rig, joint).enabled is says, "it reports it")


async def test_set_points_move_nothing_before_the_line_has_armed(rig, sim):
    await rig.ready()
    rig.loop.enabled = True
    rig.loop.velocity_rad_s = {0: speed_of(rig), 1: speed_of(rig)}
    rig.loop.duty = {0: DUTY, 1: DUTY}
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 10, "ten cycles have passed")
    assert sim.truth().moved_max_m_s == 0.0


async def test_armed_wheels_follow_their_set_points_and_feedback_agrees_with_the_plant(
    rig, sim, profile
):
    await set_off(rig, sim)
    for joint in rig.line.spec.joints:
        values = feedback(rig, joint)
        assert values.drive_faults == 0
        assert values.enabled in (None, True)
        measured = profile.channels[joint.channel].velocity is not None
        assert math.isfinite(values.velocity_rad_s) == measured
        if measured:

            def agrees(joint=joint):
                true_rad_s = sim.truth().joints[joint.name].velocity_rad_s
                measured_rad_s = feedback(rig, joint).velocity_rad_s
                return true_rad_s > 0.9 * speed_of(rig) and measured_rad_s == pytest.approx(
                    true_rad_s, rel=0.05
                )

            await until(agrees, f"{joint.name} reports its speed")


@pytest.mark.parametrize("variant", each_that(can_reverse), indirect=True)
async def test_a_drive_that_can_reverse_reverses(rig, sim, profile):
    await set_off(rig, sim, sign=-1.0)
    for joint in rig.line.spec.joints:
        if profile.channels[joint.channel].velocity is None:
            continue
        await until(lambda joint=joint: feedback(rig, joint).velocity_rad_s < 0, "it reports it")
    await turn(rig, sim, sign=1.0)
    assert sim.truth().joints["left"].velocity_rad_s > 0


@pytest.mark.parametrize("variant", each_that(lambda p: p.counter_bits), indirect=True)
async def test_counters_count_what_the_wheels_turned(rig, sim, profile):
    await rig.ready()
    joints = rig.line.spec.joints
    await until(lambda: all(feedback(rig, joint).stamp_ns for joint in joints), "first counts")
    before = {joint.name: feedback(rig, joint).count for joint in joints}
    await set_off(rig, sim)
    rig.loop.velocity_rad_s, rig.loop.duty = {}, {}
    await rest(sim)
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 3, "the counts at rest are in")
    half = 1 << (profile.counter_bits - 1)

    def missed(joint):
        """Return by how many counts the feedback differs from the truth."""
        counts = (feedback(rig, joint).count - before[joint.name] + half) % (2 * half) - half
        per_turn = profile.counts_per_turn * GEAR * (-1 if joint.inverted else 1)
        turned_rad = sim.truth().joints[joint.name].position_rad
        return abs(counts - turned_rad / (2 * math.pi) * per_turn)

    for joint in joints:
        assert sim.truth().joints[joint.name].position_rad > 0.03
        await until(lambda joint=joint: missed(joint) <= 2.0, "the counts of the truth")


def signed_current(profile):
    """Return whether a current with a sign arrives here: the text of these tests has none.
    tests/unit/fieldbus/test_inverted_joint.py has all drives."""
    name = profile.channels[1].current
    seen = profile.protocol != "ascii"
    return seen and name is not None and profile.registers[name].type.signed


@pytest.mark.parametrize("variant", each_that(signed_current), indirect=True)
async def test_the_current_of_a_joint_is_positive_while_it_is_pushed_forward(rig, sim, profile):
    """Also that of the right motor, which is mounted in reverse."""
    await set_off(rig, sim)
    for unit in {joint.unit for joint in rig.line.spec.joints}:
        sim.inject(f"blocked:unit={unit}")
    for joint in rig.line.spec.joints:
        await until(
            lambda joint=joint: abs(feedback(rig, joint).current_a) > 0.05, "it draws a current"
        )
        assert sim.truth().joints[joint.name].current_a > 0.0
        assert feedback(rig, joint).current_a > 0.0, joint.name


async def test_a_disarmed_drive_comes_to_rest_and_follows_no_set_point(rig, sim, profile):
    await set_off(rig, sim)
    await rig.line.disarm()
    assert rig.states() == {DriveState.READY}
    await rest(sim)
    if profile.arm:
        assert not any(joint.enabled for joint in sim.truth().joints.values())
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 5, "five cycles have passed")
    assert sim.truth().at_rest


async def test_dead_set_points_stop_the_wheels(rig, sim):
    await set_off(rig, sim)
    rig.loop.running = False
    await rest(sim)
    await rig.ready()


@pytest.mark.parametrize("variant", each_that(lambda p: p.faults), indirect=True)
async def test_a_fault_is_reported_stops_its_wheel_and_is_cleared_disarmed(rig, sim, profile):
    await set_off(rig, sim)
    fault = next(fault for fault in profile.faults if fault.severity == "fault")
    which = f"bit={fault.bit}" if fault.code is None else f"code={fault.code}"
    sim.inject(f"fault:unit=1,channel=1,{which}")
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds(), "the fault is reported")
    left = rig.line.spec.joints[0]
    await until(lambda: feedback(rig, left).drive_faults != 0, "the loop has it")
    reported = [event.text for event in rig.events if event.kind is EventKind.DRIVE_FAULT]
    assert fault.text in reported[0]
    if profile.name != "moteus":  # it forgets its fault at any stop
        assert rig.line.drive_faults["left"] == (fault.text,)
    assert not sim.truth().joints["left"].enabled
    rig.loop.enabled, rig.loop.velocity_rad_s, rig.loop.duty = False, {}, {}
    await rest(sim)
    await rig.ready()
    await rig.line.clear_faults()
    await until(lambda: feedback(rig, left).drive_faults == 0, "the fault is gone")
    await until(lambda: rig.line.drive_faults["left"] == (), "the fault is no longer reported")
    assert sim.truth().at_rest
    await set_off(rig, sim)


def watchdog_bites(sim):
    """Return how often the watchdog of each drive has tripped."""
    return [unit["watchdog_bites"] for unit in sim.stats()["lines"]["bus"]["units"].values()]


@pytest.mark.parametrize("variant", each_that(lambda profile: profile.can is None), indirect=True)
async def test_a_pulled_plug_trips_the_watchdog_and_the_line_comes_back_disarmed(rig, sim):
    await set_off(rig, sim)
    left = rig.line.spec.joints[0]
    epoch = feedback(rig, left).epoch
    before = watchdog_bites(sim)
    sim.pull("bus")
    await until(lambda: EventKind.LINE_LOST in rig.kinds(), "the loss is reported")
    await rest(sim)
    assert watchdog_bites(sim) == [bites + 1 for bites in before]
    sim.plug("bus")
    await until(lambda: rig.kinds().count(EventKind.LINE_OPEN) == 2, "the line is open again")
    await rig.ready()
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 5, "five cycles have passed")
    assert sim.truth().at_rest
    assert rig.line.stats().reopened == 1
    assert feedback(rig, left).epoch != epoch  # the drive may have lost its power meanwhile


@pytest.mark.parametrize("variant", each_that(reports), indirect=True)
async def test_a_drive_that_reboots_comes_back_disarmed_with_a_new_epoch(rig, sim):
    await set_off(rig, sim)
    left = rig.line.spec.joints[0]
    epoch = feedback(rig, left).epoch
    with without_power(sim, 1):
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds(), "unresponsive")
    await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "back")
    await until(lambda: feedback(rig, left).epoch > epoch, "the counter's origin is a new one")
    assert rig.line.drive_states["left"] is DriveState.READY
    await until(lambda: sim.truth().joints["left"].velocity_rad_s == 0.0, "its wheel is at rest")
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 5, "five cycles have passed")
    assert sim.truth().joints["left"].velocity_rad_s == 0.0


@pytest.mark.parametrize("variant", one_of_each_protocol(SERIAL), indirect=True)
async def test_every_silent_interval_is_kept(rig, sim):
    await set_off(rig, sim)
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 10, "ten cycles have passed")
    sent = sim.stats()["lines"]["bus"]
    assert sent["gap_violations"] == 0
    # a simulator that a busy machine delays beyond the reply time-out finds two requests
    assert sent["bad_crc"] <= rig.line.stats().errors.get("no_reply", 0)


def has_check_sums(profile):
    return profile.protocol not in ("ascii", "can") and reports(profile)


CHECKED = one_of_each_protocol(profiles_that(has_check_sums))


@pytest.mark.parametrize("variant", CHECKED, indirect=True)
async def test_a_bad_wire_never_falsifies_feedback(profile, folder):
    noise = ("drop:p=0.02", "corrupt:p=0.03", "glitch:p=0.1", "tear:nth=29", "wrong-unit:nth=41")
    async with contextlib.AsyncExitStack() as stack:
        sim = stack.enter_context(simulated(profile, folder, seed=11))
        rig = await stack.enter_async_context(running(patient(spec_of(profile, folder))))
        await set_off(rig, sim)
        joints = rig.line.spec.joints

        def right(speed_rad_s):
            return math.isnan(speed_rad_s) or 0.9 < speed_rad_s / speed_of(rig) < 1.3

        def settled():
            return all(right(feedback(rig, joint).velocity_rad_s) for joint in joints)

        await until(settled, "feedback has followed the wheels")
        for spec in (*noise, "late:nth=37"):
            sim.inject(spec)
        start = rig.line.stats().exchanges
        seen = set()

        def steady():
            seen.update(feedback(rig, joint).velocity_rad_s for joint in joints)
            return rig.line.stats().exchanges > start + 100

        await until(steady, "a hundred exchanges have passed")
        assert rig.states() == {DriveState.ARMED}
        assert sum(rig.line.stats().errors.values()) > 0
        assert not [speed for speed in seen if not right(speed)]


def patient(spec):
    """Return the line with drives that tolerate several bad replies in a row."""
    return replace(spec, joints=tuple(replace(joint, tries=10) for joint in spec.joints))
