# SPDX-License-Identifier: Apache-2.0
"""The questions of `motord drives new`, and which answers each of them takes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

Value = str | int | float
Answers = dict[str, Value]
NONE = "none"
"""Answer for a register that the drive does not have."""


@dataclass(frozen=True, slots=True)
class Question:
    key: str
    text: str
    kind: type[Value]
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[Value, ...] = ()
    """All possible answers; with `low` and `high`: those beside a number."""
    after: Mapping[str, tuple[Value, ...]] = field(default_factory=dict)
    """Earlier questions and their answers with which this one is asked."""
    needs: tuple[str, ...] = ()
    """Earlier questions that must have an answer other than "none"."""

    def is_asked(self, answers: Mapping[str, Value]) -> bool:
        fits = all(answers.get(key) in values for key, values in self.after.items())
        return fits and all(answers.get(key, NONE) != NONE for key in self.needs)

    def typed(self, text: str) -> Value:
        """Return the answer that a person typed. Raises ValueError with what it may be."""
        value: object = text
        if text not in self.choices and self.kind is not str:
            try:
                value = int(text, 0) if self.kind is int else float(text)
            except ValueError:
                raise ValueError(f"{text!r} is not {self._allowed()}") from None
        return self.checked(value)

    def checked(self, value: object) -> Value:
        """Return the answer in an answers file. Raises ValueError with what it may be."""
        if isinstance(value, str) and value in self.choices:
            return value
        if self.kind is str and not self.choices and isinstance(value, str):
            if not re.fullmatch(r'[^"\\\x00-\x1f\x7f]+', value):
                raise ValueError("no quotes, backslashes or control characters, and not empty")
            return value
        kinds = (int, float) if self.kind is float else (int,)
        if self.kind is str or isinstance(value, bool) or not isinstance(value, kinds):
            raise ValueError(f"{value!r} is not {self._allowed()}")
        only = self.choices and self.low == -math.inf
        if (only and value not in self.choices) or not self.low <= value <= self.high:
            raise ValueError(f"{value!r} is not {self._allowed()}")
        return value

    def _allowed(self) -> str:
        words = [str(choice) for choice in self.choices]
        if self.low > -math.inf:
            number = "a whole number" if self.kind is int else "a number"
            words.append(f"{number} from {self.low:g} to {self.high:g}")
        return " or ".join(words)


_NOTHING: Mapping[str, tuple[Value, ...]] = MappingProxyType({})
_MAGNITUDE: Mapping[str, tuple[Value, ...]] = MappingProxyType({"speed_sign": ("magnitude",)})


def _word(
    key: str,
    text: str,
    choices: tuple[Value, ...] = (),
    after: Mapping[str, tuple[Value, ...]] = _NOTHING,
    needs: tuple[str, ...] = (),
) -> Question:
    """Return a question for an address or the raw value of a register of 16 bits."""
    return Question(key, text, int, 0, 0xFFFF, choices, after, needs)


QUESTIONS: tuple[Question, ...] = (
    Question("title", "Maker and model", str),
    Question("source", "Where its registers are written down (manual, version, page)", str),
    Question("baudrate", "Baud rate, as delivered", int, 300, 4_500_000),
    Question("parity", "Parity (none, even, odd)", str, choices=("none", "even", "odd")),
    Question("stop_bits", "Stop bits (1 or 2)", int, choices=(1, 2)),
    Question("unit", "Its address on the line, as delivered", int, 1, 247),
    Question("write_function", "Function that writes (6 or 16)", int, choices=(6, 16)),
    _word("speed_address", "Address of the speed set-point"),
    Question("speed_bits", "Its width in bits (16 or 32)", int, choices=(16, 32)),
    Question(
        "speed_sign",
        "Is it signed, or a magnitude with the direction in another register (signed, magnitude)",
        str,
        choices=("signed", "magnitude"),
    ),
    _word("direction_address", "Address of the direction", after=_MAGNITUDE),
    _word("direction_forward", "Its value for forward", after=_MAGNITUDE),
    _word("direction_reverse", "Its value for reverse", after=_MAGNITUDE),
    _word("direction_rest", "Its value at rest", after=_MAGNITUDE),
    Question(
        "example_value",
        "An example of the speed register in the manual: the raw number, as 1000",
        int,
        -(1 << 31),
        (1 << 32) - 1,
    ),
    Question(
        "example_bytes",
        "The bytes of this number in the order of the wire, as 03 E8",
        str,
        needs=("example_value",),
    ),
    Question("speed_rpm_per_1", "Speed in rpm that a raw 1 means (0.1, 1, ...)", float, 1e-9, 1e9),
    Question("speed_maximum_rpm", "Fastest speed of the motor in rpm", float, 1e-6, 1e6),
    _word("velocity_address", "Address of the measured speed", choices=(NONE,)),
    Question(
        "velocity_bits",
        "Its width in bits (16 or 32)",
        int,
        choices=(16, 32),
        needs=("velocity_address",),
    ),
    Question(
        "velocity_sign",
        "Is it signed, or a magnitude (signed, magnitude)",
        str,
        choices=("signed", "magnitude"),
        needs=("velocity_address",),
    ),
    Question(
        "velocity_rpm_per_1",
        "Speed in rpm that a raw 1 of it means",
        float,
        1e-9,
        1e9,
        needs=("velocity_address",),
    ),
    Question(
        "starts_by_speed",
        "Does writing the speed alone start the motor (yes, no)",
        str,
        choices=("yes", "no"),
    ),
    _word(
        "enable_address",
        "Address of the register that gives the motor its power (none: it has no such register)",
        choices=(NONE,),
    ),
    _word("enable_on", "Its value with power", needs=("enable_address",)),
    _word("enable_off", "Its value without power", needs=("enable_address",)),
    _word(
        "watchdog_address",
        "Address of its communication time-out (none: it has none)",
        choices=(NONE,),
    ),
    Question(
        "watchdog_ms_per_1",
        "Time in ms that a raw 1 of it means",
        float,
        1e-3,
        1e6,
        needs=("watchdog_address",),
    ),
    Question(
        "watchdog_minimum_s",
        "Shortest time-out in s",
        float,
        0.001,
        3600.0,
        needs=("watchdog_address",),
    ),
    Question(
        "watchdog_maximum_s",
        "Longest time-out in s",
        float,
        0.001,
        3600.0,
        needs=("watchdog_address",),
    ),
    Question(
        "watchdog_action",
        "What the drive does when it expires, in words",
        str,
        needs=("watchdog_address",),
    ),
)
