# SPDX-License-Identifier: Apache-2.0
"""GPIO chips and lines: what is refused before the kernel is asked."""

import os
from pathlib import Path

import pytest

from motord_hal.errors import PortError
from motord_hal.gpio.chip import FLAG_FALLING, FLAG_RISING, Chip
from motord_hal.gpio.lines import Pull, Wanted, _request_of

ESTOP = Wanted(line="3", purpose="safety.estop")


@pytest.fixture
def chip_of(tmp_path):
    """A chip with that label whose descriptor is closed: the kernel says no to every request."""

    def make(label):
        fd = os.open(tmp_path, os.O_RDONLY)
        os.close(fd)
        return Chip(fd, Path("/dev/gpiochip0"), label, 8)

    return make


@pytest.mark.parametrize("label", ["tegra234-gpio", "tegra194-gpio-aon", "tegra-gpio"])
@pytest.mark.parametrize("pull", [Pull.UP, Pull.DOWN])
def test_a_pull_is_refused_where_the_chip_has_none_and_the_kernel_would_not_say_so(
    chip_of, label, pull
):
    with pytest.raises(PortError) as caught:
        _request_of(chip_of(label), [ESTOP], "motord", None, FLAG_RISING | pull)
    assert str(caught.value).startswith(f'safety.estop: the chip "{label}" has no pulls')
    assert "pull = false" in str(caught.value)


@pytest.mark.parametrize(
    ("label", "pull"), [("tegra234-gpio", Pull.AS_IT_IS), ("pinctrl-rp1", Pull.UP)]
)
def test_other_requests_of_an_input_are_the_kernels_to_answer(chip_of, label, pull):
    with pytest.raises(PortError, match="Bad file descriptor"):
        _request_of(chip_of(label), [ESTOP], "motord", None, FLAG_FALLING | pull)
