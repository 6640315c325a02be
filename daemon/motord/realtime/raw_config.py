# SPDX-License-Identifier: Apache-2.0
"""The configuration of the core in C's form, checked by the core's own rules."""

from __future__ import annotations

from typing import Any

from _motord_rt import ffi, lib

from motord.realtime.types import CoreConfig
from motord_hal.realtime.exchange import first_bad


class ConfigRefused(ValueError):
    """The core refuses a configuration. `field` is its first bad field, for example
    `joint[1].wheel_radius_m`."""

    def __init__(self, field: str) -> None:
        super().__init__(f"the core refuses {field}: out of range or not finite")
        self.field = field


def raw_config(config: CoreConfig) -> Any:
    """Return the configuration as struct core_config. Raises ConfigRefused."""
    if not len(config["joint"]) == config["joint_count"] <= lib.JOINTS_MAX:
        raise ConfigRefused("joint_count")
    raw = ffi.new("core_config *", config)
    if bad := first_bad(lib.core_config_check, raw):
        raise ConfigRefused(bad)
    return raw
