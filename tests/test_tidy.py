# SPDX-License-Identifier: Apache-2.0
"""House rules that a machine can check; a failure names file, line and the rule's reason."""

import ast
import io
import re
import subprocess
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def project_files() -> list[Path]:
    """Return the files that git tracks or would track; in an unpacked archive, all but those that
    make has made."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=30,
    )
    if listing.returncode == 0:
        return [ROOT / name for name in listing.stdout.splitlines() if (ROOT / name).is_file()]
    made = {".venv", "build", "dist", "__pycache__"}
    return [p for p in ROOT.rglob("*") if p.is_file() and not made & set(p.parts)]


TRACKED = project_files()
PYTHON = [path for path in TRACKED if path.suffix == ".py"]
C = [path for path in TRACKED if path.suffix in (".c", ".h")]
TEXT_SUFFIXES = {".py", ".c", ".h", ".toml", ".md", ".sh", ".pyi"}
TEXT = [
    path for path in TRACKED if path.suffix in TEXT_SUFFIXES or path.name in ("Makefile", "run")
]
PAGE = [
    path
    for path in TRACKED
    if path.suffix in (".js", ".css", ".html") and "vendor" not in path.parts
]
SCRIPTS = [
    path
    for path in TRACKED
    if path.name in ("Makefile", "Dockerfile") or path.read_bytes().startswith(b"#!")
]
PRODUCT = [path for path in PYTHON if path.relative_to(ROOT).parts[0] in ("daemon", "hal")]
CSRC = [path for path in C if path.is_relative_to(ROOT / "csrc")]

COLUMNS_MAX = 100
FUNCTION_LINES_MAX = 60
FILE_LINES_MAX = 500
FOLDER_FILES_MAX = 15


def report(rows: list[str], reason: str) -> None:
    assert not rows, "\n".join([*rows, f"({reason})"])


def where(path: Path, line: int) -> str:
    return f"{path.relative_to(ROOT)}:{line}"


def matching(paths: list[Path], pattern: str) -> list[str]:
    regex = re.compile(pattern)
    return [
        f"{where(path, number)}: {line.strip()}"
        for path in paths
        if path != Path(__file__).resolve()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if regex.search(line)
    ]


def long_lines(paths: Iterable[Path]) -> Iterator[tuple[str, str]]:
    """Yield the place and text of each line that is longer than COLUMNS_MAX."""
    for path in sorted(paths):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if len(line) > COLUMNS_MAX:
                yield where(path, number), line


def test_lines_fit_a_screen():
    rows = [place for place, _ in long_lines({*PYTHON, *C, *PAGE, *SCRIPTS})]
    report(rows, f"at most {COLUMNS_MAX} columns")


def test_settings_fit_a_screen():
    """A string of TOML, or a setting of systemd or udev, may be longer: it needs one line."""
    setting = re.compile(r'[\w.-]+ = "(?:[^"\\]|\\.)*"|[A-Z].*')
    paths = [
        path
        for path in TRACKED
        if path.suffix in (".toml", ".service", ".rules") and path.name != "mutants.toml"
    ]
    rows = [place for place, line in long_lines(paths) if not setting.fullmatch(line)]
    report(rows, f"at most {COLUMNS_MAX} columns: a comment above its line, an array on several")


def prose(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a page, with their numbers, without tables and code."""
    found, fenced = [], False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        fenced ^= line.lstrip().startswith("```")
        if not (fenced or line.startswith(("|", "    "))):
            found.append((number, line))
    return found


def test_text_fits_a_screen():
    rows = [
        where(path, number)
        for path in TRACKED
        if path.suffix == ".md"
        for number, line in prose(path)
        if len(line) > COLUMNS_MAX
    ]
    report(rows, f"at most {COLUMNS_MAX} columns of text, beside tables and code")


def test_a_file_has_one_subject():
    rows = [
        f"{where(path, 1)}: {lines} lines"
        for path in PYTHON + C + PAGE
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > FILE_LINES_MAX
    ]
    report(rows, f"at most {FILE_LINES_MAX} lines: split by subject")


def test_a_folder_has_one_subject():
    counts = Counter(
        path.relative_to(ROOT).parent
        for path in TRACKED
        if path.relative_to(ROOT).parts[0] in ("csrc", "daemon", "hal", "tests")
        and path.suffix in (".py", ".c", ".h", ".js")
        and path.name not in ("__init__.py", "conftest.py")
    )
    rows = [f"{folder}: {count} code files" for folder, count in sorted(counts.items())
            if count > FOLDER_FILES_MAX]  # fmt: skip
    report(rows, f"at most {FOLDER_FILES_MAX} code files in a folder: move some by subject")


def test_a_python_function_has_one_job():
    rows = []
    for path in PYTHON:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                documented = ast.get_docstring(node) is not None
                first = node.body[1 if documented and len(node.body) > 1 else 0].lineno
                lines = (node.end_lineno or first) - first + 1
                if lines > FUNCTION_LINES_MAX:
                    rows.append(f"{where(path, node.lineno)}: {node.name}: {lines} lines")
    report(rows, f"at most {FUNCTION_LINES_MAX} lines of body")


def test_a_c_function_has_one_job():
    rows = []
    for path in CSRC:
        start = None
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if line.startswith("{"):
                start = number
            elif line.startswith("}") and start is not None:
                if number - start - 1 > FUNCTION_LINES_MAX:
                    rows.append(f"{where(path, start)}: {number - start - 1} lines")
                start = None
    report(rows, f"at most {FUNCTION_LINES_MAX} lines of body")


def test_every_source_file_names_its_licence():
    rows = [
        where(path, 1)
        for path in PYTHON + C
        if "SPDX-License-Identifier: Apache-2.0" not in path.read_text(encoding="utf-8")[:200]
    ]
    report(rows, "one SPDX line at the head")


def test_the_core_takes_no_memory():
    report(
        matching(CSRC, r"\b(malloc|calloc|realloc|free|alloca|strdup)\s*\(|Python\.h"),
        "csrc/ runs from static memory and knows no Python",
    )


def test_the_daemon_never_forks():
    # the exception: a process of its own, which forks in order to delay a loop
    hog = ROOT / "daemon/motord/tools/latency/burner.py"
    daemon = [path for path in PRODUCT if path != hog]
    report(matching(daemon, r"\bos\.fork|\bpty\.fork|forkserver|set_start_method\(.fork"),
           "a fork costs the real-time thread about 600 page faults")  # fmt: skip


def test_one_module_builds_the_command_lines_of_python_processes():
    """`python -m` alone runs files of the folder in which a command was typed."""
    builder = ROOT / "daemon/motord/base/python_command.py"
    others = [path for path in PRODUCT if path != builder]
    words = r"""["'](-m|-c)["']|sys\.executable *[,+\]]"""
    assert matching([builder], words), "the command lines of Python processes have moved"
    report(matching(others, words), "module_command() and script_command() keep that folder out")


def test_data_of_other_processes_cannot_run_code():
    modules = r"\b(import|from) (pickle|marshal|shelve|dill)\b|\b(pickle|marshal)\."
    report(matching(PRODUCT, modules), "JSON, or motord/config/transfer.py")


def test_every_task_belongs_to_a_group():
    words = r"ensure_future|(asyncio|loop|get_running_loop\(\))\.create_task|asyncio\.TaskGroup"
    others = [path for path in PRODUCT if path != ROOT / "hal/motord_hal/base/tasks.py"]
    report(matching(others, words), "a task belongs to a motord_hal.base.tasks.TaskGroup")


def test_no_error_is_swallowed():
    report(
        matching(PRODUCT, r"except\s*:|except (Base)?Exception|suppress\((Base)?Exception|"
                 r"except .*CancelledError|suppress\(.*CancelledError"),
        "name what is caught; cancellation passes",
    )  # fmt: skip


def test_limits_on_waiting_hold_in_cleanups_too():
    rows = matching(PRODUCT, r"asyncio\.(timeout|timeout_at|wait_for)\(")
    report(
        [row for row in rows if "hal/motord_hal/base/clock.py" not in row],
        "until Python 3.11.3 a cancelled task gets no TimeoutError: motord_hal.base.clock.within",
    )


def test_an_error_without_words_is_reported_in_others():
    rows = matching(PYTHON, r"\berror or [\"']")
    report(rows, "an exception is always true: str(error) or ...")


def test_nothing_is_left_for_later():
    report(matching(TEXT, r"\b(TODO|FIXME|XXX|NotImplementedError)\b"), "build it or leave it out")


def test_no_machine_of_a_builder_shows():
    pattern = r"(^|[\s\"'=(])/(w" + r"ork|r" + r"oot)/|https?://(deb|security|files|registry)[.-]"
    report(matching(TEXT, pattern), "paths and hosts of one machine have no place here")


def test_headers_of_csrc_point_downwards():
    """Headers for threads, schedulers and mappings are included only by the files named here."""
    allowed = {
        "pthread.h": {"loop", "line_thread", "output_pwm", "bus"},
        "sched.h": {"loop"},
        "sys/mman.h": {"loop"},
    }
    rows = []
    for path in CSRC:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            header = re.match(r"#include [<\"](.+)[>\"]", line)
            owners = allowed.get(header.group(1)) if header else None
            if owners is not None and not any(path.stem.startswith(owner) for owner in owners):
                rows.append(f"{where(path, number)}: {header.group(1)}")
    report(rows, "threads, schedulers, mappings: loop*.c, line_thread.c, output_pwm.c, bus*.c")


def test_folders_of_csrc_include_downwards():
    below: dict[str, set[str]] = {
        "base": set(), "core": {"base"}, "loop": {"base", "core"}, "bus": {"base"},
        "fieldbus": {"base", "loop"}, "pwm": {"base", "loop"},
    }  # fmt: skip
    folders = {path.name: path.relative_to(ROOT / "csrc").parts[0] for path in CSRC}
    rows = []
    for path in CSRC:
        own = folders[path.name]
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            header = re.match(r'#include "(?!api|rt\.h)(.+)"', line)
            if header and folders[header.group(1)] not in below[own] | {own}:
                rows.append(f"{where(path, number)}: {header.group(1)}")
    report(
        rows,
        "base < core < loop < fieldbus, pwm; bus needs base alone; rt.h and api are for all",
    )


def test_two_folders_know_the_c_extension():
    others = [path for path in PRODUCT if path.parent.name != "realtime"]
    report(
        matching(others, r"(import|from) _motord_rt"),
        "_motord_rt is imported in motord/realtime and motord_hal/realtime alone",
    )


def test_one_module_of_the_second_process_imports_its_c_extension():
    importer = ROOT / "daemon/motord/bus/ros2/dds/receiver.py"
    report(
        matching([path for path in PRODUCT if path != importer], r"(import|from) _motord_bus"),
        "_motord_bus is imported by motord/bus/ros2/dds/receiver.py alone",
    )


def test_nothing_but_the_entry_points_imports_app():
    others = [path for path in PRODUCT if "cli" not in path.parts and path.name != "__main__.py"]
    imports = r"(from|import) motord\.daemon\.app|from motord\.daemon import .*\bapp\b"
    assert matching(PRODUCT, imports), "no entry point imports motord.daemon.app: it has moved"
    report(matching(others, imports), "only entry points import motord.daemon.app")


def test_the_top_level_holds_the_rooms_and_nothing_else():
    rooms = {".ci", "config", "csrc", "daemon", "docs", "hal", "systemd", "tests"}
    found = {path.relative_to(ROOT).parts[0] for path in TRACKED if path.parent != ROOT}
    assert found <= rooms


UNIT = re.compile(
    r"_(m|m_s|m_s2|m_s3|rad|rad_s|rad_s2|rad_s3|hz|s|ms|us|ns|v|a|c|per_s)$|"
    r"_(m2|rad2|m2_s2|rad2_s2|m2_per_m|rad2_per_rad|n_m|n_m_per_rad|n_m_s_per_rad)$|"
    r"_(n_m_s2_per_rad|s_per_rad|per_rad|s2_per_rad|kg_m2)$"
)
UNITLESS = {
    # counts, names, ratios: numbers without a dimension
    "unit", "channel", "gear_ratio", "priority", "cpu", "baudrate", "stop_bits", "tries",
    "bitrate", "data_bitrate",
    "counts_per_turn", "zero_count", "port", "duty_dead_band", "duty_min", "duty_max",
    "track_slip_factor", "correction_max",
    "schema", "scale",
}  # fmt: skip


@pytest.mark.parametrize(
    "path", sorted((ROOT / "config/robots").glob("*.toml")), ids=lambda p: p.stem
)
def test_every_number_of_a_robot_file_wears_its_unit(path):
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        pair = re.match(r"(\w+)\s*=\s*[-+\d]", line)
        if pair and pair.group(1) not in UNITLESS and not UNIT.search(pair.group(1)):
            rows.append(f"{where(path, number)}: {pair.group(1)}")
    report(rows, "a physical number's key ends in its SI unit")


def test_no_test_module_imports_another():
    rows = [
        row
        for path in PYTHON
        if path.relative_to(ROOT).parts[0] == "tests"
        for row in matching([path], r"^\s*(from|import) (tests\.)?((?!aiohttp)\w+\.)?test_\w+")
        if not re.search(rf"\b{path.stem}( as| import|$)", row.partition(": ")[2])  # by its child
    ]
    report(rows, "what two test modules share is a module of its own")


# Each stands for a term of docs/glossary.md: sent, received, reported, unresponsive, request,
# notifier, direction, fault reason, command gate, runtime, command sockets, line counters.
PRIVATE_WORD = re.compile(
    "desk|station|doors|sparing|books|news|wish(es|ed)?|told|tells?|teller|heard|hears?|unheard"
    "|deaf|quiet|demoted|hurry|said|ways?|whoever",
    re.IGNORECASE,
)
WORDS_OF_A_NAME = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
C_TEXT = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'', re.DOTALL)


def names_in(path: Path) -> set[str]:
    """Return every name in the code, without comments and strings."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return set(re.findall(r"[A-Za-z_]\w*", C_TEXT.sub(" ", text)))
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {token.string for token in tokens if token.type == tokenize.NAME}


PRIVATE_MESSAGE = re.compile(
    r"\b(desk|sparing|wish(es|ed)?|told|tells?|heard|hears?|deaf|quiet|demoted|hurry|said|says?"
    r"|ways?|whoever|nobody|somebody|anybody|asks? for|asked for|under way)\b",
    re.IGNORECASE,
)


PRIVATE_TEXT = re.compile(
    r"\b(desk|sparing|wish(es|ed)?|told|tells?|telling|said|heard|hears?|deaf|quiet|demoted|hurry"
    r"|whoever|nobody|somebody|anybody|whom|he|his|him|asked for|asks? for|under way"
    r"|who (asks?|waits|comes|shows|is counted)|(the )?other way round|both ways"
    r"|(?<!there )(is|are) none)\b",
    re.IGNORECASE,
)
PAGES = [
    path
    for path in TRACKED
    if path.suffix == ".md"
    and path.relative_to(ROOT).parts[0] in ("README.md", "CONTRIBUTING.md", "docs")
]


def test_pages_are_in_the_terms_of_the_glossary():
    rows = [
        f"{where(path, number)}: {found[0]}"
        for path in PAGES
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if (found := PRIVATE_TEXT.search(line))
    ]
    report(rows, "write who does what to what, in the terms of docs/glossary.md")


PRIVATE_COMMENT = re.compile(
    r"\b(desk|sparing|box|wish(es|ed)?|[Tt]old|[Tt]ells?|[Tt]elling|[Ss]aid|([Uu]n)?[Hh]eard"
    r"|[Hh]ear(s|ing)?|deaf|[Qq]uiet|demoted|hurry|[Ww]hoever|[Nn]obody|[Ss]omebody|[Aa]nybody"
    r"|whom|[Hh]e|[Hh]is|him|[Aa]sks? for|under way|on (its|their|the) way|both ways"
    r"|other way round|[Ww]ho (asks?|waits|comes|wants|reads)|(?<![Tt]here )(is|are) none)\b"
)


def comments_in(path: Path) -> Iterator[tuple[int, str]]:
    """Yield every line of a comment or docstring, with its number."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT or token.string.startswith('"""'):
                yield from enumerate(token.string.splitlines(), token.start[0])
        return
    for found in C_TEXT.finditer(text):
        if found[0].startswith("/"):
            first = text.count("\n", 0, found.start()) + 1
            yield from enumerate(found[0].splitlines(), first)


# Names, comments and docstrings of tests are checked too, but not here: this file lists the words.
TESTED = [
    path
    for path in PYTHON + C
    if path.relative_to(ROOT).parts[0] == "tests" and path.name != "test_tidy.py"
]


@pytest.mark.parametrize("paths", [PRODUCT, CSRC, TESTED], ids=["Python", "C", "tests"])
def test_comments_are_in_the_terms_of_the_glossary(paths):
    rows = [
        f"{where(path, number)}: {found[0]}"
        for path in paths
        for number, line in comments_in(path)
        if (found := PRIVATE_COMMENT.search(line)) and "@" not in line
    ]
    report(rows, "write who does what to what, in the terms of docs/glossary.md")


def messages_in(path: Path) -> Iterator[tuple[int, str]]:
    """Yield every string of the code that is no docstring, with its line number."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bodies = (getattr(node, "body", None) for node in ast.walk(tree))
    texts = {
        id(statement.value)
        for body in bodies
        if isinstance(body, list)
        for statement in body
        if isinstance(statement, ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in texts:
            yield node.lineno, node.value


def test_messages_are_terms_of_the_glossary():
    rows = [
        f"{path.relative_to(ROOT)}:{line}: {found[0]}"
        for path in PRODUCT
        for line, text in messages_in(path)
        if " " in text.strip() and "\n" not in text and (found := PRIVATE_MESSAGE.search(text))
    ]
    report(rows, "docs/glossary.md has a term for it")


def test_names_of_tests_are_in_the_terms_of_the_glossary():
    private = re.compile(
        f"(?:^|_)({PRIVATE_WORD.pattern}|says?|tells?|hears?|asks|who|whom|he|his|him|nobody"
        r"|somebody|anybody|whoever|lets?_go|is_none|are_none|sent_(?:so|of))(?=_|$)"
    )
    rows = [
        f"{where(path, number)}: {found[1]}"
        for path in PYTHON
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if (name := re.match(r"\s*(?:async )?def (test_\w+)", line))
        and (found := private.search(name[1]))
    ]
    report(rows, "write who does what to what, in the terms of docs/glossary.md")


@pytest.mark.parametrize("paths", [PRODUCT, CSRC, TESTED], ids=["Python", "C", "tests"])
def test_names_are_terms_of_the_glossary(paths):
    rows = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in paths
        for name in sorted(names_in(path))
        if not name.startswith("test_")  # a sentence: test_names_of_tests_...
        if any(PRIVATE_WORD.fullmatch(word) for word in WORDS_OF_A_NAME.findall(name))
    ]
    report(rows, "docs/glossary.md has a term for it")
