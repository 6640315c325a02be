# SPDX-License-Identifier: Apache-2.0
"""Where the robot file is read and checked. A process that lives long leaves that to a child, which
ends when it has answered: pydantic, its validators and the rules take a third of the memory that
the daemon needs without them.

`elsewhere` or `handed_over` comes before the first import of `motord.config`.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

ANSWER_WITHIN_S = 60.0
HERE = True
"""Whether this process does it: then tables of the robot file are pydantic's."""
_reader: subprocess.Popen[bytes] | None = None


def handed_over() -> None:
    """This process reads no robot file: it is given what another one has checked."""
    global HERE  # noqa: PLW0603  a property of the process
    HERE = False


def elsewhere() -> None:
    """Begin the child that reads one robot file, motord/config/__main__.py: it gets ready while
    this process imports the rest."""
    global _reader  # noqa: PLW0603  a property of the process
    handed_over()
    pipe = subprocess.PIPE
    command = [sys.executable, "-m", "motord.config"]
    # a group of its own: Ctrl-C is this process's, and the child ends with its question
    _reader = subprocess.Popen(command, stdin=pipe, stdout=pipe, process_group=0)


def ask(*question: Any) -> Any:
    """What the child answers, once. Raises RuntimeError: it has failed, and written why to
    stderr."""
    global _reader
    if _reader is None:
        raise RuntimeError("there is no process that reads a robot file")
    reader, _reader = _reader, None
    try:
        raw, _ = reader.communicate(pickle.dumps(question), timeout=ANSWER_WITHIN_S)
    except subprocess.TimeoutExpired:
        reader.kill()
        reader.wait()
        raise RuntimeError(
            f"the process that reads the robot file did not answer within {ANSWER_WITHIN_S:g} s"
        ) from None
    if reader.returncode:
        raise RuntimeError("the process that reads the robot file has failed")
    return pickle.loads(raw)
