# SPDX-License-Identifier: Apache-2.0
"""From a line's kind to the class that drives it."""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import cast

from motord_hal.errors import HalError
from motord_hal.ports import Line, LineSpec, Listener
from motord_hal.rt import Exchange

# A table of strings: a robot loads only the lines that it has.
KINDS = MappingProxyType({"modbus-rtu": "motord_hal.modbus.line:ModbusRtuLine"})


def open_line(spec: LineSpec, exchange: Exchange, listener: Listener) -> Line:
    """The line for a spec; nothing is opened before its `run()`. Raises HalError for an unknown
    kind and ProfileError for joints that cannot be together."""
    if spec.kind not in KINDS:
        raise HalError(f'{spec.name}: no line kind "{spec.kind}"; known: {", ".join(KINDS)}')
    module, _, name = KINDS[spec.kind].partition(":")
    return cast("Line", getattr(import_module(module), name)(spec, exchange, listener))
