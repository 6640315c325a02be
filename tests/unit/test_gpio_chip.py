# SPDX-License-Identifier: Apache-2.0
"""GPIO chips and lines: what is refused before the kernel is asked."""

import errno
import os
from pathlib import Path

import pytest

from motord_hal.base.errors import PortError
from motord_hal.gpio.chip import FLAG_FALLING, FLAG_RISING, Chip, _only_chip, _only_line
from motord_hal.gpio.lines import Pull, Wanted, _request_of

KERNEL_SAYS_NO = f"lines 3: ({os.strerror(errno.EBADF)}|{os.strerror(errno.ENOSYS)})"
"""The second: an emulator that knows no GPIO."""
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
    with pytest.raises(PortError, match=KERNEL_SAYS_NO):
        _request_of(chip_of(label), [ESTOP], "motord", None, FLAG_FALLING | pull)


def test_of_two_chips_with_one_label_neither_is_taken(tmp_path):
    paths = (Path("/dev/gpiochip1"), Path("/dev/gpiochip4"))
    chips = [Chip(os.open(tmp_path, os.O_RDONLY), path, "pca9555", 16) for path in paths]
    with pytest.raises(PortError, match=r'2 GPIO chips are "pca9555": /dev/gpiochip1, /dev/gpioc'):
        _only_chip(chips)
    for chip in chips:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(chip.fd)


def test_a_name_that_two_lines_have_is_refused_with_their_numbers():
    assert _only_line(["", "A", "B", ""], "B") == 2
    with pytest.raises(LookupError, match=r'lines 1, 3 of this chip are "A": name one by its num'):
        _only_line(["", "A", "B", "A"], "A")
    with pytest.raises(LookupError, match='no GPIO line "C"'):
        _only_line(["", "A"], "C")
