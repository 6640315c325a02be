# SPDX-License-Identifier: Apache-2.0
"""What axe-core finds on a page: a test without it is skipped, and says how to get it."""

import json
import os

import pytest
from tests.browser.dashboard import DEADLINE_MS

AXE = os.environ.get("MOTORD_AXE", "build/node/node_modules/axe-core/axe.min.js")


def axe_violations(page):
    """Rule, impact, element and explanation of each."""
    if not os.path.exists(AXE):
        pytest.skip("no axe-core here: npm install --prefix build/node axe-core")
    with open(AXE, encoding="utf-8") as file:
        axe = file.read()
    session = page.context.new_cdp_session(page)
    session.send("Runtime.evaluate", {"expression": axe})
    found = session.send("Runtime.evaluate", {
        "expression": "axe.run().then(found => JSON.stringify(found.violations))",
        "awaitPromise": True, "returnByValue": True, "timeout": DEADLINE_MS,
    })["result"]["value"]  # fmt: skip
    return [
        (row["id"], row["impact"], node["html"][:200], node["failureSummary"])
        for row in json.loads(found)
        for node in row["nodes"]
    ]
