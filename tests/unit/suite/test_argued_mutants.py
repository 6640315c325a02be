# SPDX-License-Identifier: Apache-2.0
"""Arguments for mutants that no test can kill: tests/c/mutants.toml."""

import tomllib

import pytest
from tests.c.mutants import CSRC, HERE, mutants

ARGUED = tomllib.loads((HERE / "mutants.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ARGUED)
def test_each_argument_is_about_a_mutant_of_its_file(name):
    (path,) = CSRC.rglob(name)
    whats = {mutant.what for mutant in mutants(path.read_text(encoding="utf-8"))}
    assert [what for what in ARGUED[name] if what not in whats] == []
