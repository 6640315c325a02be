# SPDX-License-Identifier: Apache-2.0
"""The state of a drive on any medium and engine. The rules of when a drive has to stop are in
csrc/base/drive_state.c; lines in C and in asyncio call them."""

from __future__ import annotations

import enum
import math
from typing import Any

from _motord_rt import ffi, lib

STOPPING_WITHIN_S: float = lib.DRIVE_STOPPING_NS * 1e-9
"""Longest time that the power stays on after a quick stop, to bring the wheels to rest."""


class Mode(enum.IntEnum):
    OFF = lib.DRIVE_OFF
    READY = lib.DRIVE_READY
    ARMED = lib.DRIVE_ARMED
    UNRESPONSIVE = lib.DRIVE_UNRESPONSIVE
    BACK = lib.DRIVE_BACK
    STAND_DOWN = lib.DRIVE_STAND_DOWN
    """Only a request, never the state of a drive."""


class FaultReason(enum.IntFlag):
    SETPOINTS_OLD = lib.DRIVE_FAULT_SETPOINTS_OLD
    NOT_ENABLED = lib.DRIVE_FAULT_NOT_ENABLED
    LEFT_ALONE = lib.DRIVE_FAULT_LEFT_ALONE
    LOST_SETUP = lib.DRIVE_FAULT_LOST_SETUP
    DISABLED_ITSELF = lib.DRIVE_FAULT_DISABLED_ITSELF
    UNRESPONSIVE = lib.DRIVE_FAULT_UNRESPONSIVE
    STILL_ENABLED = lib.DRIVE_FAULT_STILL_ENABLED
    POSITION_UNKNOWN = lib.DRIVE_FAULT_POSITION_UNKNOWN


class Stop(enum.IntEnum):
    """The stop that a rule demands for a drive, which the line then has to send."""

    NOTHING = lib.STOP_NOTHING
    QUICK = lib.STOP_QUICK
    POWER_OFF = lib.STOP_POWER_OFF


def left_alone(last_s: float, now_s: float, watchdog_s: float) -> bool:
    """Whether the drive's watchdog has stopped it since `last_s`, the time of its last request.
    `watchdog_s` infinite: the drive has no watchdog."""
    watchdog_ns = round(watchdog_s * 1e9) if math.isfinite(watchdog_s) else 0
    return bool(lib.drive_left_alone(round(last_s * 1e9), round(now_s * 1e9), watchdog_ns))


class EarlyShare:
    """Limits how often a line sends new set-points before their cycle: in the long run not more
    often than there are cycles."""

    def __init__(self) -> None:
        self._early_ns: Any = ffi.new("int64_t *")

    def take(self, period_s: float, now_ns: int) -> bool:
        """Return whether the line may send early now; if so, count it."""
        return bool(lib.may_be_early(self._early_ns, round(period_s * 1e9), now_ns))


class LastPowerOff:
    """The power-off at the end of a line, on a medium that confirms nothing. Times are
    CLOCK_MONOTONIC."""

    def __init__(self) -> None:
        self._off: Any = ffi.new("drive_last_off *")

    @property
    def is_sent(self) -> bool:
        return bool(self._off.first_ns)

    def sent(self, now_ns: int, *, suffices: bool) -> None:
        """Note that a power-off went out. `suffices`: the first one needs no confirmation."""
        if not self._off.first_ns:
            self._off.first_ns, self._off.suffices = now_ns, suffices
        self._off.newest_ns = now_ns

    def is_confirmed(
        self, *, reports_enabled: bool, enabled: bool | None, received_ns: int
    ) -> bool:
        """Whether the drive is off: by its report of `enabled`, or, if it makes no such report, by
        the time of its newest frame, which has to be between two power-offs."""
        number = 2 if enabled is None else int(enabled)
        return bool(lib.drive_is_off(self._off, reports_enabled, number, received_ns))


class DriveRules:
    """The state of one drive of a line in asyncio, by the rules in C. If a method returns a Stop,
    the caller has to send it."""

    def __init__(self) -> None:
        self._state: Any = ffi.new("drive_state *")
        self._view: Any = ffi.new("drive_view *")
        self._request: Any = ffi.new("mode_request *")

    @property
    def mode(self) -> Mode:
        return Mode(self._state.mode)

    @property
    def epoch(self) -> int:
        """How often the drive was set up."""
        return int(self._state.epoch)

    @property
    def fault_reasons(self) -> FaultReason:
        return FaultReason(self._state.fault_reasons)

    @property
    def is_stopping(self) -> bool:
        """Whether a quick stop has begun, and no power-off has followed yet."""
        return bool(self._state.stopping)

    @property
    def sent_motion(self) -> bool:
        """Whether the drive was sent set-points that are not zero, and not zero since, as far as
        the line knows."""
        return bool(self._state.sent_motion)

    @sent_motion.setter
    def sent_motion(self, value: bool) -> None:
        self._state.sent_motion = value

    def request(self, mode: Mode, *, fresh: bool = False, enabled_count: int = 0) -> Stop:
        """Carry out a mode request, as drive_obey in C: a request that is not possible changes
        nothing. ARMED needs `fresh` (whether the set-points are fresh) and `enabled_count` (their
        count when the arming began)."""
        self._request.count += 1
        self._request.mode = mode
        self._view.fresh, self._view.enabled_count = fresh, enabled_count
        return Stop(lib.drive_obey(self._state, self._request, self._view).stop)

    def forget(self) -> None:
        """Make the drive OFF, in any mode: its medium is lost, and nothing is known of it."""
        lib.drive_take_back(self._state, 0, Mode.OFF)
        lib.drive_power_off(self._state)
        self._state.back = self._state.off_due = False

    def may_move(self, *, fresh: bool, enabled: bool) -> bool:
        """Whether the drive may get set-points that are not zero."""
        return bool(lib.drive_may_move(self._state, fresh, enabled))

    def has_to_rest(self, *, wants_motion: bool) -> bool:
        """Whether zero has to go to the drive at once, before its cycle."""
        return bool(lib.drive_has_to_rest(self._state, wants_motion))

    def unresponsive(self) -> None:
        lib.drive_unresponsive(self._state)

    def answers(self, *, braking: bool) -> Stop:
        """Note that an unresponsive drive answers again. `braking`: its probes still brake it."""
        return Stop(lib.drive_answers(self._state, braking))

    def lost_setup(self) -> Stop:
        return Stop(lib.drive_lost_setup(self._state))

    def guard(
        self, now_ns: int, *, fresh: bool, left_alone: bool, enabled: bool, enabled_count: int
    ) -> Stop:
        """Return the stop that the set-points demand, or (`left_alone`) the drive's watchdog."""
        view = self._view
        view.now_ns, view.fresh, view.left_alone = now_ns, fresh, left_alone
        view.enabled, view.enabled_count = enabled, enabled_count
        return Stop(lib.drive_guard(self._state, view))

    def quick_stop(self, now_ns: int) -> None:
        lib.drive_quick_stop(self._state, 0, now_ns)

    def power_off(self) -> None:
        lib.drive_power_off(self._state)

    def end_stopping(self, now_ns: int, *, at_rest: bool) -> Stop:
        """Return the power-off that ends a quick stop: at rest, or when it takes too long."""
        return Stop(lib.drive_end_stopping(self._state, at_rest, now_ns))

    def check_power(self, enabled: bool | None, tries: int, *, settled: bool) -> Stop:
        """Return the stop that the drive's report of `enabled` demands. `settled`: the drive is not
        being armed now."""
        self._state.enabled = 2 if enabled is None else enabled
        return Stop(lib.drive_check_power(self._state, tries, settled))
