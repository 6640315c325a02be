# SPDX-License-Identifier: Apache-2.0
"""Findings of axe-core on a page. Without axe-core a test is skipped and shows the installation."""

import json
import os

import pytest
from tests.browser.dashboard import DEADLINE_MS

AXE = os.environ.get("MOTORD_AXE", "build/node/node_modules/axe-core/axe.min.js")


def axe_violations(page, *rules):
    """Return the violations of these rules, or of all: (rule, impact, element, explanation)."""
    if not os.path.exists(AXE):
        pytest.skip("no axe-core here: npm install --prefix build/node axe-core")
    wanted = {"resultTypes": ["violations"], **({"runOnly": rules} if rules else {})}
    session = page.context.new_cdp_session(page)
    if not page.evaluate("'axe' in window"):
        with open(AXE, encoding="utf-8") as file:
            session.send("Runtime.evaluate", {"expression": file.read()})
    found = session.send("Runtime.evaluate", {
        "expression": f"axe.run({json.dumps(wanted)})"
        ".then(found => JSON.stringify(found.violations))",
        "awaitPromise": True, "returnByValue": True, "timeout": DEADLINE_MS,
    })["result"]["value"]  # fmt: skip
    session.detach()
    return [
        (row["id"], row["impact"], node["html"][:200], node["failureSummary"])
        for row in json.loads(found)
        for node in row["nodes"]
    ]
