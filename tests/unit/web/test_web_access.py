# SPDX-License-Identifier: Apache-2.0
"""Rights to watch and to command through the dashboard."""

import base64

import pytest
from aiohttp import test_utils
from tests.unit.bus.bus_config_rig import errors, robot_file

from motord.bus.web.access import NEEDS_TOKEN, WRONG_TOKEN, Access, Stranger, token_of
from motord.config import WebInput, WebPublish, load_robot

TOKEN = "räder-" + "x" * 20


def fits(shown):
    return shown == TOKEN


def request(**headers):
    named = {key.replace("_", "-"): value for key, value in headers.items()}
    return test_utils.make_mocked_request(
        "GET", "/socket", headers={"Host": "127.0.0.1:8088"} | named
    )


def with_token(token, **headers):
    coded = base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")
    return request(Sec_WebSocket_Protocol=f"motord.1, token.{coded}", **headers)


def right(access, asked):
    access.check_origin(asked)
    found = access.right(asked)
    return found.watch, found.command, found.why


LOCAL = WebInput(kind="web", token_file="t")
TRUSTED = WebInput(kind="web", trust_loopback=True)
REMOTE = WebInput(kind="web", host="0.0.0.0", token_file="t", behind_proxy=True)
WATCH = WebPublish(kind="web")


def test_a_page_of_this_machine_may_watch_and_commands_only_with_the_token():
    assert right(Access(LOCAL, fits), request()) == (True, False, "")
    assert right(Access(LOCAL, fits), with_token(TOKEN)) == (True, True, "")
    assert right(Access(LOCAL, fits), with_token("wrong")) == (False, False, WRONG_TOKEN)
    assert right(Access(LOCAL, fits), with_token("")) == (False, False, WRONG_TOKEN)


def test_a_page_of_this_machine_commands_without_a_token_only_where_the_robot_file_trusts_it():
    assert right(Access(TRUSTED, None), request()) == (True, True, "")
    assert right(Access(TRUSTED, None), with_token("any")) == (True, True, "")


def test_trust_without_a_token_does_not_count_as_a_token():
    both = TRUSTED.model_copy(update={"token_file": "t"})
    assert not Access(both, fits).right(request()).token
    assert not Access(TRUSTED, None).right(with_token(TOKEN)).token
    assert Access(both, fits).right(with_token(TOKEN)).token


def test_a_dashboard_that_only_publishes_takes_no_command_with_any_token():
    assert right(Access(WATCH, None), request()) == (True, False, "")
    assert right(Access(WATCH, fits), with_token(TOKEN)) == (True, False, "")


def test_a_page_of_another_machine_needs_the_token_to_watch():
    assert right(Access(REMOTE, fits), request()) == (False, False, NEEDS_TOKEN)
    assert right(Access(REMOTE, fits), with_token(TOKEN, Host="r2:8088")) == (True, True, "")


@pytest.mark.parametrize("host", ["evil.example:8088", "127.0.0.1.evil.example", "", "10.0.0.1"])
def test_a_site_whose_name_resolves_to_this_machine_gets_nothing(host):
    asked = request(Host=host, Origin=f"http://{host}")
    assert right(Access(TRUSTED, None), asked) == (False, False, NEEDS_TOKEN)


@pytest.mark.parametrize("header", ["X_Forwarded_For", "Forwarded", "Via", "X_Real_IP"])
def test_what_a_proxy_forwards_does_not_count_as_this_machine(header):
    asked = request(**{header: "10.0.0.9"})
    assert right(Access(TRUSTED, None), asked) == (False, False, NEEDS_TOKEN)


@pytest.mark.parametrize("host", ["127.0.0.1:8088", "localhost:8088", "[::1]:8088", "localhost"])
def test_every_name_of_this_machine_is_accepted(host):
    assert right(Access(TRUSTED, None), request(Host=host))[0]


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "http://127.0.0.1:9999", "null", "http://127.0.0.1:80880"]
)
def test_a_page_of_another_site_may_not_connect_even_with_the_token(origin):
    for access in (Access(LOCAL, fits), Access(TRUSTED, None)):
        with pytest.raises(Stranger):
            access.check_origin(with_token(TOKEN, Origin=origin))


def test_a_page_of_this_dashboard_and_of_its_fleet_may_connect():
    fleet = LOCAL.model_copy(update={"fleet": ("https://R2.example:443", "http://r3:8088")})
    access = Access(fleet, fits)
    for origin in ("http://127.0.0.1:8088", "https://r2.example", "http://r3:8088"):
        access.check_origin(request(Origin=origin))
    with pytest.raises(Stranger):
        access.check_origin(request(Origin="http://r2.example"))


def test_a_program_shows_the_token_in_a_header():
    assert token_of(request(Authorization=f"Bearer {TOKEN}")) == TOKEN
    assert token_of(request(Authorization="Basic eA==")) is None
    assert token_of(request(Sec_WebSocket_Protocol="token.%%%")) == ""


OPEN = '[input.web]\nkind = "web"\nhost = "0.0.0.0"\n'


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ('[input.web]\nkind = "web"\n', {"input.web.token_file"}),
        (OPEN + 'token_file = "t"\n', {"input.web.cert_file"}),
        (OPEN + "trust_loopback = true\nbehind_proxy = true\n",
         {"input.web.token_file", "input.web.trust_loopback"}),
        ('[publish.web]\nkind = "web"\nhost = "10.0.0.1"\n',
         {"publish.web.token_file", "publish.web.cert_file"}),
        ('[publish.web]\nkind = "web"\nfleet = ["r2.example"]\n', {"publish.web.fleet[0]"}),
        ('[publish.web]\nkind = "web"\ncert_file = "c"\n', {"publish.web.key_file"}),
    ],
)  # fmt: skip
def test_a_robot_file_that_would_open_the_robot_to_others_is_refused(tmp_path, text, keys):
    assert {row.partition(": ")[0] for row in errors(tmp_path, text)} == keys


def test_a_dashboard_behind_a_proxy_needs_no_certificate(tmp_path):
    text = OPEN + 'token_file = "t"\nbehind_proxy = true\n'
    warnings = [row.text for row in load_robot(robot_file(tmp_path, text)).warnings]
    assert any("every network interface" in text for text in warnings)


def test_a_robot_file_that_trusts_this_machine_is_warned_of(tmp_path):
    text = '[input.web]\nkind = "web"\ntrust_loopback = true\n'
    warnings = [row.text for row in load_robot(robot_file(tmp_path, text)).warnings]
    assert "every user of this machine can arm and drive by it" in warnings
