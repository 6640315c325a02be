# SPDX-License-Identifier: Apache-2.0
"""Where the robot file is read and checked. A process that lives long leaves that to a child, which
ends when it has answered: pydantic, its validators and the rules take a third of the memory that
the daemon needs without them.

`elsewhere` comes before the first import of `motord.config`, and before there is any thread.
"""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import traceback
from dataclasses import dataclass
from typing import Any

READER = "motord.config.load"
"""The module whose function `answer` takes the question: by name, for it is the child's alone."""
HERE = True
"""Whether this process does it: then tables of the robot file are pydantic's."""


@dataclass(frozen=True, slots=True)
class _Child:
    pid: int
    ask: int
    answered: int

    def answer(self, question: tuple[Any, ...]) -> Any:
        with os.fdopen(self.ask, "wb") as questions:
            pickle.dump(question, questions)
        with os.fdopen(self.answered, "rb") as answers:
            raw = answers.read()
        os.waitpid(self.pid, 0)
        if not raw:
            raise RuntimeError("the process that reads the robot file has failed")
        return pickle.loads(raw)


_child: _Child | None = None


def elsewhere() -> None:
    """Begin the child that reads one robot file."""
    global HERE, _child
    asked, ask = os.pipe()
    answered, answer = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ask)
        os.close(answered)
        _answer_one(asked, answer)
    os.close(asked)
    os.close(answer)
    HERE, _child = False, _Child(pid, ask, answered)


def ask(*question: Any) -> Any:
    """What the child answers, once. Raises RuntimeError: it has failed, and said why on stderr."""
    global _child
    if _child is None:
        raise RuntimeError("there is no process that reads a robot file")
    child, _child = _child, None
    return child.answer(question)


def _answer_one(asked: int, answer: int) -> None:
    """The child. It ends without what Python does at the end of its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # its parent ends, and so does the wait for it
    status = 1
    try:
        reader = importlib.import_module(READER)  # while the parent imports the rest
        with os.fdopen(asked, "rb") as questions, os.fdopen(answer, "wb") as answers:
            if raw := questions.read():
                pickle.dump(reader.answer(*pickle.loads(raw)), answers)
        status = 0
    except BrokenPipeError:  # nobody wants to know any more
        pass
    except BaseException:  # noqa: BLE001  nothing may get out: the parent's frames are below
        traceback.print_exc()
    finally:
        os._exit(status)
