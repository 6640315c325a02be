# SPDX-License-Identifier: Apache-2.0
"""The base from above, in a real browser."""

import math

DIRECTION = """([wheel, positions]) => import('/base_view.js').then(view => view.directionOf(
    wheel, {joints: ['wheel', 'steering']},
    {joints: positions.map(position_rad => ({position_rad}))}))"""


def direction_rad(page, steered_by, *positions_rad):
    wheel = {"heading_rad": 0.25, "steered_by": steered_by}
    return page.evaluate(DIRECTION, [wheel, positions_rad])


def test_a_wheel_points_where_the_joint_is_that_steers_it(page):
    assert direction_rad(page, None, 7.0, 0.5) == 0.25
    assert direction_rad(page, "steering", 7.0, 0.5) == 0.75
    assert math.isnan(direction_rad(page, "steering", 7.0, math.nan))
    assert math.isnan(direction_rad(page, "steering", 7.0))
