# SPDX-License-Identifier: Apache-2.0
"""Clients on a middleware that does not read our answers are named."""

from motord.base.rate_limited_log import AGAIN_S
from motord.bus.ros2.dds.unanswered import NAMED_WITHIN_S, Unanswered, answered, middleware

FAST, RTI, CYCLONE = b"\x01\x0f", b"\x01\x01", b"\x01\x10"
ARM, STOP = "/motord/arm", "/motord/stop"


def gid(number, vendor=FAST):
    return vendor + bytes(10) + number.to_bytes(4, "big")


def test_a_middleware_is_recognized_by_its_makers_number():
    assert middleware(gid(1)) == "Fast DDS"
    assert middleware(gid(1, RTI)) == "RTI Connext"
    assert middleware(gid(1, b"\x01\x42")) == "DDS of vendor 01.42"
    assert answered(gid(1, CYCLONE))
    assert not answered(gid(1))


def test_a_client_is_named_once_with_all_that_it_calls(caplog):
    made = Unanswered({gid(1): "/panel", gid(2): "/panel"}.get)
    made.add(gid(1), ARM, 0.0)
    made.add(gid(2), STOP, 0.0)
    made.say(0.0)
    assert f"/panel (Fast DDS) calls {ARM}, {STOP}: run" in caplog.text
    made.add(gid(1), ARM, AGAIN_S)
    made.say(AGAIN_S + 1.0)
    assert len(caplog.records) == 1


def test_a_client_that_the_graph_does_not_name_yet_is_waited_for(caplog):
    names = {}
    made = Unanswered(names.get)
    made.add(gid(1), ARM, 0.0)
    made.say(0.0)
    assert not caplog.records
    names[gid(1)] = "/panel"
    made.say(2.0)
    assert "/panel (Fast DDS)" in caplog.text


def test_a_client_without_a_node_is_reported_by_its_endpoint(caplog):
    made = Unanswered({}.get)
    made.add(gid(1), ARM, 0.0)
    made.say(NAMED_WITHIN_S)
    assert f"endpoint {gid(1).hex()} (Fast DDS) calls {ARM}" in caplog.text


def test_many_clients_are_few_lines_and_nothing_is_lost_between_them(caplog):
    names = {gid(number): f"/panel{number}" for number in range(8)}
    made = Unanswered(names.get)
    for number in names:
        made.add(number, ARM, 0.0)
    for now_s in (0.0, 1.0, AGAIN_S, AGAIN_S + 1.0):
        made.say(now_s)
    assert len(caplog.records) == 2
    assert all(f"{name} (Fast DDS)" in caplog.text for name in names.values())


def test_a_flood_of_clients_is_counted(caplog):
    made = Unanswered(lambda _: "/flood")
    for number in range(1000):
        made.add(gid(number), f"/service{number}", 0.0)
    made.say(0.0)
    (record,) = caplog.records
    assert "and 60 more (936 more)" in record.getMessage()
    assert len(record.getMessage()) < 1000
