# SPDX-License-Identifier: Apache-2.0
# make demo, make test: from a fresh checkout, nothing else. make's own work goes to stderr; stdout
# is the program's.

VENV := .venv
PYTHON := $(VENV)/bin/python
# The packages of a distribution may carry flags of their own; a checkout builds with ours.
unexport CFLAGS LDFLAGS
MAKEFLAGS += --no-print-directory
ARGS ?=

.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-fast check san bench soak fuzz mutants coverage wheel deb vm \
	roots arm64 walk clean

help:
	@echo "make demo      drive a simulated robot         make demo ARGS=\"--json --seconds 20\"" >&2
	@echo "make test      all but the long tests: 8 min   make test ARGS=\"tests/unit -k wrap\"" >&2
	@echo "make test-all  the long ones, too: 25 min      make test-fast  the inner loop: a minute" >&2
	@echo "make check     format, lint, types, imports    make san    sanitizers" >&2
	@echo "make coverage  the tests, and what they miss   make bench  the wire, rivals, latency \
	(ARGS=--quick, --smoke)" >&2
	@echo "make soak      faults on a moving robot        make soak ARGS=\"--faults 500 --seed 7\"" >&2
	@echo "make fuzz      C, guard, files, recordings      make fuzz RUNS=1000000 SEED=7" >&2
	@echo "make mutants   are the C tests good?           make mutants FILE=\"arbiter.c page.c\" \
	SAMPLE=50" >&2
	@echo "make wheel     a wheel in dist/                make deb    a Debian package in dist/" >&2
	@echo "make vm        real kernel drivers in QEMU     make vm ARGS=\"-k unplugged\" \
	(root, Debian 12)" >&2
	@echo "make roots     demo and test in bare systems   make roots ARGS=\"--demo trixie\" \
	(root)" >&2
	@echo "make arm64     unit, rt and C tests on aarch64 (root, Debian 12)" >&2
	@echo "make walk      record docs/first-drive.md on simulated drives" >&2
	@echo "make clean     all that make made" >&2

# -------------------------------------------------------------------------------------- environment
# Without csrc, which is compiled once, by $(VENV)/built.
INSTALL = MOTORD_COMPILED=1 $(PYTHON) -m pip install --quiet --disable-pip-version-check \
	--no-build-isolation --editable

$(VENV)/made: pyproject.toml setup.py bootstrap.sh
	@echo "making $(VENV) ..." >&2
	@python=$$(./bootstrap.sh) && $$python -m venv --clear $(VENV) >&2
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check "setuptools>=77" "cffi>=2.0" >&2
	@$(INSTALL) '.[plot,tui]' >&2
	@touch $@

$(VENV)/built: $(VENV)/made $(shell find csrc -name '*.[ch]' -o -name '*.py')
	@echo "compiling csrc ..." >&2
	@$(PYTHON) csrc/build_api.py
	@$(PYTHON) setup.py --quiet build_ext --inplace >&2
	@touch $@

$(VENV)/test: $(VENV)/made
	@$(INSTALL) '.[test]' >&2
	@touch $@

$(VENV)/check: $(VENV)/made
	@$(INSTALL) '.[test,check]' >&2
	@touch $@

# The tests are compiled here once, not once in each of the workers.
$(VENV)/collected: $(VENV)/test | $(VENV)/built
	@-$(PYTHON) -m pytest --collect-only -qq >/dev/null
	@touch $@

# A real rclpy for tests/peers with motord_msgs, in an environment of its own: ros-kilted,
# ros-jazzy.
build/ros-%/made: tests/peers/ros2_rclpy/ros-%.txt tests/peers/ros2_rclpy/make_motord_msgs.py \
	| $(VENV)/built
	@echo "making build/ros-$* ..." >&2
	@$(PYTHON) -m venv --clear build/ros-$* >&2
	@build/ros-$*/bin/python -m pip install --quiet --disable-pip-version-check -r $< >&2
	@MOTORD_ROS= $(PYTHON) -m tests.peers.ros2_rclpy.make_motord_msgs build/ros-$* >&2
	@touch $@

# ---------------------------------------------------------------------------------- what people run
demo: $(VENV)/built
	@$(VENV)/bin/motord demo $(ARGS)

# More workers than processors: most tests wait for simulated motors.
WORKERS ?= 9
PYTEST = $(PYTHON) -m pytest -n $(WORKERS) --dist loadgroup
LEFT_OUT = Left out: long tests, and those with other programs. make test-all runs them, too.
test: $(VENV)/built $(VENV)/test $(VENV)/collected
	@$(PYTEST) --without-long $(ARGS)
	$(if $(ARGS),,@echo "$(LEFT_OUT)" >&2)

# Also the tests marked `long`, and those with programs of others: tests/conftest.py. They need more
# of the processors than the rest: more workers would make two slow ones late, and tests run again.
test-all: WORKERS = 8
test-all: $(VENV)/built $(VENV)/test $(VENV)/collected
	@$(PYTEST) $(ARGS)

# For the inner loop: no other process, no simulated robot, no test of the suite itself.
test-fast: $(VENV)/built $(VENV)/test
	@FAST=1 $(PYTHON) -m pytest -q -n 4 --dist loadgroup tests/unit --ignore tests/unit/suite $(ARGS)

check: $(VENV)/built $(VENV)/check
	@$(VENV)/bin/ruff format --check . >&2
	@$(VENV)/bin/ruff check . >&2
	@$(VENV)/bin/mypy >&2
	@$(VENV)/bin/lint-imports --no-logo >&2
	@$(PYTHON) csrc/build_api.py --check
	@$(VENV)/bin/clang-format --dry-run --Werror $(shell find csrc docs tests -name '*.[ch]') >&2
	@$(VENV)/bin/cppcheck -q -j2 --std=c11 -D_GNU_SOURCE --enable=warning,portability,performance \
		--error-exitcode=1 $(addprefix -I,$(shell find csrc -type d)) csrc >&2
	@$(MAKE) -C tests/c warnings >&2
	@$(PYTHON) -m pytest -q -p no:randomly tests/test_tidy.py

# UBSan under Python (an ASan or TSan library cannot be loaded into it); ASan and TSan in C programs
# of their own.
san: $(VENV)/built $(VENV)/test
	@$(MAKE) -j 2 -C tests/c asan tsan >&2
	@rm -rf build/ubsan && mkdir -p build/ubsan
	@MOTORD_CFLAGS="-fsanitize=undefined -fno-sanitize-recover=undefined -g" \
		MOTORD_LDFLAGS="-fsanitize=undefined" \
		$(PYTHON) setup.py --quiet build_ext --build-lib build/ubsan --build-temp build/ubsan/temp >&2
	@MOTORD_RT_DIR=build/ubsan $(PYTHON) -m pytest -q -n 2 --dist loadgroup tests/rt

# Python lines by coverage.py, also in the processes that the tests start; lines and branches of
# each C file by gcov, against tests/c/coverage.toml.
coverage: $(VENV)/built $(VENV)/test
	@$(MAKE) -C tests/c coverage PYTHON=$(abspath $(PYTHON)) >&2
	@rm -f .coverage .coverage.*
	@$(PYTHON) -m coverage run -m pytest -q -n 4 --dist loadgroup $(ARGS)
	@$(PYTHON) -m coverage combine --quiet
	@$(PYTHON) -m coverage report

$(VENV)/bench: $(VENV)/made
	@$(INSTALL) '.[test,bench]' >&2
	@touch $@

walk: $(VENV)/built $(VENV)/test
	@$(PYTHON) -m tests.walk

bench: $(VENV)/built $(VENV)/bench
	@$(PYTHON) -m tests.bench.run $(ARGS)

soak: $(VENV)/built $(VENV)/test
	@$(PYTHON) tests/soak/soak.py $(ARGS)

# C from gcc alone, with ASan and UBSan; then what is written in Python, with a thousandth of the
# runs.
RUNS ?= 10000000
fuzz: $(VENV)/built $(VENV)/test
	@$(MAKE) -C tests/c fuzz RUNS=$(RUNS) >&2
	@$(PYTHON) tests/fuzz/fuzz.py --runs $$(( $(RUNS) / 1000 )) \
		$(if $(SEED),--seed $(SEED)) $(ARGS) >&2

mutants: $(VENV)/made
	@$(MAKE) -C tests/c mutants PYTHON=$(abspath $(PYTHON)) >&2

wheel: $(VENV)/made
	@$(PYTHON) -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist . >&2
	@ls dist/*.whl

deb: $(VENV)/built
	@mkdir -p dist && cp "$$(systemd/deb.sh build/deb)" dist/ && ls dist/*.deb

# Builds the guest, boots it once, runs tests/vm/guest there; or prints why it cannot, and succeeds.
vm: $(VENV)/built
	@$(PYTHON) tests/vm/run.py $(ARGS)

# The README's commands in bare roots of Debian 12 and 13; or a reason, and success.
roots:
	@tests/roots.sh $(ARGS)

# tests/unit, tests/rt and tests/c on aarch64, by QEMU.
arm64: $(VENV)/made
	@tests/arm64/run.sh $(ARGS)

clean:
	@rm -rf $(VENV) build dist *.egg-info _motord_rt* _motord_bus* .coverage .coverage.* \
		.mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
