# SPDX-License-Identifier: Apache-2.0
"""The pages name every kind of base and every command, and their links are valid."""

import re
from pathlib import Path
from typing import get_args

import pytest

from motord.cli import COMMANDS
from motord.config.sections.bases import AnyBase

ROOT = Path(__file__).parents[3]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
TEXT = {page: page.read_text(encoding="utf-8") for page in PAGES}


def base_kinds():
    return [
        kind
        for base in get_args(AnyBase)
        for kind in get_args(base.model_fields["kind"].annotation)
    ]


def anchors(page):
    """Return the anchors that GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", TEXT[page], re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") for text in headings}


@pytest.mark.parametrize("kind", base_kinds())
def test_each_kind_of_base_is_named_in_readme_and_pages(kind):
    assert f"`{kind}`" in TEXT[ROOT / "docs/bases.md"] or kind == "joints"
    assert kind in TEXT[ROOT / "README.md"]


def test_each_command_is_shown_on_a_page():
    shown = "\n".join(TEXT.values())
    assert not [name for name in COMMANDS if not re.search(rf"\bmotord\s+{name}\b", shown)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_headings_that_exist(page):
    dead = []
    for link in re.findall(r"\]\(([^)\s]+)\)", TEXT[page]):
        if "://" in link:
            continue
        name, _, heading = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (heading and heading not in anchors(target)):
            dead.append(link)
    assert not dead
