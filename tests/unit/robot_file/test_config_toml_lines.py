# SPDX-License-Identifier: Apache-2.0
"""The line of every key, tested on documents in which each number is the number of its own line."""

import json
import tomllib

from hypothesis import given
from hypothesis import strategies as st

from motord.config.toml_lines import line_of, lines_of

KEYS = st.one_of(
    st.sampled_from(["a", "b", "c-d", "e_f", "1", "true", "inf", "2024-01-01"]),
    st.text(st.characters(codec="utf-8", exclude_categories=("C",)), max_size=4),
)
TEXTS = st.text(st.sampled_from("ab \"'#[]{}=,.\\\n\té"), max_size=8)
LEAVES = st.one_of(st.none(), TEXTS)  # None: Writer writes the number of the line
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=12,
)
DOCUMENTS = st.dictionaries(KEYS, VALUES, max_size=5)


class Writer:
    """Writes data as TOML in one of its many forms; `choose` picks the form."""

    def __init__(self, choose):
        self.choose = choose
        self.text = ""

    def write(self, text):
        self.text += text

    def key(self, name):
        bare = name.isascii() and name.replace("-", "").replace("_", "").isalnum()
        forms = [json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")]
        forms += [name] if bare else []
        forms += [f"'{name}'"] if "'" not in name else []
        return self.choose(forms)

    def dotted(self, path):
        return self.choose([".", " . "]).join(self.key(name) for name in path)

    def scalar(self, value):
        if value is None:
            return str(self.text.count("\n") + 1)
        forms = [json.dumps(value, ensure_ascii=False)]
        basic = value.replace("\\", "\\\\").replace('"""', '""\\"')
        forms.append(f'"""\n{basic}"""')
        if "'''" not in value:
            forms.append(f"'''\n{value}'''")
        return self.choose(forms)

    def value(self, value):
        if isinstance(value, dict):
            self.write("{")
            for index, (name, inner) in enumerate(value.items()):
                self.write(", " if index else " ")
                self.write(f"{self.key(name)} = ")
                self.value(inner)
            self.write(" }")
        elif isinstance(value, list):
            space = self.choose(["", " ", "\n  ", "  # ] } comment\n"])
            self.write("[")
            for inner in value:
                self.write(space)
                self.value(inner)
                self.write(self.choose([",", " ,", f"{space},"]))
            self.write(f"{space}]")
        else:
            self.write(self.scalar(value))

    def pairs(self, table, prefix=()):
        """Write the pairs of a table; return those that have to get a header of their own."""
        later = []
        for name, value in table.items():
            tables = isinstance(value, list) and value and all(isinstance(x, dict) for x in value)
            form = self.choose(["inline", "dotted", "header"])
            if not prefix and form == "header" and (isinstance(value, dict) or tables):
                later.append((name, value))
            elif form == "dotted" and isinstance(value, dict) and value:
                self.pairs(value, (*prefix, name))
            else:
                self.write(f"{self.dotted((*prefix, name))} = ")
                self.value(value)
                self.write(self.choose(["\n", "  # x = 1\n", "\n\n# [y]\n"]))
        return later

    def table(self, table, path=()):
        for name, value in self.pairs(table):
            for inner in value if isinstance(value, list) else [value]:
                mark = ("[[", "]]") if isinstance(value, list) else ("[", "]")
                self.write(f"{mark[0]}{self.dotted((*path, name))}{mark[1]}\n")
                self.table(inner, (*path, name))


def leaves(value, path=()):
    """Yield every path in `value`, with the value at it."""
    if path:
        yield path, value
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from leaves(inner, (*path, key))


@given(DOCUMENTS, st.data())
def test_every_path_that_tomllib_finds_has_a_line_and_no_other(document, data):
    writer = Writer(lambda forms: data.draw(st.sampled_from(forms)))
    writer.table(document)
    found = dict(leaves(tomllib.loads(writer.text)))
    assert set(lines_of(writer.text)) == set(found), writer.text


@given(DOCUMENTS, st.data())
def test_the_line_is_the_one_on_which_the_value_begins(document, data):
    writer = Writer(lambda forms: data.draw(st.sampled_from(forms)))
    writer.table(document)
    lines = lines_of(writer.text)
    for path, value in leaves(tomllib.loads(writer.text)):
        if isinstance(value, int):
            assert lines[path] == value, (path, writer.text)


def test_a_key_that_is_not_there_is_sought_in_the_table_around_it():
    lines = lines_of("a = 1\n\n[b.c]\nd = [\n  1,\n  2,\n]\n")
    assert line_of(lines, ("b", "c", "x")) == 3
    assert line_of(lines, ("b", "c", "d", 1)) == 6
    assert line_of(lines, ("x", "y")) == 1


def test_a_header_below_an_array_of_tables_means_its_newest_element():
    lines = lines_of("[[a]]\n[a.b]\nc = 3\n[[a]]\n[a.b]\nc = 6\n")
    assert lines["a", 0, "b", "c"] == 3
    assert lines["a", 1, "b", "c"] == 6
    assert lines[("a",)] == 1
