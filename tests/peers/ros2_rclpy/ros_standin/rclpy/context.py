# SPDX-License-Identifier: Apache-2.0
"""Start and end of ROS 2 in a process, and the values of --ros-args."""

import itertools
import json


class Context:
    def __init__(self):
        self._ok = False
        self.remaps, self.parameters, self.on_shutdown_calls = {}, {}, []
        self.topics = {}

    def init(self, args):
        assert not self._ok, "twice"
        self._ok = True
        given = iter(itertools.dropwhile(lambda word: word != "--ros-args", args))
        for word in given:
            if word in ("-r", "--remap"):
                old, _, new = next(given).partition(":=")
                self.remaps[old] = new
            elif word in ("-p", "--param"):
                name, _, value = next(given).partition(":=")
                self.parameters[name] = _value(value)
            elif word == "--params-file":
                self.parameters |= _of_file(next(given))
            else:
                assert word == "--ros-args", f"unknown: {word}"

    def ok(self):
        return self._ok

    def on_shutdown(self, call):
        self.on_shutdown_calls.append(call)

    def shutdown(self):
        assert self._ok, "not begun"
        self.try_shutdown()

    def try_shutdown(self):
        self._ok = False
        for call in self.on_shutdown_calls:
            call()


def _value(text):
    """Read a YAML scalar."""
    try:
        return json.loads(text)
    except ValueError:
        return text.strip("'\"")


def _of_file(path):
    """Read the parameters for all nodes (`/**`) of a file, not those for single nodes."""
    from ruamel.yaml import YAML

    with open(path, encoding="utf-8") as file:
        found = YAML(typ="safe").load(file)["/**"]["ros__parameters"]
    return dict(_flat("", found))


def _flat(prefix, mapping):
    for key, value in mapping.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value


default_context = Context()
