# SPDX-License-Identifier: Apache-2.0
"""The robot file in the dashboard's editor, in a real browser: completion by the schema, problems
at their lines, and saving."""

import re
import shutil
import tomllib

import pytest
from tests.browser.axe import axe_violations
from tests.browser.dashboard import dashboard_of
from tests.sim.daemon_stage import ROBOT, ROOT, SLOW, wait_until

from motord.config import load_robot

AREA = "textarea"
OPTIONS = ".completion [role=option]"
SAVE = "Save to the robot file…"
ROBOTS = sorted((ROOT / "config/robots").glob("*.toml"))


@pytest.fixture(autouse=True)
def file(robot):
    """The robot file, restored after each test."""
    before = robot.file.read_bytes()
    yield robot.file
    robot.file.write_bytes(before)
    for backup in robot.file.parent.glob("*.bak"):
        backup.unlink()


def button(page, name):
    return page.get_by_role("button", name=name, exact=True)


def opened(page, text=None):
    """Open the editor, with the file or with the given text; return its text area."""
    page.evaluate("location.hash = 'file'")
    page.wait_for_selector(AREA)
    if text is not None:
        page.locator(AREA).fill(text)
    return page.locator(AREA)


def at_end_of(page, row):
    """Put the cursor at the end of the first line that begins with `row`."""
    page.evaluate(
        """row => {
            const area = document.querySelector("textarea");
            const at = `\\n${area.value}`.indexOf(`\\n${row}`) + row.length;
            area.focus();
            area.setSelectionRange(at, at);
        }""",
        row,
    )


def changed(page, old, new):
    area = opened(page)
    text = area.input_value()
    assert old in text
    area.fill(text.replace(old, new, 1))


def checked(page, words):
    wait_until(lambda: words in page.locator(".checked").inner_text(), words)


def backups(file):
    return list(file.parent.glob(f"{file.name}.*.bak"))


def labels(page):
    return page.locator(f"{OPTIONS} > b").all_inner_texts()


def test_the_file_is_shown_with_its_lines_and_was_checked(page, file):
    area = opened(page)
    assert area.input_value() == file.read_text("utf-8")
    numbers = page.locator(".gutter pre").inner_text().split()
    assert len(numbers) == len(file.read_text("utf-8").split("\n"))
    checked(page, "No problems")
    assert button(page, SAVE).is_disabled()


def test_keys_and_values_are_completed_with_the_keyboard_alone(page):
    area = opened(page, '[safety]\n\n[base]\nkind = "differential"\n')
    at_end_of(page, "[safety]")
    page.keyboard.press("Enter")
    page.keyboard.type("on_f")
    page.keyboard.press("ArrowDown")
    active = page.locator(AREA).get_attribute("aria-activedescendant")
    chosen = page.locator(f"#{active}")
    assert chosen.get_attribute("aria-selected") == "true"
    assert "How to stop when something is wrong." in chosen.inner_text()
    assert axe_violations(page) == []
    page.keyboard.press("Enter")  # takes the key; then its values are listed
    wait_until(lambda: labels(page) == ["ramp", "brake", "hold", "coast"], "the values")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    assert area.input_value().startswith('[safety]\non_fault = "brake"\n')
    assert page.locator(OPTIONS).count() == 0
    page.keyboard.press("Control+z")
    assert '"brake"' not in area.input_value()
    page.keyboard.press("Control+Space")
    assert page.locator(OPTIONS).count()
    page.keyboard.press("Escape")
    assert page.locator(OPTIONS).count() == 0
    page.keyboard.press("Tab")  # moves the focus out of the editor
    assert page.evaluate("document.activeElement.tagName") != "TEXTAREA"


def test_a_completion_is_taken_by_the_mouse(page):
    area = opened(page, "[saf")
    at_end_of(page, "[saf")
    page.keyboard.press("Control+Space")
    page.locator(OPTIONS).first.click()
    assert area.input_value() == "[safety"


def test_enter_is_a_line_end_unless_a_completion_is_chosen(page):
    area = opened(page, "")
    area.press_sequentially("[limits]\nlinear_m_s = 0.4\nang\n")
    assert area.input_value() == "[limits]\nlinear_m_s = 0.4\nang\n"


@pytest.fixture(scope="module")
def programs(robot):
    """A page for tests that only call functions of its scripts."""
    with robot.page() as page:
        yield page


COMPLETE = """async ([text, cursor]) => {
    const { complete } = await import("./parts/completion.js");
    const schema = await (await fetch("robot.schema.json")).json();
    return complete(schema, text, cursor);
}"""
CASES = [
    ("[|", "header", {"robot", "limits", "line."}, {"on_fault = "}),
    ("[safety.|", "header", {"estop", "watchdog", "feedback"}, {"limits"}),
    ('[joint.left]\nline = "a"\n[joint.|', "header", {"left"}, set()),
    ("|", "key", {"[robot]", "[joint."}, set()),
    ("[safety]\non_fault = 'ramp'\non_|", "key", {"on_timeout = "}, {"on_fault = "}),
    ('[safety]\non_fa|ult = "ramp"', "key", {"on_fault"}, {"on_fault = "}),
    ("[line.a]\n|", "key", {"kind = "}, {"port = "}),
    ('[line.a]\n|\nkind = "pwm"', "key", {"pwm_chip = "}, {"port = ", "kind = "}),
    ("[line.a]\nkind = |", "value", {'"can"', '"modbus-rtu"'}, set()),
    ('[line.a]\nkind = "pwm"\n[joint.b]\nline = |', "value", {'"a"'}, set()),
    ("[joint.left]\nsteers = |", "value", {"true", "false"}, set()),
    ("[safety]\nestop = { |", "key", {"gpio_chip = "}, {"on_fault = "}),
    ("a = [\n1,\n[safety]\non_|", "key", {"on_fault = "}, set()),
]


@pytest.mark.parametrize(("marked", "mode", "offered", "absent"), CASES)
def test_what_the_schema_allows_at_the_cursor_is_offered(programs, marked, mode, offered, absent):
    text = marked.replace("|", "")
    found = programs.evaluate(COMPLETE, [text, marked.index("|")])
    inserts = {option["insert"] for option in found["options"]}
    assert found["mode"] == mode
    assert offered <= inserts
    assert not absent & inserts


@pytest.mark.parametrize(
    "marked", ["# [saf|", 'x = """\n[saf|', "[robot]\nname |", '[safety]\non_fault = "ramp" |']
)
def test_nothing_is_offered_where_the_schema_allows_nothing(programs, marked):
    found = programs.evaluate(COMPLETE, [marked.replace("|", ""), marked.index("|")])
    assert found["options"] == []


SCANNED = """async texts => {
    const { scan } = await import("./parts/toml.js");
    return texts.map(text => scan(text).entries.map(({ path }) => path));
}"""


def leaves(table, path=()):
    for key, value in table.items():
        yield [*path, key]
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))


def test_the_pages_toml_reader_finds_every_key_of_the_shipped_robot_files(programs):
    texts = [path.read_text("utf-8") for path in ROBOTS]
    for path, text, found in zip(ROBOTS, texts, programs.evaluate(SCANNED, texts), strict=True):
        data = tomllib.loads(text)
        known = [tuple(key) for key in leaves(data)]
        assert set(map(tuple, found)) <= set(known), path.name
        values = {key for key in known if not isinstance(_at(data, key), dict)}
        assert values <= set(map(tuple, found)), path.name


def _at(data, path):
    for key in path:
        data = data[key]
    return data


def test_a_problem_is_marked_at_its_line_and_the_file_is_not_written(page, file):
    before = file.read_bytes()
    changed(page, "linear_m_s = 1.0", "linear_m_s = -1.0")
    row = before.decode().split("\n").index("linear_m_s = 1.0") + 1
    checked(page, "1 problem")
    assert page.locator(".gutter .error").all_inner_texts() == [str(row)]
    assert "limits.linear_m_s" in page.locator(".messages .error").inner_text()
    assert axe_violations(page) == []
    button(page, SAVE).click()
    page.wait_for_selector(".difference [role=alert]")
    assert "Not saved" in page.locator(".difference").inner_text()
    assert button(page, "Write").count() == 0
    button(page, f"Line {row}").click()
    at = page.evaluate("document.querySelector('textarea').selectionStart")
    assert opened(page).input_value()[:at].count("\n") == row - 1
    page.keyboard.press("ArrowRight")
    assert "0.001 to 50" in page.locator(".about").inner_text()
    assert file.read_bytes() == before


def test_saving_shows_the_difference_first_and_the_robot_runs_on(robot, page, file):
    before = file.read_bytes()
    changed(page, "linear_m_s = 1.0", "linear_m_s = 0.85 # wet floor")
    button(page, SAVE).click()
    button(page, "Write").wait_for()
    assert "+linear_m_s = 0.85 # wet floor" in page.locator(".diff").inner_text()
    assert file.read_bytes() == before
    assert axe_violations(page) == []
    button(page, "Write").click()
    wait_until(lambda: "is written" in page.locator(".difference").inner_text(), "it is written")
    assert "Restart the daemon" in page.locator(".difference").inner_text()
    assert load_robot(file).limits.linear_m_s == 0.85
    [backup] = backups(file)
    assert backup.read_bytes() == before
    assert robot.stage.robot.params_get("limits.linear_m_s") == {"limits.linear_m_s": 1.0}
    assert button(page, SAVE).is_disabled()


def test_a_file_changed_by_another_program_is_compared_before_it_is_written(page, file):
    changed(page, "linear_m_s = 1.0", "linear_m_s = 0.7")
    theirs = file.read_text("utf-8") + "\n# theirs\n"
    file.write_text(theirs, "utf-8")
    button(page, SAVE).click()
    wait_until(lambda: "Not saved" in page.locator(".difference").inner_text(), "the conflict")
    assert file.read_text("utf-8") == theirs
    button(page, "Keep my text, compare it with the file now").click()
    button(page, "Write").wait_for()
    assert "-# theirs" in page.locator(".diff").inner_text()
    assert file.read_text("utf-8") == theirs
    page.locator(".difference").get_by_role("button", name="Cancel").click()
    button(page, "Discard my changes, load the file").click()
    wait_until(lambda: opened(page).input_value() == theirs, "their file")
    page.locator(AREA).focus()
    page.keyboard.press("Control+z")  # brings back the discarded text
    assert "linear_m_s = 0.7" in page.locator(AREA).input_value()


def test_an_edited_text_is_kept_while_another_tab_is_shown(page):
    changed(page, "linear_m_s = 1.0", "linear_m_s = 0.75")
    page.evaluate("location.hash = 'overview'")
    page.wait_for_selector(".overview")
    assert "linear_m_s = 0.75" in opened(page).input_value()
    assert page.locator(".robot-file header").inner_text().count("Changed, not saved") == 1


def test_a_file_that_cannot_be_written_is_offered_for_download(browser, tmp_path):
    place = tmp_path / f"{'x' * 240}.toml"  # the name of its backup is too long
    shutil.copy(ROBOT, place)
    with dashboard_of(browser, tmp_path, place, *SLOW) as robot, robot.page() as page:
        changed(page, "linear_m_s = 1.0", "linear_m_s = 0.6")
        button(page, SAVE).click()
        button(page, "Write").click()
        download = button(page, "Download the new file")
        download.wait_for()
        assert "File name too long" in page.locator(".difference").inner_text()
        assert f"sudo cp -p {place}" in page.locator(".command").inner_text()
        with page.expect_download() as found:
            download.click()
        assert found.value.path().read_text("utf-8") == page.locator(AREA).input_value()
    assert place.read_bytes() == ROBOT.read_bytes()


def test_a_page_without_the_token_is_shown_nothing_of_the_file(robot):
    with robot.page(token=None, at="file") as page:
        page.wait_for_selector("main .card")
        assert "have the token" in page.locator("main").inner_text()
        assert page.locator(AREA).count() == 0
        assert not re.search(r"\[joint\.", page.content())
