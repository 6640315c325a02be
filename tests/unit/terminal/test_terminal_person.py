# SPDX-License-Identifier: Apache-2.0
"""A person at a terminal who presses Ctrl-C at an awkward moment."""

import os
import pty
import select
import signal
import sys
import termios

import pytest

from motord.cli.terminal import Terminal
from motord.commission.person import Aborted

DEADLINE_S = 60.0


@pytest.fixture
def keyboard(monkeypatch):
    """The end of a terminal at which the test types: sys.stdin reads the keys."""
    master, slave = pty.openpty()
    with open(slave, encoding="utf-8") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield master
    os.close(master)


def test_ctrl_c_between_a_motion_and_the_next_question_ends_the_question(keyboard, monkeypatch):
    set_modes = termios.tcsetattr

    def interrupted(*modes):
        signal.raise_signal(signal.SIGINT)
        set_modes(*modes)
        os.write(keyboard, b"y\n")

    with Terminal() as person:
        assert not person.aborted()
        monkeypatch.setattr(termios, "tcsetattr", interrupted)
        with pytest.raises(Aborted):
            person.confirm("Go on?")


def test_ctrl_c_whose_exception_a_finalizer_swallows_ends_the_question(keyboard, monkeypatch):
    class Finalized:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def echo(*_words, **_options):
        Finalized()

    monkeypatch.setattr(sys, "unraisablehook", lambda _: None)
    with Terminal() as person:
        monkeypatch.setattr("motord.cli.terminal.click.echo", echo)
        with pytest.raises(Aborted):
            person.confirm("Go on?")


def test_ctrl_c_while_it_looks_for_a_key_is_not_lost(keyboard, monkeypatch):
    look = select.select

    def interrupted(*files):
        found = look(*files)
        signal.raise_signal(signal.SIGINT)
        return found

    with Terminal() as person:
        assert not person.aborted()
        monkeypatch.setattr(select, "select", interrupted)
        assert person.aborted()


def test_a_key_after_the_last_look_of_a_motion_ends_the_next_question(keyboard):
    with Terminal() as person:
        assert not person.aborted()
        os.write(keyboard, b"y")
        assert select.select([sys.stdin], [], [], DEADLINE_S)[0]
        os.write(keyboard, b"\n")
        with pytest.raises(Aborted):
            person.confirm("Go on?")
