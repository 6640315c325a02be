# SPDX-License-Identifier: Apache-2.0
"""`motord doctor` names the problems of a machine and their remedies, on planted files of /proc,
/sys, /dev and /etc."""

import os
import struct
from pathlib import Path

import pytest

from motord.api.status import Status
from motord.config import load_robot
from motord.tools.doctor import devices, heartbeats, machine
from motord.tools.doctor.finding import Root, Run
from motord.tools.doctor.heartbeats import Look
from motord_hal.can.netlink import bit_rate_in

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
GOOD = {
    "/proc/sys/kernel/version": "#1 SMP PREEMPT_RT Debian 6.1",
    "/proc/sys/kernel/osrelease": "6.1.0-rt",
    "/proc/sys/kernel/sched_rt_runtime_us": "950000",
    "/proc/sys/kernel/sched_rt_period_us": "1000000",
    "/proc/self/status": "Name:\tpython\nUid:\t54321\t54321\t54321\t54321\n"
    "Gid:\t54321\t54321\t54321\t54321\nGroups:\t54321 54322 \nCapEff:\t0000000000000000\n",
    "/proc/self/limits": "Limit                     Soft Limit           Hard Limit\n"
    "Max realtime priority     80                   80\n"
    "Max locked memory         unlimited            unlimited            bytes\n",
    "/proc/swaps": "Filename Type Size Used Priority\n",
    "/etc/passwd": "root:x:0:0::/:/bin/sh\npi:x:54321:54321::/home/pi:/bin/sh\n",
    "/run/systemd/timesync/synchronized": "",
    "/sys/devices/system/cpu/isolated": "3",
    "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance",
}


@pytest.fixture
def plant(tmp_path):
    """Return a function that plants the files of a good machine, but for `changes`: path → text;
    None: there is no such file."""

    def planted(changes=None, **options):
        for name, text in (GOOD | (changes or {})).items():
            path = tmp_path / name.lstrip("/")
            path.parent.mkdir(parents=True, exist_ok=True)
            if text is None:
                path.unlink(missing_ok=True)
            else:
                path.write_text(text)
        return Root(tmp_path, **options)

    return planted


def by_check(findings):
    return {finding.check: finding for finding in findings}


def test_a_good_machine_is_all_ok(plant):
    found = list(machine.look(plant()))
    assert {finding.verdict for finding in found} == {"ok"}
    assert not any(finding.mend or finding.fixes for finding in found)


def test_an_empty_machine_is_no_error(tmp_path):
    for finding in machine.look(Root(tmp_path)):
        assert finding.verdict in ("ok", "warn")


def test_this_machine_is_no_error():
    assert "kernel" in by_check(machine.look(Root()))


GOVERNOR = "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"
THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"


@pytest.mark.parametrize(
    ("changes", "check", "verdict", "text", "mend"),
    [
        ({"/proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC"}, "kernel", "warn",
         "without PREEMPT_RT", "linux-image-rt"),
        ({GOVERNOR: "powersave"}, "governor", "warn", "powersave on 1 of 1", "scaling_governor"),
        ({"/proc/self/limits": "Max realtime priority     0      0\n"}, "real-time limits", "warn",
         "rtprio is 0", "echo 'pi - rtprio 80'"),
        ({"/proc/sys/kernel/sched_rt_runtime_us": "0"}, "real-time limits", "fail",
         "no real-time threads", "sysctl"),
        ({"/proc/sys/kernel/sched_rt_runtime_us": "100000"}, "RT throttling", "warn", "10%",
         "sysctl"),
        ({"/proc/swaps": "Filename\n/dev/sda2 partition 1 0 -2\n",
          "/proc/self/limits": "Max realtime priority 80 80\nMax locked memory  65536 65536\n"},
         "swap", "warn", "memlock 65536", "memlock unlimited"),
        ({"/run/systemd/timesync/synchronized": None}, "clock", "warn", "not synchronised",
         "timedatectl"),
        ({THROTTLED: "50005"}, "supply", "fail", "under-voltage", "supply"),
        ({THROTTLED: "50000"}, "supply", "warn", "since the start", "supply"),
        ({"/sys/class/hwmon/hwmon1/name": "rpi_volt",
          "/sys/class/hwmon/hwmon1/in0_lcrit_alarm": "1"}, "supply", "fail", "under-voltage",
         "supply"),
        ({"/etc/nvpmodel.conf": "< POWER_MODEL ID=0 NAME=15W >\n< POWER_MODEL ID=2 NAME=MAXN >",
          "/var/lib/nvpmodel/status": "pmode:0000"}, "power mode", "warn", "15W",
         "sudo nvpmodel -m 2"),
    ],
)  # fmt: skip
def test_each_fault_of_the_machine_comes_with_its_mend(plant, changes, check, verdict, text, mend):
    finding = by_check(machine.look(plant(changes)))[check]
    assert finding.verdict == verdict
    assert text in finding.text
    assert mend in finding.mend


def test_a_device_without_write_permission_is_found(plant):
    root = plant({"/dev/cpu_dma_latency": ""})
    root.path("/dev/cpu_dma_latency").chmod(0o600)
    found = by_check(machine.look(root))["cpu_dma_latency"]
    assert (found.verdict, "udev" in found.mend) == ("warn", True)


def test_the_governor_is_mended_by_writing_it(plant):
    root = plant({GOVERNOR: "powersave"})
    for fix in by_check(machine.look(root))["governor"].fixes:
        assert fix.apply() == ""
    assert by_check(machine.look(root))["governor"].verdict == "ok"


def test_a_mend_that_fails_gives_its_reason():
    assert Run(words=("false",)).apply() == "exit 1"
    assert "no-such-program" in Run(words=("no-such-program-here",)).apply()


# ----------------------------------------------------------------------------------- serial devices
@pytest.fixture
def serial(plant):
    """Return a function that plants the demo robot's port, which this user may use."""

    def planted(changes=None, mode=0o666, port="/dev/ttyUSB0"):
        root = plant({"/dev/ttyUSB0": "", **(changes or {})})
        root.path("/dev/ttyUSB0").chmod(mode)
        robot = load_robot(ROBOTS / "demo.toml", [f"line.rs485.port={port}"])
        return root, list(devices.look(root, robot))

    return planted


def test_a_port_whose_group_is_missing_names_the_group(serial):
    gid = os.getegid()
    _, found = serial({"/etc/group": f"dialout:x:{gid}:pi\n"}, mode=0o660)
    (finding,) = found
    assert finding.verdict == "fail"
    assert "pi may not open /dev/ttyUSB0" in finding.text
    assert finding.mend.startswith("sudo usermod -aG dialout pi")


def test_a_slow_latency_timer_is_found_and_mended(serial):
    timer = "/sys/class/tty/ttyUSB0/device/latency_timer"
    root, found = serial({timer: "16"})
    finding = by_check(found)["ttyUSB0 latency timer"]
    assert (finding.verdict, "16 ms" in finding.text) == ("warn", True)
    assert "latency_timer" in finding.mend
    assert [fix.apply() for fix in finding.fixes] == [""]
    assert root.text(timer) == "1"


def test_without_a_robot_file_the_timer_of_every_adapter_is_looked_at(plant):
    root = plant({"/sys/class/tty/ttyUSB3/device/latency_timer": "16"})
    assert by_check(devices.look(root, None))["ttyUSB3 latency timer"].verdict == "warn"


def test_a_second_program_on_the_port_is_named(plant):
    root = plant({"/dev/ttyUSB0": "", "/proc/4242/comm": "minicom\n"})
    port = root.path("/dev/ttyUSB0")
    port.chmod(0o666)
    fds = root.path("/proc/4242/fd")
    fds.mkdir()
    (fds / "3").symlink_to(os.path.realpath(port))
    robot = load_robot(ROBOTS / "demo.toml", ["line.rs485.port=/dev/ttyUSB0"])
    finding = by_check(devices.look(root, robot))["line.rs485"]
    assert (finding.verdict, finding.mend) == ("fail", "end it: kill 4242")
    assert "minicom (pid 4242)" in finding.text
    assert by_check(devices.look(root, robot, [4242]))["line.rs485"].verdict != "fail"


def test_a_missing_port_and_a_name_that_may_change_are_found(serial, plant):
    _, found = serial()
    assert by_check(found)["line.rs485"].verdict == "warn"
    assert "by-id" in by_check(found)["line.rs485"].mend
    robot = load_robot(ROBOTS / "demo.toml", ["line.rs485.port=/dev/ttyNone"])
    finding = by_check(devices.look(plant(), robot))["line.rs485"]
    assert (finding.verdict, "does not exist" in finding.text) == ("fail", True)


# ---------------------------------------------------------------------------------------------- CAN
def link_answer(bitrate):
    """Return the kernel's answer to RTM_GETLINK for a CAN interface (linux/can/netlink.h)."""

    def attribute(kind, payload):
        return struct.pack("=HH", 4 + len(payload), kind) + payload + bytes(-len(payload) % 4)

    timing = attribute(1, struct.pack("=8I", bitrate, 875, 125, 6, 7, 2, 1, 5))
    data = attribute(4, struct.pack("=I", 0)) + timing
    info = attribute(18, attribute(1, b"can\0") + attribute(2, data))
    body = struct.pack("=BxHiII", 0, 280, 3, 0x1, 0) + info
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 1, 0) + body


CAN = load_robot(ROBOTS / "odrive-two.toml", ["line.can0.interface=socketcan"])
CHANNEL, BITRATE = CAN.line["can0"].channel, CAN.line["can0"].bitrate


def can_finding(plant, flags, bitrate):
    root = plant(
        {f"/sys/class/net/{CHANNEL}/flags": flags},
        ask_bit_rate=lambda _: None if bitrate is None else bit_rate_in(link_answer(bitrate)),
    )
    return by_check(devices.look(root, CAN))["line.can0"]


def test_a_can_interface_that_is_down_is_set_up_with_the_files_bit_rate(plant):
    finding = can_finding(plant, "0x80", BITRATE)
    assert (finding.verdict, "is down" in finding.text) == ("fail", True)
    assert f"{CHANNEL} up type can bitrate {BITRATE}" in finding.mend
    assert [str(fix) for fix in finding.fixes] == [finding.mend]


def test_a_wrong_bit_rate_is_found_and_not_changed_by_itself(plant):
    finding = can_finding(plant, "0x81", BITRATE // 2)
    assert (finding.verdict, finding.fixes) == ("fail", ())
    assert f"{BITRATE // 2} bit/s" in finding.text
    assert f"bitrate {BITRATE}" in finding.mend


def test_a_can_interface_with_the_files_bit_rate_or_without_any_is_ok(plant):
    assert can_finding(plant, "0x81", BITRATE).verdict == "ok"
    assert can_finding(plant, "0x81", None).verdict == "ok"
    assert can_finding(plant, None, None).verdict == "fail"


# ---------------------------------------------------------------------------------------------- PWM
def test_a_pwm_chip_that_is_not_there_comes_with_the_overlay_of_this_board(plant):
    root = plant({"/proc/device-tree/compatible": "raspberrypi,4-model-b\0brcm,bcm2711"})
    robot = load_robot(ROBOTS / "pi4-encoders.toml")
    finding = next(each for each in devices.look(root, robot) if each.group == "device")
    assert finding.verdict == "fail"
    assert "dtoverlay=pwm-2chan" in finding.mend


PI4 = "raspberrypi,4-model-b\0brcm,bcm2711"
PWM_DEVICE = "/sys/devices/platform/soc/fe20c000.pwm"
PWM_CHIP = f"{PWM_DEVICE}/pwm/pwmchip0"
PINMUX = "/sys/kernel/debug/pinctrl/fe200000.gpio-pinctrl-bcm2711/pinmux-pins"


@pytest.fixture
def pi4(plant):
    """Return a function that plants a Raspberry Pi 4 with its PWM chip, and with `rows` in the
    kernel's table of pins."""

    def planted(*rows, npwm="2"):
        table = "Format: pin (name): mux_owner gpio_owner hog?\n" + "\n".join(rows)
        root = plant({"/proc/device-tree/compatible": PI4, f"{PWM_CHIP}/npwm": npwm, PINMUX: table})
        link = root.path("/sys/class/pwm/pwmchip0")
        link.parent.mkdir(parents=True)
        link.symlink_to(root.path(PWM_CHIP))
        root.path(f"{PWM_CHIP}/device").symlink_to(root.path(PWM_DEVICE))
        return root

    return planted


def on_pi4(root):
    robot = load_robot(ROBOTS / "pi4-encoders.toml")
    return {each.check: each for each in devices.look(root, robot) if each.group == "device"}


def given(*pins):
    return [
        f"pin {pin} (gpio{pin}): fe20c000.pwm (GPIO UNCLAIMED) function alt0 group gpio{pin}"
        for pin in pins
    ]


def test_pwm_channels_that_pins_carry_are_ok(pi4):
    found = on_pi4(pi4(*given(12, 13)))
    assert [(check, one.verdict) for check, one in found.items()] == [("line.pins", "ok")]
    assert "carries pwm0, pwm1" in found["line.pins"].text


def test_a_channel_that_no_pin_carries_comes_with_the_overlay(pi4):
    free = "pin 13 (gpio13): (MUX UNCLAIMED) (GPIO UNCLAIMED)"
    found = on_pi4(pi4(*given(12), free))["line.pins"]
    assert found.verdict == "fail"
    assert "no pin to pwm1 of fe20c000.pwm" in found.text
    assert "dtoverlay=pwm-2chan,pin=12,func=4,pin2=13,func2=4" in found.mend


def test_a_chip_with_too_few_channels_is_named(pi4):
    found = on_pi4(pi4(*given(12, 13), npwm="1"))["line.pins"]
    assert (found.verdict, "has 1 channels, and no pwm1" in found.text) == ("fail", True)


def test_a_pin_that_another_device_has_is_named_with_what_frees_it(pi4):
    spi = "pin 5 (gpio5): spi0.0 (GPIO UNCLAIMED) function alt0 group gpio5"
    free = "pin 6 (gpio6): (MUX UNCLAIMED) gpiochip0:6"
    found = on_pi4(pi4(*given(12, 13), spi, free))
    assert found["line.pins GPIO5"].verdict == "fail"
    assert "belongs to spi0.0" in found["line.pins GPIO5"].text
    assert "dtparam=spi=off" in found["line.pins GPIO5"].mend
    assert "line.pins GPIO6" not in found


# --------------------------------------------------------------------------------------- heartbeats
def answer(ticks, cycles=0, **changes):
    joint = {
        "drive": "ready", "fault_words": [], "position_rad": 1.0, "velocity_rad_s": 0.0,
        "voltage_v": 24.0, "temperature_c": 30.0, "feedback_age_s": 0.01,
    }  # fmt: skip
    line = {
        "state": "ready", "port": "/dev/ttyUSB0", "engine": "rt", "exchanges": 1000,
        "cycles": cycles, "errors": {}, "cycle_hz": 50.0, "waits_for": None,
    }  # fmt: skip
    return Status.of(
        {
            "robot": "demo", "pid": 77, "state": "idle", "joints": {"left": joint},
            "lines": {"rs485": line}, "loop": {"rate_hz": 100.0, "ticks": ticks},
            "odometry": {"age_s": 0.01}, "stalls": {}, **changes,
        }
    )  # fmt: skip


def judged(root, *answers, period_s=1.0):
    looks = [Look(number * period_s, found) for number, found in enumerate(answers)]
    return by_check(heartbeats.judge(root, looks))


THREADS = {
    "/proc/77/stat": "77 (motord) S 1 77",
    "/proc/77/task/77/comm": "python",
    "/proc/77/task/78/comm": "motord-loop",
    "/proc/77/task/79/comm": "motord-line",
}


def test_a_daemon_that_is_well_has_five_heartbeats(plant):
    found = judged(plant(THREADS), answer(0, 0), answer(100, 50), answer(200, 100))
    assert {finding.verdict for finding in found.values()} == {"ok"}
    assert {check[0] for check in found if check[0].isdigit()} == {"1", "2", "3", "4", "5"}


JOINT = answer(0)["joints"]["left"]
LINE = answer(0)["lines"]["rs485"]


@pytest.mark.parametrize(
    ("changes", "check", "verdict", "text"),
    [
        ({"joints": {"left": {**JOINT, "drive": "unresponsive"}}}, "joint left", "fail",
         "does not answer"),
        ({"joints": {"left": {**JOINT, "fault_words": ["over-current"]}}}, "joint left", "fail",
         "over-current"),
        ({"joints": {"left": {**JOINT, "feedback_age_s": None}}}, "2 topics", "fail", "joint left"),
        ({"joints": {"left": {**JOINT, "position_rad": 0.0, "voltage_v": 0.0,
                              "temperature_c": 0.0}}}, "4 values of left", "warn", "plausible"),
        ({"joints": {"left": {**JOINT, "position_rad": 0.0, "voltage_v": None, "current_a": 0.0,
                              "temperature_c": 0.0}}}, "4 values of left", "warn", "all are zero"),
        ({"lines": {"rs485": {**LINE, "state": "closed", "waits_for": "no such port"}}},
         "line rs485", "fail", "no such port"),
        ({"lines": {"rs485": {**LINE, "errors": {"timeout": 500}}}}, "line rs485", "warn",
         "500 timeout"),
        ({"bus": {"pid": None}}, "2 topics", "fail", "motord-bus"),
        ({"state": "fault", "why": ["left: gone"]}, "state", "fail", "left: gone"),
        ({"stalls": {"the loop": 2}}, "1 process and threads", "warn", "the loop 2 times"),
    ],
)  # fmt: skip
def test_each_fault_of_a_daemon_is_named(plant, changes, check, verdict, text):
    found = judged(plant(THREADS), answer(0), answer(100, 50, **changes))[check]
    assert found.verdict == verdict
    assert text in found.text


def test_a_rate_that_is_off_by_more_than_five_per_cent_is_found(plant):
    found = judged(plant(THREADS), answer(0, 0), answer(100, 50), answer(180, 80))
    assert found["3 rate of loop"].verdict == "warn"
    assert found["3 rate of line rs485"].verdict == "warn"


def publishing(taken, at_s=None):
    """Return a status with the counts of a publisher of 50 Hz; with `at_s`, it is a publisher of
    motord-bus, which reported them then."""
    counted = {"taken": taken, "dropped": 0, "topics": {"odom": {"rate_hz": 50.0, "taken": taken}}}
    if at_s is None:
        return {"publishers": {"console": counted}}
    return {"bus": {"pid": 9, "at_s": at_s, "publishers": {"ros2": counted}}}


@pytest.mark.parametrize(
    ("taken", "verdict"),
    [(100, "ok"), (96, "ok"), (80, "warn"), (130, "warn"), (0, "fail")],
)
def test_the_rate_of_each_topic_is_compared_with_the_robot_files(plant, taken, verdict):
    first, last = publishing(1000), publishing(1000 + taken)
    found = judged(plant(THREADS), answer(0, **first), answer(100, **first), answer(200, **last))
    assert found["3 rate of console/odom"].verdict == verdict
    first, last = publishing(1000, 5.0), publishing(1000 + taken, 7.0)
    found = judged(plant(THREADS), answer(0, **first), answer(100, **last))
    assert found["3 rate of ros2/odom"].verdict == verdict


def test_a_topic_without_any_message_is_named(plant):
    found = judged(plant(THREADS), answer(0, **publishing(0)), answer(100, **publishing(0)))
    assert found["3 rate of console/odom"].verdict == "warn"
    assert "has had no message" in found["3 rate of console/odom"].text


def test_a_bus_that_has_reported_once_or_has_started_again_is_not_judged(plant):
    once = publishing(10, 5.0)
    found = judged(plant(THREADS), answer(0, **once), answer(100, **once))
    assert not [check for check in found if "ros2" in check]
    later = {"bus": {"pid": 9, "at_s": 6.0, "publishers": {}}}
    found = judged(plant(THREADS), answer(0, **once), answer(100, **later))
    assert not [check for check in found if "ros2" in check]


def test_a_loop_that_stands_still_and_a_thread_that_is_missing_are_found(plant):
    still = judged(plant(THREADS), answer(5), answer(5))
    assert "stands still" in still["1 process and threads"].text
    assert still["3 rate of loop"].verdict == "fail"
    missing = THREADS | {"/proc/77/task/79/comm": "python"}
    found = judged(plant(missing), answer(0), answer(100, 50))["1 process and threads"]
    assert (found.verdict, "missing" in found.text) == ("fail", True)
