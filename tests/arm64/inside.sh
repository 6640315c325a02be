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
make -C tests/c plain
.venv/bin/python -m pytest -q -n 2 --dist loadfile "$@"
