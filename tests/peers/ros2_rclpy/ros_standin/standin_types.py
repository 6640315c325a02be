# SPDX-License-Identifier: Apache-2.0
"""Packages of ROS 2 types for the stand-in, made from motord's own definitions: a class with its
fields for each message, one with Request and Response for each service, and one with the parts that
ROS 2 generates for each action."""

import importlib.abc
import importlib.util
import sys
from types import SimpleNamespace

from motord.bus.messages.table import PLACEHOLDER, TYPES

_ZERO = {"string": "", "bool": False, "float64": 0.0, "float32": 0.0}
_made = {}


def _value(field):
    if field.sequence:
        return []
    one = _ZERO.get(field.kind, 0) if field.primitive else message(field.kind)()
    return one if field.count is None else [one] * field.count


def message(kind):
    """Return the class of a message by the full name of its type."""
    if kind not in _made:
        fields = [field for field in TYPES[kind] if field.name != PLACEHOLDER]

        def __init__(self, **values):  # noqa: N807
            unknown = set(values) - {field.name for field in fields}
            assert not unknown, f"{kind} has no {unknown}"
            SimpleNamespace.__init__(self, **{f.name: _value(f) for f in fields} | values)
            if not fields:
                setattr(self, PLACEHOLDER, 0)

        _made[kind] = type(kind.split("/")[-1], (SimpleNamespace,),
                           {"__init__": __init__, "KIND": kind})  # fmt: skip
    return _made[kind]


def _service(kind):
    parts = {"Request": message(f"{kind}_Request"), "Response": message(f"{kind}_Response")}
    return type(kind.split("/")[-1], (), {**parts, "KIND": kind})


def _action(kind):
    impl = type("Impl", (), {
        "SendGoalService": _service(f"{kind}_SendGoal"),
        "GetResultService": _service(f"{kind}_GetResult"),
        "FeedbackMessage": message(f"{kind}_FeedbackMessage"),
    })  # fmt: skip
    parts = {part: message(f"{kind}_{part}") for part in ("Goal", "Result", "Feedback")}
    return type(kind.split("/")[-1], (), {**parts, "Impl": impl})


def _names(package, group):
    ends = {"msg": "", "srv": "_Request", "action": "_Goal"}[group]
    for kind in TYPES:
        of, below, short = kind.split("/")
        if (of, below) == (package, group) and short.endswith(ends):
            yield short.removesuffix(ends), f"{package}/{group}/{short.removesuffix(ends)}"


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self, without):
        self._packages = {kind.split("/")[0] for kind in TYPES} - set(without)

    def find_spec(self, name, path=None, target=None):
        package, _, group = name.partition(".")
        if package in self._packages and group in ("", "msg", "srv", "action"):
            return importlib.util.spec_from_loader(name, self, is_package=not group)
        return None

    def create_module(self, spec):
        return None

    def exec_module(self, module):
        package, _, group = module.__name__.partition(".")
        make = {"msg": message, "srv": _service, "action": _action}.get(group)
        for short, kind in _names(package, group) if make else ():
            setattr(module, short, make(kind))


def install(without=()):
    """Make the packages importable, but for those in `without`."""
    finder = _Finder(without)
    sys.meta_path.append(finder)
    return finder
