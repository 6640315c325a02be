# SPDX-License-Identifier: Apache-2.0
"""Hoverboards with the FOC firmware: motord's line against a board that was written from the
firmware's sources, and a program written from them against the simulated board."""

import math

import pytest
from hoverboard_peer import Board, Program, compiled, spec_of
from loop_side import running, until
from sim_bench import simulated

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import DriveState, EventKind

RPM = 2 * math.pi / 60
SPEED_RPM = 60
STILL = {0: 0.0, 1: 0.0}


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("hoverboard"))


@pytest.fixture
def board(program, tmp_path):
    board = Board(tmp_path / "board", program, "board")
    yield board
    board.end()


async def turning(rig, board, left_rpm=SPEED_RPM, right_rpm=SPEED_RPM):
    await rig.arm()
    rig.loop.enabled = True
    rig.loop.velocity_rad_s = {0: left_rpm * RPM, 1: right_rpm * RPM}
    await until(lambda: board.now == (left_rpm, right_rpm, 0), "it turns as set")


async def test_set_points_reach_the_firmware_only_when_armed(board):
    async with running(spec_of(board.link)) as rig:
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 6.0, 1: 6.0}
        await rig.ready()
        exchanges = rig.line.stats().exchanges
        await until(lambda: rig.line.stats().exchanges > exchanges + 10, "feedback comes")
        assert {line[:2] for line in board.lines} == {(0, 0)}
        await turning(rig, board)
        await rig.line.disarm()
        await until(lambda: board.now == (0, 0, 0), "zero")


async def test_left_and_right_are_those_of_the_robot_and_both_speeds_are_positive_forward(board):
    async with running(spec_of(board.link)) as rig:
        await turning(rig, board, left_rpm=80, right_rpm=-40)
        take = rig.loop.exchange.take_feedback

        def settled():
            found = (take(0).velocity_rad_s / RPM, take(1).velocity_rad_s / RPM)
            return found == (pytest.approx(80, abs=1.01), pytest.approx(-40, abs=1.01))

        await until(settled, "the measured speeds are the set ones")
        assert take(0).voltage_v == pytest.approx(39.12)
        assert take(0).temperature_c == pytest.approx(28.7)
        assert take(0).enabled is None


async def test_steer_and_speed_come_to_the_same_wheels(program, tmp_path):
    board = Board(tmp_path / "board", program, "board", options=("mixed",))
    async with running(spec_of(board.link, "hoverboard-steer")) as rig:
        await turning(rig, board)
        for left, right in ((80, -40), (-100, -100), (41, 40), (500, -500)):
            rig.loop.velocity_rad_s = {0: left * RPM, 1: right * RPM}

            def near(left=left, right=right):
                return abs(board.now[0] - left) <= 1 and abs(board.now[1] - right) <= 1

            await until(near, f"{left} {right}")
        rig.loop.velocity_rad_s = STILL
        await until(lambda: board.now == (0, 0, 0), "zero is zero")
    board.end()


async def test_old_set_points_stop_the_wheels(board):
    async with running(spec_of(board.link)) as rig:
        await turning(rig, board)
        rig.loop.running = False
        await until(lambda: board.now == (0, 0, 0), "zero")
        await until(lambda: rig.states() == {DriveState.READY}, "disarmed")


@pytest.mark.parametrize("letter", ["m", "x"], ids=["silence", "wrong check sums"])
async def test_a_board_without_good_feedback_is_stopped_and_comes_back_disarmed(board, letter):
    async with running(spec_of(board.link)) as rig:
        await turning(rig, board)
        board.do(letter)
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "it is unresponsive")
        await until(lambda: board.now == (0, 0, 0), "it is still sent zero")
        board.do("w")
        await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "it is back")
        assert rig.states() == {DriveState.READY}
        exchanges = rig.line.stats().exchanges
        await until(lambda: rig.line.stats().exchanges > exchanges + 10)
        assert board.now == (0, 0, 0)


async def test_the_firmware_times_out_when_the_line_has_ended(board):
    async with running(spec_of(board.link)) as rig:
        await turning(rig, board)
    await until(lambda: board.now == (0, 0, 1), "its time-out takes the power")
    assert (0, 0, 0) in board.lines[board.lines.index((SPEED_RPM, SPEED_RPM, 0)) :]


async def test_a_board_that_a_dead_program_left_is_sent_zero_until_it_rests(board, program):
    host = Program(program, "host", board.link, SPEED_RPM, SPEED_RPM)
    await until(lambda: board.now[:2] == (SPEED_RPM, SPEED_RPM), "the program drives")
    host.kill()
    assert await halt_line(spec_of(board.link)) == []
    assert board.now[:2] == (0, 0)


# ---------------------------------------------------------------------------- the simulated board
@pytest.mark.parametrize(
    ("drive", "first", "second"),
    [("hoverboard", 120, 60), ("hoverboard-steer", 60, 90)],
    ids=["left and right", "steer and speed"],
)
async def test_a_foreign_program_drives_the_simulated_board(
    program, tmp_path, drive, first, second
):
    """The wheels have a gear of 2, and the right motor is mounted in reverse."""
    left_rpm, right_rpm = 120, 60
    with simulated(find_profile(drive), tmp_path) as sim:
        host = Program(program, "host", tmp_path / "bus", first, second)

        def truth_rpm():
            joints = sim.truth().joints
            return [2 * joints[name].velocity_rad_s / RPM for name in ("left", "right")]

        def turns():
            return truth_rpm() == pytest.approx([left_rpm, right_rpm], rel=0.02)

        def reported():
            return host.lines[-1:] and host.lines[-1][:2] == (
                pytest.approx(-right_rpm, abs=2),
                pytest.approx(left_rpm, abs=2),
            )

        await until(turns, "the wheels turn as commanded")
        await until(reported, "and it reports so, the right one in its motor's own direction")
        assert 3000 < host.lines[-1][2] < 4500
        before = sum(unit["watchdog_bites"] for unit in units(sim))
        host.kill()  # it sends nothing any more, not even zeros
        await until(lambda: sim.truth().at_rest, "the firmware's own time-out stops the wheels")
        assert sum(unit["watchdog_bites"] for unit in units(sim)) == before + 1


def units(sim):
    return sim.stats()["lines"]["bus"]["units"].values()
