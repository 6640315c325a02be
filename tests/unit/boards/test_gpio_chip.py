# SPDX-License-Identifier: Apache-2.0
"""GPIO chips and lines: requests that are refused before the kernel is called."""

import errno
import os
from pathlib import Path

import pytest
from gpiod.line import Bias

from motord_hal.base.errors import PortError
from motord_hal.gpio.chip import Chip, _only_chip, _only_line, open_chip
from motord_hal.gpio.lines import Wanted, _refusal, check_pull, request_outputs

ESTOP = Wanted(line="3", purpose="safety.estop")
ONE, OTHER = Path("/dev/gpiochip1"), Path("/dev/gpiochip4")


@pytest.mark.parametrize("label", ["tegra234-gpio", "tegra194-gpio-aon", "tegra-gpio"])
@pytest.mark.parametrize("pull", [Bias.PULL_UP, Bias.PULL_DOWN])
def test_a_pull_is_refused_where_the_chip_has_none_and_the_kernel_reports_no_error(label, pull):
    with pytest.raises(PortError) as caught:
        check_pull(label, ESTOP, pull)
    assert str(caught.value).startswith(f'safety.estop: the chip "{label}" has no pulls')
    assert "pull = false" in str(caught.value)


def test_no_pull_and_a_supported_pull_pass_the_check():
    check_pull("tegra234-gpio", ESTOP, Bias.AS_IS)
    check_pull("pinctrl-rp1", ESTOP, Bias.PULL_UP)


def test_of_two_chips_with_one_label_neither_is_taken():
    labels = {ONE: "pca9555", OTHER: "pca9555", Path("/dev/gpiochip0"): "pinctrl-rp1"}
    with pytest.raises(PortError, match=r'2 GPIO chips have the label "pca9555": /dev/gpiochip1'):
        _only_chip(labels, "pca9555")
    assert _only_chip(labels, "pinctrl-rp1") == Path("/dev/gpiochip0")


def test_a_missing_chip_is_reported_with_those_present(tmp_path):
    with pytest.raises(PortError, match=r'no GPIO chip "x"; there: gpiochip1 "pca9555"$'):
        _only_chip({ONE: "pca9555"}, "x")
    (tmp_path / "gpiochip0").touch()
    with pytest.raises(PortError, match=r'no GPIO chip "x"; there: gpiochip0 \(Inapp'):
        request_outputs("x", [ESTOP], "motord", tmp_path)


@pytest.mark.parametrize("wanted", ["gpiochip0", "{dev}/gpiochip0"])
def test_a_device_file_that_is_no_chip_is_reported_with_its_path(tmp_path, wanted):
    (tmp_path / "gpiochip0").touch()
    with (
        pytest.raises(PortError, match=f"GPIO chip {tmp_path}/gpiochip0 cannot be opened: Inapp"),
        open_chip(wanted.format(dev=tmp_path), tmp_path),
    ):
        pass


def test_a_name_that_two_lines_have_is_refused_with_their_numbers():
    assert _only_line(["", "A", "B", ""], "B") == 2
    with pytest.raises(LookupError, match=r'lines 1, 3 of this chip have the name "A": give a'):
        _only_line(["", "A", "B", "A"], "A")
    with pytest.raises(LookupError, match='no GPIO line "C"'):
        _only_line(["", "A"], "C")


class Gone:
    """Stands for the gpiod.Chip of a chip that was unplugged."""

    def get_line_info(self, offset):
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))


def test_a_chip_that_is_gone_is_named_with_its_lines():
    chip = Chip(Gone(), ONE, "pinctrl-rp1", 54)
    taken = OSError(errno.EBUSY, os.strerror(errno.EBUSY))
    refusal = _refusal(chip, [Wanted(line="GPIO5", purpose="a test")], [5], taken)
    assert '/dev/gpiochip1 "pinctrl-rp1", lines GPIO5' in refusal
