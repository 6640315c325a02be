# SPDX-License-Identifier: Apache-2.0
"""The text of a new drive profile from answers: only what was answered, and a list of what was
not."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

from motord.cli.files.drive_questions import NONE, Answers, Value
from motord.config.drives.unknown import UNKNOWN
from motord_hal.base.paths import config_dir

_SERIAL = ("baudrate", "parity", "stop_bits", "unit", "write_function")
_DIRECTION = ("direction_address", "direction_forward", "direction_reverse", "direction_rest")
_VELOCITY = ("velocity_address", "velocity_bits", "velocity_sign", "velocity_rpm_per_1")
_ENABLE = ("enable_address", "enable_on", "enable_off")
_WATCHDOG = (
    "watchdog_address",
    "watchdog_ms_per_1",
    "watchdog_minimum_s",
    "watchdog_maximum_s",
    "watchdog_action",
)
_STEPS = """
[steps]
configure = [{zero}{off}]
arm = [{on}]
disarm = [{zero}{off}]
quick_stop = [{zero}{off}]
clear_fault = []
"""


class UnfitAnswers(ValueError):
    """Answers that contradict each other, or need what a profile cannot express."""


def drive_text(name: str, answers: Answers) -> tuple[str, list[str]]:
    """Return the text of the profile, and the facts of UNKNOWN that it lists. Raises
    UnfitAnswers."""
    if "speed_address" not in answers:
        raise UnfitAnswers(
            "speed_address: without the speed set-point there is no profile to begin"
        )
    _check(answers)
    order = _order(answers)
    unknown = _unknown(answers, order)
    return "".join(_parts(name, answers, order, unknown)), unknown


def _has(answers: Answers, keys: tuple[str, ...]) -> bool:
    return all(answers.get(key, NONE) != NONE for key in keys)


def _check(answers: Answers) -> None:
    """Raise UnfitAnswers for what contradicts itself, or what no profile can express."""
    if answers.get("starts_by_speed") == "no" and answers.get("enable_address") == NONE:
        raise UnfitAnswers(
            "enable_address: the speed does not start the motor, and there is no register that "
            "does: find its run command; it is what gives the motor its power"
        )
    if answers.get("speed_sign") == "signed" and answers.get("velocity_sign") == "magnitude":
        raise UnfitAnswers(
            "velocity_sign: a profile cannot express a measured speed without sign beside a signed "
            "set-point: motord would not see that the motor turns backward; find a signed one, or "
            "leave velocity_address out"
        )
    if answers.get("speed_bits") == 32 and answers.get("write_function") == 6:
        raise UnfitAnswers("write_function: 6 writes 16 bits; a speed of 32 bits needs 16")


def _order(answers: Answers) -> str | None:
    """Return the order of the words as a register's type ends, by the example; None: unknown.
    Raises UnfitAnswers for an order that a profile cannot express."""
    if not _has(answers, ("speed_bits", "example_value", "example_bytes")):
        return None
    size, value = int(answers["speed_bits"]) // 8, int(answers["example_value"])
    try:
        shown = bytes.fromhex(re.sub(r"[\s,]|0x", "", str(answers["example_bytes"])))
        straight = value.to_bytes(size, "big", signed=value < 0)
    except (ValueError, OverflowError):
        shown = straight = b""
    if not straight or len(shown) != size:
        text = f"{answers['example_bytes']!r} is not {value} in {size} bytes"
        raise UnfitAnswers(f"example_bytes: {text}, as 03 E8 is 1000 in two")
    low_first = straight[2:] + straight[:2]
    swapped = [bytes(b for at in range(0, size, 2) for b in one[at : at + 2][::-1])
               for one in (straight, low_first)]  # fmt: skip
    if straight in (*swapped, low_first[: size if size > 2 else 0]):
        text = f"{value} has the same bytes in more orders than one: choose another, as 1000"
        raise UnfitAnswers(f"example_value: {text}")
    if shown == straight:
        return ""
    if size > 2 and shown == low_first:
        return "-low-first"
    if shown in swapped:
        raise UnfitAnswers(
            "example_bytes: this drive swaps the two bytes of a word. A profile cannot express "
            "that: as one it would command wrong speeds. Such a drive needs code"
        )
    raise UnfitAnswers(f"example_bytes: {shown.hex(' ')} is {value} in no order of bytes and words")


def _unknown(answers: Answers, order: str | None) -> list[str]:
    no_enable = answers.get("enable_address") == NONE
    no_watchdog = answers.get("watchdog_address") == NONE
    signed = answers.get("speed_sign") == "signed"
    known = {
        "serial": all(key in answers for key in _SERIAL),
        "sign": signed or (answers.get("speed_sign") is not None and _has(answers, _DIRECTION)),
        "order": order is not None,
        "scale": "speed_rpm_per_1" in answers,
        "range": "speed_maximum_rpm" in answers,
        "start": "starts_by_speed" in answers,
        "enable": no_enable or _has(answers, _ENABLE),
        "velocity": answers.get("velocity_address") == NONE or _measures(answers, order),
        "watchdog": no_watchdog or _has(answers, _WATCHDOG),
        "source": "source" in answers,
    }
    return [fact for fact in UNKNOWN if not known[fact]]


def _measures(answers: Answers, order: str | None) -> bool:
    return order is not None and _has(answers, _VELOCITY)


def _toml(value: Value) -> str:
    return json.dumps(value, ensure_ascii=False)


def _parts(name: str, answers: Answers, order: str | None, unknown: list[str]) -> Iterator[str]:
    source = _toml(answers.get("source", "unknown"))
    schema = (config_dir() / "schema" / "drive.schema.json").as_uri()
    yield f"#:schema {schema}\n"
    yield "# Begun by `motord drives new`. Every address has a source: put its page there.\n"
    yield f'schema = 1\nname = "{name}"\ntitle = {_toml(answers.get("title", name))}\n'
    yield f'protocol = "modbus-rtu"\nsource = {source}\n'
    if unknown:
        yield "# Look these up, write them into this file, and take them off the list:\n"
        yield f"unknown = {_toml_list(unknown)}\n"
    if "watchdog" in unknown:
        yield 'watchdog_note = "whether it has one is unknown: give the robot an e-stop that '
        yield 'cuts its power"\n'
    elif answers["watchdog_address"] == NONE:
        yield 'watchdog_note = "it has none: give the robot an e-stop that cuts its power"\n'
    yield from _serial(answers)
    yield from _speed(answers, order, source)
    if _measures(answers, order):
        kind = _type(answers["velocity_bits"], answers["velocity_sign"], order)
        yield from _register("velocity", answers["velocity_address"], kind, "r", source)
        yield f'unit = "rpm"\nscale = {answers["velocity_rpm_per_1"]}\n'
    if _has(answers, _ENABLE):
        yield from _register("enable", answers["enable_address"], "u16", "rw", source)
    if _has(answers, _WATCHDOG):
        address = answers["watchdog_address"]
        yield from _register("communication_timeout", address, "u16", "rw", source)
        yield f'unit = "ms"\nscale = {answers["watchdog_ms_per_1"]}\n'
        yield '\n[watchdog]\nregister = "communication_timeout"\n'
        yield f"minimum_s = {answers['watchdog_minimum_s']}\n"
        yield f"maximum_s = {answers['watchdog_maximum_s']}\n"
        yield f"action = {_toml(answers['watchdog_action'])}\n"
    yield '\n[channel.1]\nvelocity_setpoint = "target_velocity"\n'
    yield 'velocity = "velocity"\n' if _measures(answers, order) else ""
    yield _direction(answers)
    yield _steps(answers)


def _toml_list(words: list[str]) -> str:
    return f"[{', '.join(map(_toml, words))}]"


def _serial(answers: Answers) -> Iterator[str]:
    yield "\n[serial]\n"
    for key in _SERIAL:
        if key in answers:
            yield f"{key} = {_toml(answers[key])}\n"
    yield "turnaround_s = 0.02         # a guess: the longest time until it answers; measure it\n"
    words = 2 if 32 in (answers.get("speed_bits"), answers.get("velocity_bits")) else 1
    yield f"max_registers = {words}           # of one request: every drive takes it\n"


def _type(bits: Value, sign: Value, order: str | None) -> str:
    return f"{'i' if sign == 'signed' else 'u'}{bits}{(order or '') if bits == 32 else ''}"


def _register(
    name: str, address: Value, kind: str | None, access: str, source: str
) -> Iterator[str]:
    yield f"\n[register.{name}]\naddress = {int(address):#06x}\n"
    yield f'type = "{kind}"\n' if kind is not None else ""
    yield f'access = "{access}"\nsource = {source}\n'


def _speed(answers: Answers, order: str | None, source: str) -> Iterator[str]:
    sign, bits = answers.get("speed_sign"), answers.get("speed_bits")
    is_known = sign is not None and (bits == 16 or order is not None)
    kind = _type(bits or 0, sign or "", order) if is_known else None
    yield from _register("target_velocity", answers["speed_address"], kind, "rw", source)
    yield 'unit = "rpm"\n'
    if "speed_rpm_per_1" in answers:
        yield f"scale = {answers['speed_rpm_per_1']}\n"
    if "speed_maximum_rpm" in answers:
        most = answers["speed_maximum_rpm"]
        if sign is not None:
            yield f"minimum = {f'-{most}' if sign == 'signed' else 0}\n"
        yield f"maximum = {most}\n"
    if sign == "magnitude" and _has(answers, _DIRECTION):
        yield from _register("direction", answers["direction_address"], "u16", "rw", source)


def _direction(answers: Answers) -> str:
    if answers.get("speed_sign") != "magnitude" or not _has(answers, _DIRECTION):
        return ""
    parts = (f"{key} = {answers[f'direction_{key}']}" for key in ("forward", "reverse", "rest"))
    return f'direction = {{ register = "direction", {", ".join(parts)} }}\n'


def _steps(answers: Answers) -> str:
    on = off = ""
    if _has(answers, _ENABLE):
        on = f'{{ write = "enable", value = {answers["enable_on"]} }}'
        off = f', {{ write = "enable", value = {answers["enable_off"]} }}'
    return _STEPS.format(zero='{ write = "target_velocity", value = 0 }', on=on, off=off)
