# SPDX-License-Identifier: Apache-2.0
"""Tune the speed loop of one wheel: drive steps on the floor, identify the wheel from its answer,
compute gains, and drive the same steps with them.

The robot moves by twists, like with every other command, so [limits] hold. The gains are changed by
`params.set` while the daemon runs; gains that the person does not keep are restored."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motord.api.procedures import OPTIONS
from motord.api.snapshot import Snapshot
from motord.client import Client, ClientError
from motord.commission.calibrate.geometry import require_same
from motord.commission.person import Failed, Person
from motord.commission.robot_file_edit import KeyPath, RobotFileEdit, write_asking
from motord.commission.session import Session, armed
from motord.commission.tune.fit import (
    HELD_UP,
    SEEN_PART_MIN,
    Aggressiveness,
    Gains,
    Plant,
    Response,
    Run,
    gains_of,
    identify,
    response_of,
    seen_part,
)
from motord.config import Robot
from motord.config.sections.bases import JointsBase, wheel_row
from motord.config.sections.joint.speed_loop import CoreGain, SpeedLoop
from motord.config.sections.joint.wheels import all_reverse, takes_duty
from motord.config.sections.joint.wheels import gains_of as gain_keys_of

OWNER = "motord-tune"
LEVELS = (0.5, 1.0)
"""Parts of the greatest speed for the steps; two, since one cannot separate friction from drag."""
SPEED, STEP = OPTIONS["rim_m_s"], OPTIONS["step_s"]
LOOK_EVERY_S = 0.01
TURNS_PART_MIN = 0.3
"""Least part of the base's straight motion that a rim follows; below it the base turns instead."""
DISTANCE_MARGIN = 1.5
TRIES = 3
"""How often the steps are driven at most; a busy computer may fail to record them."""
_GAIN_WORDS = re.compile(r"gain|pid|(^|_)k[pid]($|_)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Limits for the motion of the wheel: speed, time and current."""

    speed_m_s: float = SPEED.usual
    """Speed of the rim."""
    step_s: float = STEP.usual
    current_max_a: float = math.inf

    def __post_init__(self) -> None:
        if not (0.0 < self.speed_m_s <= SPEED.high and 0.0 < self.step_s <= STEP.high):
            raise ValueError(f"at most {SPEED.high:g} m/s and {STEP.high:g} s a step")

    @property
    def step_m(self) -> float:
        """The greatest length of a step, with its ramps."""
        return DISTANCE_MARGIN * self.speed_m_s * self.step_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """The result, before and after. `gains` are those of the robot file, by key."""

    joint: str
    plant: Plant
    gains: Mapping[str, float]
    before: Response
    after: Response
    before_runs: tuple[Run, ...]
    after_runs: tuple[Run, ...]

    @property
    def better(self) -> bool:
        return self.after.error_rad_s < self.before.error_rad_s


def tunable(robot: Robot, name: str) -> None:
    """Check that motord controls this wheel's speed. Raises Failed, with what controls it
    instead."""
    if name not in robot.joint:
        raise Failed(f'no joint "{name}": known are {", ".join(robot.joint)}')
    if isinstance(robot.base, JointsBase):
        raise Failed(
            f"{name}: tune drives a base, and this robot has none: set the gains of "
            f"[joint.{name}.speed_loop] by motord params set, and keep them by motord params save"
        )
    joint = robot.joint[name]
    profile = robot.profiles[joint.drive]
    if gain_keys_of(joint, profile):
        return
    if takes_duty(joint, profile):
        raise Failed(
            f"{name}: nothing measures this wheel, and without a measure there is no speed loop: "
            "give the joint an encoder ([joint.NAME.encoder] or counts_per_turn)"
        )
    registers = [one for one in profile.registers if _GAIN_WORDS.search(one)]
    where = (
        f"its registers {', '.join(registers)}: motord params get drive.{name}.{registers[0]}"
        if registers
        else f'its maker\'s tool: profile "{joint.drive}" names no registers of them'
    )
    raise Failed(
        f'{name}: drive "{joint.drive}" holds the speed of the wheel by itself, so its gains are '
        f"in the drive. Change them by {where}"
    )


class Tuning:
    """Context manager that restores gains that were tried and not kept at its end."""

    def __init__(
        self, client: Client, person: Person, robot: Robot, name: str, bounds: Bounds
    ) -> None:
        """Read the present gains. Raises Failed, ClientError."""
        tunable(robot, name)
        self._client, self._person, self._bounds = client, person, bounds
        self._robot, self._name = robot, name
        joint = robot.joint[name]
        profile = robot.profiles[joint.drive]
        self._keys = {core: key for key, core in gain_keys_of(joint, profile).items()}
        self._open_loop = takes_duty(joint, profile)
        self._reverses = all_reverse(robot)
        self._index = list(robot.joint).index(name)
        self._was = client.params_get(*map(self._parameter, self._keys.values()))
        self._kept = False

    def __enter__(self) -> Tuning:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._kept:
            with contextlib.suppress(ClientError):  # an ended daemon begins with its file
                self._client.params_set(**self._was)

    def keep(self) -> None:
        """Keep the gains that are in force now; they are also in the robot file."""
        self._kept = True

    def run(self, aggressiveness: Aggressiveness) -> Tuned:
        """Drive, find the gains, drive with them. Raises Failed, Aborted, ClientError."""
        if not self._person.confirm(self._question()):
            raise Failed("nothing was driven")
        before = self._steps("as it is")
        if self._open_loop and any(self._was.values()):
            self._put(dict.fromkeys(self._keys, 0.0))
            plant = identify(self._name, self._steps("without a loop"))
        else:
            plant = identify(self._name, before)
        gains = self._gains(plant, gains_of(plant, aggressiveness))
        self._put(gains)
        after = self._steps("with the new gains")
        return Tuned(
            joint=self._name,
            plant=plant,
            gains={self._keys[core]: value for core, value in gains.items()},
            before=response_of(before),
            after=response_of(after),
            before_runs=before,
            after_runs=after,
        )

    def changes(self, tuned: Tuned) -> dict[KeyPath, Any]:
        """Return the changed keys of the robot file; a value that it already has, also as a
        default, is no change."""
        has = self._robot.joint[self._name].speed_loop or SpeedLoop()
        return {
            ("joint", self._name, "speed_loop", key): value
            for key, value in tuned.gains.items()
            if getattr(has, key) != value
        }

    def _gains(self, plant: Plant, loop: Gains) -> dict[CoreGain, float]:
        """Return the gains by the core's names, rounded as in the file. The derivative is 0: a
        plant of the first order does not need it (Skogestad)."""
        wanted: dict[CoreGain, float] = {
            "gain_u_s_per_rad": loop.gain_u_s_per_rad,
            "integral_u_per_rad": loop.integral_u_per_rad,
            "derivative_u_s2_per_rad": 0.0,
            "static_u": plant.static_u,
            "viscous_u_s_per_rad": plant.viscous_u_s_per_rad,
            "acceleration_u_s2_per_rad": plant.acceleration_u_s2_per_rad,
        }
        return {core: float(f"{wanted[core]:.4g}") for core in self._keys}

    def _put(self, gains: Mapping[CoreGain, float]) -> None:
        values = {self._parameter(self._keys[core]): value for core, value in gains.items()}
        self._client.params_set(**values)

    def _parameter(self, key: str) -> str:
        return f"joint.{self._name}.speed_loop.{key}"

    def _question(self) -> str:
        bounds = self._bounds
        turns = "on the spot" if self._twist(1.0)[1] else ""
        how = (
            f"drives {len(LEVELS)} times forward and back {turns}".rstrip()
            if self._reverses
            else f"drives forward {len(LEVELS)} times"
        )
        return (
            f"The robot {how}, each time by up to {bounds.step_m:.1f} m at its rims, with at most "
            f"{bounds.speed_m_s:g} m/s; then again with the new gains. Is the path clear?"
        )

    def _twist(self, rim_m_s: float) -> tuple[float, float]:
        """Return linear and angular velocity of a twist in which this wheel's rim has this
        speed."""
        row = wheel_row(self._robot.base, self._robot.joint[self._name])
        if abs(row.x) >= TURNS_PART_MIN:
            return rim_m_s / row.x, 0.0
        return 0.0, rim_m_s / row.lever_m

    def _steps(self, what: str) -> tuple[Run, ...]:
        for tries_left in reversed(range(TRIES)):
            runs = self._driven(what)
            part = seen_part(runs)
            if part >= SEEN_PART_MIN:
                return runs
            if tries_left and not self._person.confirm(
                f"This computer was held up and saw only {part:.0%} of these steps. The robot "
                "drives them once more, from where it stands. Is the path clear?"
            ):
                raise Failed("nothing was written")
        raise Failed(f"{self._name}: {HELD_UP}")

    def _driven(self, what: str) -> tuple[Run, ...]:
        """Drive all steps once."""
        runs = []
        signs = (1.0, -1.0) if self._reverses else (1.0,)
        with armed(self._client, self._person, OWNER) as session:
            session.look_every_s = LOOK_EVERY_S
            for level in LEVELS:
                for sign in signs:
                    self._person.progress(f"{self._name}, {what}")
                    runs.append(self._step(session, sign * level * self._bounds.speed_m_s))
        return tuple(runs)

    def _step(self, session: Session, rim_m_s: float) -> Run:
        start = session.newest().joints[self._index].position_rad
        far: list[str] = []

        def beyond(newest: Snapshot) -> bool:
            joint = newest.joints[self._index]
            most_rad = self._bounds.step_m / self._robot.wheel_radius_m(self._name)
            if abs(joint.current_a) > self._bounds.current_max_a:
                far.append(f"{abs(joint.current_a):.2f} A are more than --current-max-a allows")
            elif abs(joint.position_rad - start) > most_rad:
                far.append(f"the wheel has turned by more than {most_rad:.1f} rad")
            return bool(far)

        linear_m_s, angular_rad_s = self._twist(rim_m_s)
        held = session.hold(linear_m_s, angular_rad_s, self._bounds.step_s, beyond)
        if far:
            raise Failed(f"{self._name}: {far[0]}: the robot was stopped, nothing was written")
        if held.faults:
            raise Failed(f"{session.stopped_by(held.faults)}: motord spin {self._name}")
        return run_of(held.snapshots, self._index, duty=self._open_loop)


def run_of(snapshots: tuple[Snapshot, ...], index: int, *, duty: bool) -> Run:
    """Return the samples of one wheel, each measure once. Raises Failed if it measures no speed."""
    begin_ns = snapshots[0].stamp_ns
    times: list[float] = []
    measured: list[float] = []
    wants, outputs, speeds = [], [], []
    for snapshot in snapshots:
        joint = snapshot.joints[index]
        now_s = (snapshot.stamp_ns - begin_ns) * 1e-9
        output_u = joint.duty if duty else snapshot.speed_loops[index].output_u
        if times and now_s <= times[-1]:
            continue  # the loop was late: the same tick again
        times.append(now_s)
        wants.append(joint.setpoint_rad_s)
        outputs.append(output_u)
        stamp_s = now_s - joint.feedback_age_s
        is_new = not measured or stamp_s > measured[-1] + 1e-4
        if stamp_s >= 0.0 and is_new and math.isfinite(joint.velocity_rad_s):
            measured.append(stamp_s)
            speeds.append(joint.velocity_rad_s)
    if len(measured) < 2:
        raise Failed("the wheel measures no speed: motord doctor")
    return Run(*(np.array(each) for each in (times, wants, outputs, measured, speeds)))


def tune(
    client: Client,
    person: Person,
    edit: RobotFileEdit,
    name: str,
    bounds: Bounds,
    aggressiveness: Aggressiveness,
    pictured: Callable[[Tuned], None],
    *,
    dry_run: bool = False,
) -> tuple[Tuned, Path | None]:
    """Tune a wheel, from the first question to the robot file; the second result is the backup of
    the old file. `pictured` shows the steps. Raises Aborted, Failed, EditError, ClientError."""
    require_same(edit.before, client.call("robot"))
    with Tuning(client, person, edit.before, name, bounds) as tuning:
        tuned = tuning.run(aggressiveness)
        for text in words(tuned, unit=unit_of(edit.before, name)):
            person.show(text)
        pictured(tuned)
        if not tuned.better:
            person.show("the wheel follows no better with these gains: nothing was written")
            return tuned, None
        edit.update(tuning.changes(tuned))
        backup = write_asking(person, edit, dry_run=dry_run)
        if backup is not None:
            tuning.keep()
            person.show("The gains are in force already. Restart the daemon for its checks.")
    return tuned, backup


def words(tuned: Tuned, *, unit: str) -> list[str]:
    """Return texts with the model, the gains, and their effect."""
    plant, before, after = tuned.plant, tuned.before, tuned.after
    wheel = (
        f"{plant.steady_rad_s_per_u:.2f} rad/s for a {unit}, time constant "
        f"{plant.time_constant_s:.3f} s, dead time {plant.dead_time_s:.3f} s, static friction "
        f"{plant.static_u:.4f} (off by {plant.misfit_rad_s:.3f} rad/s)"
    )
    gains = ", ".join(f"{key} {value:g}" for key, value in tuned.gains.items())
    change = (
        f"error {before.error_rad_s:.3f} → {after.error_rad_s:.3f} rad/s rms, at the end of a "
        f"step {before.off_rad_s:.3f} → {after.off_rad_s:.3f} rad/s, overshoot "
        f"{before.overshoot_rad_s:.3f} → {after.overshoot_rad_s:.3f} rad/s"
    )
    return [f"{tuned.joint}: {text}" for text in (wheel, gains, change)]


def unit_of(robot: Robot, name: str) -> str:
    """Return the unit of the output of this wheel's loop, for a sentence."""
    joint = robot.joint[name]
    return "duty of 1" if takes_duty(joint, robot.profiles[joint.drive]) else "N·m"
