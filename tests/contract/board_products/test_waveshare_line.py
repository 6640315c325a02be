# SPDX-License-Identifier: Apache-2.0
"""The text dialect against a driver board that speaks JSON lines, written from its firmware's
sources; the templates are those of the shipped robot file."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from hoverboard_peer import Board, compiled
from loop_side import running, until

from motord.config import load_robot
from motord.config.wiring import line_specs
from motord_hal.fieldbus.ports import DriveState, EventKind

ROOT = Path(__file__).resolve().parents[3]
RADIUS_M = 0.04
COUNTS_PER_TURN = 1000


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    source = Path(__file__).with_name("waveshare_peer.c")
    return compiled(tmp_path_factory.mktemp("waveshare"), source)


@pytest.fixture
def board(program, tmp_path):
    board = Board(tmp_path / "board", program)
    yield board
    board.end()


def spec_of(board):
    robot = load_robot(ROOT / "config/robots/waveshare-ugv.toml")
    (spec,) = line_specs(robot, robot.profiles)
    return replace(spec, port=str(board.link), priority=0)


def with_odometers(spec):
    """Return the line with feedback by the odometers, in whole centimetres, and no speeds."""
    text = spec.text
    wheels = {name: replace(w, counts_per_turn=COUNTS_PER_TURN) for name, w in text.wheels.items()}
    feedback = '{{"T":1001,"v":{voltage_v:d},"odr":{right_m:d},"odl":{left_m:d}}}\n'
    scale = {"voltage_v": 100.0, "left_m": 100.0, "right_m": 100.0}
    text = replace(text, wheels=wheels, feedback=feedback, feedback_scale=scale)
    return replace(spec, text=text)


async def turning(rig, board, left_m_s=0.2, right_m_s=0.1):
    await rig.arm()
    rig.loop.enabled = True
    rig.loop.velocity_rad_s = {0: left_m_s / RADIUS_M, 1: right_m_s / RADIUS_M}
    expected = (round(1000 * left_m_s), round(1000 * right_m_s), 0)
    await until(lambda: board.now == expected, "it turns as set")


async def test_the_prefix_switches_feedback_on_and_speeds_are_those_of_the_rims(board):
    async with running(spec_of(board)) as rig:
        await turning(rig, board)
        take = rig.loop.exchange.take_feedback

        def settled():
            found = (take(0).velocity_rad_s * RADIUS_M, take(1).velocity_rad_s * RADIUS_M)
            return found == (pytest.approx(0.2, abs=1e-3), pytest.approx(0.1, abs=1e-3))

        await until(settled, "the measured speeds are the set ones")
        assert take(0).voltage_v == pytest.approx(11.87)
        await rig.line.disarm()
        await until(lambda: board.now[:2] == (0, 0), "zero")


async def test_odometers_in_centimetres_become_counts_in_the_motor_s_own_direction(board):
    per_m = COUNTS_PER_TURN / (2 * math.pi * RADIUS_M)
    async with running(with_odometers(spec_of(board))) as rig:
        await turning(rig, board, left_m_s=0.4, right_m_s=-0.2)
        take = rig.loop.exchange.take_feedback

        def travelled_m(joint):  # 32 bits; the right motor is inverted
            raw = take(joint).count
            signed = raw - (1 << 32) if raw >> 31 else raw
            return signed / per_m * (-1 if joint == 1 else 1)

        await until(lambda: travelled_m(0) > 0.3, "the left one goes forward")
        await until(lambda: travelled_m(1) < -0.15, "the right one backward")
        assert math.isnan(take(0).velocity_rad_s)


async def test_a_board_that_falls_silent_is_stopped_and_comes_back_disarmed(board):
    async with running(spec_of(board)) as rig:
        await turning(rig, board)
        board.do("m")
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "it is unresponsive")
        await until(lambda: board.now[:2] == (0, 0), "it is still sent zero")
        board.do("w")
        await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "it is back")
        assert rig.states() == {DriveState.READY}
        assert board.now[:2] == (0, 0)


async def test_the_heartbeat_of_the_prefix_stops_the_board_when_the_line_has_ended(board):
    async with running(spec_of(board)) as rig:
        await turning(rig, board)
    await until(lambda: board.now == (0, 0, 1), "its heartbeat has run out")
