# SPDX-License-Identifier: Apache-2.0
"""What every drive on the rt engine has, whatever its medium. The rules that use it are in
csrc/base/drive_state.c."""

from __future__ import annotations

import enum

from _motord_rt import lib


class Mode(enum.IntEnum):
    OFF = lib.DRIVE_OFF
    READY = lib.DRIVE_READY
    ARMED = lib.DRIVE_ARMED
    QUIET = lib.DRIVE_QUIET
    BACK = lib.DRIVE_BACK
    STAND_DOWN = lib.DRIVE_STAND_DOWN
    """Only as a wish."""


class Demoted(enum.IntFlag):
    SETPOINTS_OLD = lib.DEMOTED_SETPOINTS_OLD
    NOT_ENABLED = lib.DEMOTED_NOT_ENABLED
    LEFT_ALONE = lib.DEMOTED_LEFT_ALONE
    LOST_SETUP = lib.DEMOTED_LOST_SETUP
    DISABLED_ITSELF = lib.DEMOTED_DISABLED_ITSELF
    QUIET = lib.DEMOTED_QUIET
    STILL_ENABLED = lib.DEMOTED_STILL_ENABLED
