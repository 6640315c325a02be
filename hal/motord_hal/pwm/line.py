# SPDX-License-Identifier: Apache-2.0
"""Motor bridges on pins of this machine. A thread in C writes the pins by the set-points. This
module opens the pins, passes requests on and reports changes."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator

from motord_hal.base.clock import now_s, within
from motord_hal.base.errors import DriveFault, HalError, NoReply, PortError
from motord_hal.base.tasks import TaskGroup
from motord_hal.drives.profile import DriveProfile
from motord_hal.encoder.board import CountingBoard
from motord_hal.fieldbus.line import (
    NO_SETPOINTS,
    SETPOINT_LOOK_EVERY_S,
    SETPOINT_LOOKS,
    LineTask,
)
from motord_hal.fieldbus.ports import (
    BoardEncoder,
    DriveState,
    EventKind,
    LineSpec,
    LineState,
    LineStats,
    Listener,
)
from motord_hal.pwm.pins import OpenPins, bridge_of, open_pins, places_of, servo_range_rad
from motord_hal.realtime.drive_state import FaultReason
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.pwm import (
    BridgeConfig,
    BridgeJoint,
    BridgeMode,
    BridgeReport,
    BridgeThread,
)

STOPPING_S = 0.3
"""Time for which a quick stop brakes before the power goes off."""
OBEYED_WITHIN_S = 1.0
LOOK_EVERY_S = 0.005
WATCH_EVERY_S = 0.05
AT_ENCODER = -2
"""`BridgeReport.error_output` from here down: AT_ENCODER - place means the encoder of a joint."""
FAULT_WORDS = ("the bridge reports a fault",)


class PwmLine(LineTask):
    """`ports.Line` for `kind = "pwm"`, engine "rt". Nothing shows whether a bridge is connected: a
    drive counts as present while its pins are open."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        super().__init__(spec, listener)
        for number, joint in enumerate(spec.joints):
            try:
                places_of(number, joint)
            except ValueError as error:
                raise HalError(f"{spec.name}: joint {joint.name}: {error}") from error
        self._exchange = exchange
        self._names = tuple(joint.name for joint in spec.joints)
        self._thread = BridgeThread(spec.index, exchange)
        self._pins: OpenPins | None = None
        self._was_armed = False
        """Whether `arm` has armed the line and its end has not been reported yet."""
        self._faults: dict[str, tuple[str, ...]] = dict.fromkeys(self._names, ())
        self._stats = LineStats()
        self._epoch = 0
        self._started_s = 0.0
        self._boards = list(self._counting_boards())

    # ------------------------------------------------------------------------------------ what is
    @property
    def engine(self) -> str:
        return "rt"

    @property
    def state(self) -> LineState:
        return LineState.CLOSED if self._pins is None else LineState.READY

    @property
    def drive_states(self) -> dict[str, DriveState]:
        state = DriveState.UNKNOWN
        if self._pins is not None:
            state = DriveState.ARMED if self._thread.report().armed else DriveState.READY
        return dict.fromkeys(self._names, state)

    @property
    def drive_faults(self) -> dict[str, tuple[str, ...]]:
        return dict(self._faults)

    def stats(self) -> LineStats:
        """Implement `ports.Line.stats`. An exchange is a write to pins; a late one has no limit."""
        if self._pins is not None:
            report = self._thread.report()
            self._stats.exchanges, self._stats.cycles = report.writes, report.cycles
            errors = {
                "late": report.late_cycles,
                "encoder_illegal": report.encoder_illegal,
                "encoder_lost": report.encoder_lost,
            }
            self._stats.errors = {kind: count for kind, count in errors.items() if count}
            span_s = now_s() - self._started_s
            self._stats.cycle_hz = report.cycles / span_s if span_s > 0 else 0.0
        self._stats.reopened = self._reopened
        self._stats.requested_hz = self._stats.wire_limit_hz = self.spec.cycle_hz
        return self._stats

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """Implement `ports.Line.run`."""
        async with TaskGroup() as tasks:
            for board in self._boards:
                tasks.create_task(board.run())
            await super().run()

    def _counting_boards(self) -> Iterator[CountingBoard]:
        """Yield one board for each port with encoder boards of this line."""
        by_port: dict[str, dict[int, int]] = {}
        encoders: dict[str, BoardEncoder] = {}
        for place, joint in enumerate(self.spec.joints):
            if isinstance(joint.encoder, BoardEncoder):
                encoders[joint.encoder.port] = joint.encoder
                by_port.setdefault(joint.encoder.port, {})[joint.encoder.motor] = place
        for port, wheels in by_port.items():
            names = tuple(self._names[place] for place in wheels.values())

            def say(kind: EventKind, text: str, names: tuple[str, ...] = names) -> None:
                self._say(kind, names, f"{self.spec.name}: {', '.join(names)}: {text}")

            yield CountingBoard(encoders[port], wheels, self._thread.report_count, say)

    async def _open_medium(self) -> str:
        pins = await open_pins(self.spec)
        self._start(pins)
        return f"{self.spec.name} has its {len(pins.pins)} pins"

    def _start(self, pins: OpenPins) -> None:
        self._epoch += 1
        try:
            self._thread.start(self._config(pins))
        except HalError:
            self._say_not_resting(pins.close())
            raise
        self._pins, self._started_s = pins, now_s()
        self._was_armed = False

    def _config(self, pins: OpenPins) -> BridgeConfig:
        joints = [
            BridgeJoint(
                index=joint.index,
                brakes_at_rest=bridge_of(joint).rest == "brake",
                inverted=joint.inverted,
                fault_mask=pins.fault_masks[place],
                encoder=pins.encoders[place],
                full_rad=servo_range_rad(joint),
            )
            for place, joint in enumerate(self.spec.joints)
        ]
        return BridgeConfig(
            outputs_fd=pins.outputs_fd,
            inputs_fd=pins.inputs_fd,
            low_inputs=pins.low_inputs,
            event_fd=-1,
            priority=self.spec.priority,
            cpu=self.spec.cpu,
            period_s=1.0 / self.spec.cycle_hz,
            setpoint_timeout_s=self.spec.setpoint_timeout_s,
            stopping_s=STOPPING_S,
            epoch=self._epoch,
            joints=joints,
            pins=pins.pins,
        )

    async def _work(self) -> None:
        """Report changes until the pins are lost. Raises PortError then."""
        self._backoff.reset()
        self._say_all(EventKind.DRIVE_READY, f"{', '.join(self._names)}: no power")
        if self._pins is not None and self._pins.doubt:
            self._say_all(EventKind.DRIVE_WARNING, f"{self.spec.name}: {self._pins.doubt}")
        while (report := self._thread.report()).running:
            self._note(report)
            await asyncio.sleep(WATCH_EVERY_S)
        raise PortError(self._what_failed(report))

    def _what_failed(self, report: BridgeReport) -> str:
        return f"{self.spec.name}: {self._at(report.error_output)}: {os.strerror(report.error)}"

    def _at(self, output: int) -> str:
        names = self._pins.names if self._pins else []
        if output <= AT_ENCODER:
            return f"the encoder of {self._names[AT_ENCODER - output]}"
        return names[output] if 0 <= output < len(names) else "the GPIO lines"

    def _note(self, report: BridgeReport) -> None:
        if report.fault_reasons and not report.armed and self._was_armed:
            self._was_armed = False
            why = ", ".join(
                str(flag.name).lower().replace("_", " ") for flag in report.fault_reasons
            )
            text = f"{', '.join(self._names)}: stopped: set-points {why}"
            self._say_all(EventKind.DRIVE_WARNING, text)
        masks = self._pins.fault_masks if self._pins else []
        for joint, mask in zip(self._names, masks, strict=False):
            words = FAULT_WORDS if report.active_inputs & mask else ()
            if words != self._faults[joint]:
                self._faults[joint] = words
                kind = EventKind.DRIVE_FAULT if words else EventKind.DRIVE_FAULT_GONE
                self._say(kind, (joint,), f"{joint}: {words[0] if words else 'no fault any more'}")

    def _close_medium(self) -> None:
        if self._pins is not None:
            self._thread.stop()
            report = self._thread.report()
            problems = self._pins.close()
            if report.rest_error:
                what = f"{self._at(report.rest_output)}: {os.strerror(report.rest_error)}"
                problems.insert(0, what)
            self._pins = None
            self._say_not_resting(problems)

    def _say_not_resting(self, problems: list[str]) -> None:
        if problems:
            text = f"{self.spec.name}: not brought to rest: {'; '.join(problems)}"
            self._say_all(EventKind.DRIVE_WARNING, text)

    async def _shut_down(self) -> None:
        """Brake, then switch the power off. In any case the thread ends without power."""
        self._thread.request_mode(BridgeMode.STOP)
        until_s = now_s() + STOPPING_S + OBEYED_WITHIN_S / 10
        await asyncio.sleep(2 / self.spec.cycle_hz)
        while now_s() < until_s:
            if not self._thread.report().stopping:
                return
            await asyncio.sleep(LOOK_EVERY_S)

    # ---------------------------------------------------------------------------------------- jobs
    async def arm(self) -> None:
        """Implement `ports.Line.arm`."""
        for _ in range(SETPOINT_LOOKS):
            self._check_bridges()
            report = await self._try_to_arm()
            if report.armed:
                return
            # The thread alone reads set-points: their mailbox has one reader.
            if not report.fault_reasons & FaultReason.SETPOINTS_OLD:
                raise HalError(f"{self.spec.name}: stopped: arm it again")
            await asyncio.sleep(SETPOINT_LOOK_EVERY_S)
        raise HalError(f"{self.spec.name}: {NO_SETPOINTS}")

    def _check_bridges(self) -> None:
        """Raise HalError if the bridges cannot be armed."""
        self._check_open()
        report = self._thread.report()
        self._note(report)
        for name, words in self._faults.items():
            if words:
                raise DriveFault(f"{name} reports {', '.join(words)}")
        if report.stopping:
            raise HalError(f"{self.spec.name} is still stopping: it cannot be armed")

    async def _try_to_arm(self) -> BridgeReport:
        armed = False
        try:
            report = await self._obeyed(BridgeMode.ARMED)
            armed = report.armed
        finally:
            self._was_armed = armed
            if not armed:
                self._thread.request_mode(BridgeMode.OFF)
        return report

    async def disarm(self) -> None:
        """Implement `ports.Line.disarm`. From the call on, no pin gives power."""
        self._check_open()
        await self._obeyed(BridgeMode.OFF)

    async def _obeyed(self, request: BridgeMode) -> BridgeReport:
        number = self._thread.request_mode(request)
        try:
            async with within(OBEYED_WITHIN_S):
                while (report := self._thread.report()).number != number:
                    self._check_open()
                    await asyncio.sleep(LOOK_EVERY_S)
        except TimeoutError:
            raise NoReply(f"{self.spec.name}: the thread of the pins does not answer") from None
        if not report.running:
            raise PortError(self._what_failed(report))
        return report

    async def clear_faults(self) -> None:
        """Implement `ports.Line.clear_faults`. Nothing can be cleared: the fault pin shows when it
        is over."""
        self._check_open()
        for name, words in self._faults.items():
            if words:
                raise DriveFault(f"{name} reports {', '.join(words)}")

    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register`. Raises LookupError: no register can be read."""
        raise LookupError(f"{self._profile_of(joint).name} has no register to read: {register}")

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """Implement `ports.Line.write_register`. Raises LookupError: no register can be written."""
        del value
        raise LookupError(f"{self._profile_of(joint).name} has no register to write: {register}")

    def _profile_of(self, joint: str) -> DriveProfile:
        for spec in self.spec.joints:
            if spec.name == joint:
                return spec.profile
        raise LookupError(f'{self.spec.name} has no joint "{joint}"')

    def _check_open(self) -> None:
        if not self._is_open:
            raise PortError(f"{self.spec.name}: its pins are not open")
