#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Prints the Python to build with. Where a system package is missing: names all of them in one apt
# line, and stops.
set -u

python=
for candidate in python3 python3.14 python3.13 python3.12 python3.11; do
    if command -v "$candidate" >/dev/null 2>&1 &&
        "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
        python=$candidate
        break
    fi
done

missing=
if [ -z "$python" ]; then
    # Ubuntu 22.04's python3 is 3.10; its archive has 3.11 beside it.
    if command -v python3 >/dev/null 2>&1; then
        missing="python3.11 python3.11-venv python3.11-dev"
    else
        missing="python3 python3-venv python3-dev"
    fi
else
    # A distribution's package is named after the minor version; python3-* is the one that `python3`
    # itself needs.
    package=$python
    "$python" -c 'import ensurepip, venv' 2>/dev/null || missing="$missing $package-venv"
    "$python" - <<'END' || missing="$missing $package-dev"
import pathlib, sys, sysconfig
sys.exit(not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").exists())
END
fi
command -v gcc >/dev/null 2>&1 || missing="$missing gcc"
# gcc only recommends the C library's headers.
if ! command -v gcc >/dev/null 2>&1 ||
    ! echo '#include <math.h>' | gcc -fsyntax-only -x c - 2>/dev/null; then
    missing="$missing libc6-dev"
fi

if [ -n "$missing" ]; then
    # shellcheck disable=SC2086  # the list is words
    echo "motord needs packages that are not here. Install them, then try again:" >&2
    echo "    sudo apt install" $missing >&2
    exit 1
fi
echo "$python"
