# SPDX-License-Identifier: Apache-2.0
"""Where the robot file is read and checked: in this process, or in a child. A process that lives
long leaves it to a child, which ends when it has answered: pydantic, its validators and the rules
take a third of the memory that the daemon needs without them.

Call `elsewhere` or `handed_over` before the first import of `motord.config`."""

from __future__ import annotations

import json
import subprocess
from typing import Any

from motord.base.python_command import module_command

ANSWER_WITHIN_S = 60.0
HERE = True
"""Whether this process reads and checks it: then tables of the robot file are pydantic's."""
_reader: subprocess.Popen[bytes] | None = None


def handed_over() -> None:
    """Note that this process reads no robot file: it is given what another one has checked."""
    global HERE  # noqa: PLW0603  a property of the process
    HERE = False


def elsewhere() -> None:
    """Start the child that reads one robot file, motord/config/__main__.py: it gets ready while
    this process imports the rest."""
    global _reader  # noqa: PLW0603  a property of the process
    handed_over()
    pipe = subprocess.PIPE
    # a process group of its own: Ctrl-C does not reach the child, which ends after its answer
    _reader = subprocess.Popen(
        module_command("motord.config"), stdin=pipe, stdout=pipe, process_group=0
    )


def ask(*question: Any) -> bytes:
    """Return the child's answer to a question: the arguments of `motord.config.load.answer`, as
    JSON. This works once. Raises RuntimeError if the child has failed, and written the reason to
    stderr."""
    global _reader
    if _reader is None:
        raise RuntimeError("there is no process that reads a robot file")
    reader, _reader = _reader, None
    try:
        raw, _ = reader.communicate(json.dumps(question).encode(), timeout=ANSWER_WITHIN_S)
    except subprocess.TimeoutExpired:
        reader.kill()
        reader.wait()
        raise RuntimeError(
            f"the process that reads the robot file did not answer within {ANSWER_WITHIN_S:g} s"
        ) from None
    if reader.returncode:
        raise RuntimeError("the process that reads the robot file has failed")
    return raw
