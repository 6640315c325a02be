# SPDX-License-Identifier: Apache-2.0
"""Run one procedure for a page of the dashboard. motord-bus starts this module as a process, passes
messages between it and the page (person.py), and kills it if it does not end. It sends commands
like every other program; dead_man.py disarms the robot when it ends.

The first line of input names the daemon's socket, the procedure, its options and the joints to
turn; the last line of output is `{"end": ...}`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motord.api.procedures import chosen
from motord.base.extras import numpy_missing
from motord.client import Client, ClientError
from motord.commission.page.person import PagePerson
from motord.commission.page.pictures import picture_of_turns
from motord.commission.person import Aborted, Failed
from motord.commission.robot_file_edit import (
    ConfigError,
    EditError,
    RobotFileEdit,
    write_asking,
)
from motord.commission.spin.findings import findings
from motord.commission.spin.steered import procedure_for

if TYPE_CHECKING:
    from motord.commission.tune.fit import Aggressiveness
    from motord.commission.tune.procedure import Tuned

CLIENT_WITHIN_S = 30.0


def carry_out(person: PagePerson, request: Mapping[str, Any]) -> dict[str, Any]:
    """Run the procedure and return its result. `good`: whether it has a result; `text`: the result
    in words; `backup`: the backup, if the robot file was written; `new_file`: the new text of the
    file, if it could not be written."""
    what = request["procedure"]
    try:
        options = chosen(what, request["options"])
        with Client(request["socket"], timeout_s=CLIENT_WITHIN_S) as client:
            edit = RobotFileEdit(Path(client.call("robot")["file"]))
            match what:
                case "spin":
                    text = _spin(client, person, edit, request["joints"], options)
                case "tune":
                    return _tune(client, person, edit, request["joints"], options)
                case _:
                    text = _calibrate(client, person, edit, what, options)
        return _written(person, edit) | {"text": text}
    except Aborted as error:
        why = f"{person.why}: " if person.why and person.why not in str(error) else ""
        return {"good": False, "text": f"{why}{error}"}
    except (Failed, EditError, ConfigError, ClientError, ValueError, KeyError) as error:
        return {"good": False, "text": str(error)}


def _spin(
    client: Client,
    person: PagePerson,
    edit: RobotFileEdit,
    joints: Sequence[str],
    options: Mapping[str, float],
) -> str:
    described = client.call("robot")
    names = joints or described["joints"]
    procedure = procedure_for(described)
    turns = procedure(client, person, names, options["wheel_rad_s"], options["seconds"])
    found = findings(edit.before, turns)
    person.picture(picture_of_turns(turns))
    for text in found.texts:
        person.show(text)
    edit.update(found.changes)
    if found.good:
        return "every wheel turns as the robot file has it"
    return "; ".join(found.texts)


def _calibrate(
    client: Client,
    person: PagePerson,
    edit: RobotFileEdit,
    what: str,
    options: Mapping[str, float],
) -> str:
    _require_numpy()
    from motord.api.geometry_fit import BadData
    from motord.commission.calibrate.procedure import calibrated
    from motord.commission.page.calibration_pictures import pictures

    try:
        found = calibrated(client, person, edit, what, options)
    except BadData as error:
        raise Failed(f"{error}; nothing was written") from error
    for plot in pictures(edit.before, found):
        person.picture(plot)
    return "measured"


def _tune(
    client: Client,
    person: PagePerson,
    edit: RobotFileEdit,
    joints: Sequence[str],
    options: Mapping[str, float],
) -> dict[str, Any]:
    _require_numpy()
    from motord.commission.page.tune_pictures import pictures_of_steps
    from motord.commission.tune.procedure import Bounds, tunable, tune

    if len(joints) != 1:
        raise Failed("one wheel at a time: choose it")
    tunable(edit.before, joints[0])
    speeds: tuple[Aggressiveness, ...] = ("gentle", "normal", "brisk")
    how = person.choose("How fast should the closed loop be?", speeds)
    aggressiveness = next(one for one in speeds if one == how)
    bounds = Bounds(speed_m_s=options["rim_m_s"], step_s=options["step_s"])

    def pictured(tuned: Tuned) -> None:
        for plot in pictures_of_steps(tuned):
            person.picture(plot)

    answer: dict[str, Any] = {"good": True, "file": str(edit.path), "backup": None}
    try:
        tuned, backup = tune(client, person, edit, joints[0], bounds, aggressiveness, pictured)
    except EditError as error:
        person.show(str(error))
        return answer | {"new_file": edit.text, "text": "measured"}
    text = "measured" if tuned.better else "the wheel follows no better with these gains"
    return answer | {"good": tuned.better, "backup": backup and str(backup), "text": text}


def _require_numpy() -> None:
    if why := numpy_missing():
        raise Failed(why)


def _written(person: PagePerson, edit: RobotFileEdit) -> dict[str, Any]:
    """Write the changed file, if the person confirms it, and return what became of it."""
    answer: dict[str, Any] = {"good": True, "file": str(edit.path), "backup": None}
    if not edit.changed:
        return answer
    try:
        backup = write_asking(person, edit)
    except EditError as error:
        person.show(str(error))
        return answer | {"new_file": edit.text}
    return answer | {"backup": backup and str(backup)}


def main() -> None:
    """Run one procedure, until it or stdin ends."""
    messages = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # the prints of libraries are no messages
    request = json.loads(sys.stdin.readline())
    person = PagePerson(sys.stdin, messages)
    person.send({"end": carry_out(person, request)})


if __name__ == "__main__":
    main()
