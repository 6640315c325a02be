# SPDX-License-Identifier: Apache-2.0
"""The child of a process that lives long: reads one robot file for it (validation.py). The question
comes on standard input as JSON, the answer goes to standard output (transfer.py)."""

from __future__ import annotations

import contextlib
import json
import os
import sys

from motord.config import transfer
from motord.config.load import answer


def main() -> None:
    """Read the question and write its answer; do nothing without a question."""
    if raw := sys.stdin.buffer.read():
        answered = transfer.dumps(answer(*json.loads(raw))).encode()
        # it is no error if the reader has gone
        with contextlib.suppress(BrokenPipeError), os.fdopen(os.dup(1), "wb") as answers:
            answers.write(answered)


if __name__ == "__main__":
    main()
