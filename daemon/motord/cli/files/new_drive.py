# SPDX-License-Identifier: Apache-2.0
"""`motord drives new`: begin a drive profile from answers. No fact about the drive has a default:
what is not answered is left out, and listed in the profile as unknown."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

import click

from motord.cli.common import Exit, Failure
from motord.cli.files.drive_questions import QUESTIONS, Answers, Question, Value
from motord.cli.files.drive_text import UnfitAnswers, drive_text
from motord.config.drives.load import load_profile
from motord.config.drives.unknown import BLOCKING, UNKNOWN
from motord.config.problems import ConfigError
from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError


def new_drive(path: Path, answers_file: Path | None) -> None:
    """Write a new profile, check it and list what is unknown. Never overwrites a file."""
    if path.suffix != ".toml":
        path = path.with_name(f"{path.name}.toml")
    if path.exists():
        raise Failure(f"{path} is there already: name another file", Exit.USAGE)
    answers = _ask() if answers_file is None else _read(answers_file)
    try:
        text, unknown = drive_text(path.stem, answers)
    except UnfitAnswers as error:
        raise Failure(str(error), Exit.USAGE) from None
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise Failure(f"{path}: {error.strerror}", Exit.USAGE) from error
    if wrong := _wrong(path, unknown):
        path.unlink()
        raise Failure(f"these answers give no valid profile:\n{wrong}", Exit.USAGE)
    click.echo(f"{path}: written")
    for fact in unknown:
        click.echo(f"  unknown: {fact}: {UNKNOWN[fact]}")
    if any(fact in BLOCKING for fact in unknown):
        click.echo(
            "A robot with this drive does not pass `motord check` before these are filled in."
        )
    click.echo("Next: put in what is missing (faults, current, counter), then")
    click.echo(f"  motord drives check {path}")


def _wrong(path: Path, unknown: list[str]) -> str:
    """Return the problems of the file that do not follow from what is unknown."""
    try:
        load_profile(path)
    except ProfileError as error:
        found = error.__cause__
        assert isinstance(found, ConfigError)  # load_profile
        follows = ["unknown"]
        follows += ["serial"] if "serial" in unknown else []
        follows += ["register.target_velocity."] if {"sign", "order"} & {*unknown} else []
        others = [one for one in found.problems if not one.key.startswith(tuple(follows))]
        return "\n".join(map(str, others))
    return ""


def _ask() -> Answers:
    click.echo("An empty answer means that you do not know: it is left out, and listed as unknown.")
    answers: Answers = {}
    for question in QUESTIONS:
        if question.is_asked(answers) and (value := _ask_one(question)) is not None:
            answers[question.key] = value
    return answers


def _ask_one(question: Question) -> Value | None:
    while True:
        typed = str(click.prompt(question.text, default="", show_default=False)).strip()
        if not typed:
            return None
        try:
            return question.typed(typed)
        except ValueError as error:
            click.echo(f"  {error}")


def _read(file: Path) -> Answers:
    try:
        given: Mapping[str, object] = bounded.toml(bounded.read(file).decode())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Failure(f"{file}: {error}", Exit.USAGE) from error
    questions = {question.key: question for question in QUESTIONS}
    answers: Answers = {}
    for key, value in given.items():
        if key not in questions:
            raise Failure(f"{file}: {key}: known are {', '.join(questions)}", Exit.USAGE)
        try:
            answers[key] = questions[key].checked(value)
        except ValueError as error:
            raise Failure(f"{file}: {key}: {error}", Exit.USAGE) from None
    for question in QUESTIONS:
        if question.key in answers and not question.is_asked(answers):
            text = f"{file}: {question.key}: does not fit the other answers"
            raise Failure(text, Exit.USAGE)
    return answers
