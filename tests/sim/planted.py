# SPDX-License-Identifier: Apache-2.0
"""Adapters of another package, as an installed one offers them by its entry points."""


def planted(folder, name, code, *, group="motord.publishers"):
    """A package of that name whose class Adapter is offered under it. Returns settings of a section
    of the robot file that chooses it, and the environment in which it is found."""
    (folder / f"{name}.py").write_text(code, encoding="ascii")
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Name: {name}\nVersion: 1.0\n", encoding="ascii")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {name}:Adapter\n", "ascii")
    table = "publish" if group == "motord.publishers" else "input"
    where = f"{table}.{name}"
    return (f"{where}.kind=other", f"{where}.adapter={name}"), {"PYTHONPATH": str(folder)}
