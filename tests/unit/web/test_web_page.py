# SPDX-License-Identifier: Apache-2.0
"""The files of the dashboard: their size, their source, and the addresses that they may load."""

import base64
import gzip
import hashlib
import json
import re

from motord.bus.web.assets import FOLDER, assets, policy

BYTES_MAX = 250_000
VENDOR = FOLDER / "vendor"
OWN = [path for path in FOLDER.rglob("*.*") if VENDOR not in path.parents]
SCRIPTS = [path for path in OWN if path.suffix == ".js"]


def test_the_vendored_files_are_those_that_were_taken_from_their_packages():
    rows = json.loads((VENDOR / "vendor.json").read_text(encoding="utf-8"))
    listed = {row["file"]: row["sha256"] for row in rows}
    found = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in VENDOR.iterdir()
        if path.suffix in (".js", ".css")
    }
    assert found == listed
    licences = (VENDOR / "LICENCES.txt").read_text(encoding="utf-8")
    assert all(row["licence"] and row["version"] for row in rows)
    assert all(row["file"] in licences for row in rows)


def test_the_whole_page_is_small():
    sent = {id(asset): asset.packed for asset in assets().values()}
    assert sum(map(len, sent.values())) < BYTES_MAX
    assert all(gzip.decompress(asset.packed) == asset.raw for asset in assets().values())


def test_the_page_names_no_other_machine_and_has_no_inline_script_or_style():
    for path in OWN:
        text = path.read_text(encoding="utf-8")
        others = set(re.findall(r"(?:src|href|from|import|url)\W{1,4}(https?:[^\"'` )]+)", text))
        assert not others, path.name
        assert not re.search(r"\beval\(|new Function|innerHTML|style=\"", text), path.name
    page = (FOLDER / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"<script(?![^>]*src=)|<style|\son\w+=", page)


def test_what_the_first_paint_needs_is_in_the_page_and_permitted_by_its_hash_alone():
    page = assets()["/"].raw.decode()
    inline = re.findall(r"<(style|script)>(.*?)</\1>", page, re.DOTALL)
    assert [element for element, _ in inline] == ["style", "script"]
    for element, text in inline:
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert re.search(rf"{element}-src 'self' 'sha256-{re.escape(digest)}';", policy(()))
    for name in re.findall(r'(?:href|src)="([^"]+)"', page):
        assert f"/{name}" in assets(), name


def test_every_module_that_is_imported_is_there():
    found = [
        (path, name)
        for path in SCRIPTS
        for name in re.findall(r"(?:from|import\()\s*\"(\.[^\"]+)\"", path.read_text("utf-8"))
    ]
    assert len(found) > len(SCRIPTS)
    for path, name in found:
        there = (path.parent / name).resolve().relative_to(FOLDER.resolve())
        assert f"/{there}" in assets(), f"{path.name} imports {name}"


def test_every_text_that_is_used_is_there():
    """`text.js` holds all strings; a page that names another one would show nothing."""
    text = (FOLDER / "text.js").read_text(encoding="utf-8")
    known = set(re.findall(r"^  (\w+)(?=:|,)", text, re.MULTILINE))
    known |= set(re.findall(r"[{,] (\w+):", text))
    for path in SCRIPTS:
        used = set(re.findall(r"\bTEXT\.(\w+)", path.read_text(encoding="utf-8")))
        assert used <= known, path.name


def test_no_two_texts_have_the_same_name():
    """The second text would replace the first one everywhere."""
    text = (FOLDER / "text.js").read_text(encoding="utf-8")
    block = text[text.index("export const TEXT = {") : text.index("\n};")]
    block = re.sub(r'"(?:[^"\\]|\\.)*"|//.*', "", block)
    depth, names = 0, []
    for part in re.findall(r"[({\[]|[)}\]]|(?<=[\s,{])\w+(?=:)|.", block, re.DOTALL):
        depth += (part in "({[") - (part in ")}]")
        if depth == 1 and part.isidentifier() and len(part) > 1:
            names.append(part)
    names = [name for name in names if re.search(rf"\b{name}:", block)]
    assert len(names) > 100
    assert {name for name in names if names.count(name) > 1} == set()


def test_the_policy_lets_the_page_connect_to_its_own_robot_and_its_fleet():
    assert "connect-src 'self';" in policy(())
    fleet = policy(["https://r2.example:8088"])
    assert "connect-src 'self' https://r2.example:8088 wss://r2.example:8088;" in fleet
    assert "default-src 'none'" in fleet
    assert "unsafe" not in fleet
