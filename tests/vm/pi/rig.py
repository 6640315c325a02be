# SPDX-License-Identifier: Apache-2.0
"""Two PWM channels and two GPIO lines of the Pi, as its kernel reports them.

Source: kernel, drivers/pinctrl/bcm/pinctrl-bcm2835.c, gpiolib's debugfs (drivers/gpio/gpiolib.c,
gpiolib_dbg_show) and drivers/pwm/pwm-bcm2835.c.
"""

import pickle
import re
from pathlib import Path

from motord_hal.fieldbus.ports import JointSpec, LineSpec, PinsSpec

CHANNELS = Path("/sys/class/pwm/pwmchip0")
GPIO = Path("/sys/kernel/debug/gpio")
BRIDGE = "bts7960"
PROFILE = pickle.loads(Path(__file__).with_name(f"{BRIDGE}.pickle").read_bytes())
PLACES = {"rpwm": "pwm0", "lpwm": "pwm1", "r_en": "GPIO5", "l_en": "GPIO6"}
NEAR = 0.001


def spec_of(**changes):
    joint = JointSpec(index=0, name="left", profile=PROFILE, unit=1, pins=PLACES)
    values = {
        "index": 0, "name": "pins", "kind": "pwm", "port": "", "baudrate": 115200,
        "parity": "none", "stop_bits": 1, "cycle_hz": 20.0, "gap_s": None, "engine": "auto",
        "joints": (joint,), "watchdog_s": 0.5, "priority": 0,
        "pins": PinsSpec(pwm_chip="3f20c000.pwm", gpio_chip="pinctrl-bcm2835"),
    }  # fmt: skip
    return LineSpec(**{**values, **changes})


def level(where):
    """0 to 1: of a GPIO line's output, or the part of the period of an enabled channel."""
    if where.startswith("pwm"):
        folder = CHANNELS / where
        if not folder.exists():
            return 0.0
        on = (folder / "enable").read_text().strip() == "1"
        duty_ns, period_ns = (int((folder / n).read_text()) for n in ("duty_cycle", "period"))
        return on * duty_ns / period_ns
    found = re.search(rf"\({where} .*?\) (in|out) +(hi|lo)", GPIO.read_text())
    return float(found is not None and found[2] == "hi")


def are(mode, duty=0.0):
    """Whether all pins have the levels of a mode."""
    levels = PROFILE.bridge.levels

    def check():
        return all(
            abs(level(where) - (levels[pin][mode][0] + levels[pin][mode][1] * duty)) < NEAR
            for pin, where in PLACES.items()
        )

    return check
