#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Run in the guest by run.sh: everything comes from /wheels and /motord.
set -euo pipefail
uname -m
cd /motord
python3 -m venv --clear .venv
pip() { .venv/bin/python -m pip "$@"; }
pip install --quiet --no-index --find-links /wheels 'setuptools>=77' wheel cffi
pip wheel --quiet --no-index --find-links /wheels --no-deps --no-build-isolation --wheel-dir dist .
ls dist
pip install --quiet --no-index --find-links /wheels --no-build-isolation --editable '.[test]'
make -j 2 -C tests/c plain
# QEMU 7.2 has no termios2 (any baud rate of a port: ioctl_tty(2)), causes page faults of its own in
# our threads, differs from the kernel in scheduling and capabilities, and gives the kernel twice
# the buffer for ancillary data that recvmsg(2) was called with: too many descriptors fit in.
not_emulated=(
    tests/unit/fieldbus/test_serial_port.py
    tests/rt/loop/test_loop_kernel.py
    tests/rt/loop/test_loop_stop_requests.py::test_descriptors_sent_with_a_request_are_not_kept
    tests/rt/loop/test_loop.py::test_python_that_starts_processes_costs_the_thread_no_page_fault
)
.venv/bin/python -m pytest -q -n 2 --dist loadfile -o timeout=900 \
    "${not_emulated[@]/#/--deselect=}" "$@"
