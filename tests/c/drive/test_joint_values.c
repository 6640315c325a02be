/* SPDX-License-Identifier: Apache-2.0
 * test_joint_values: how a line of any medium converts a set-point. */
#include <string.h>

#include "check.h"
#include "joint_values.h"

/* Set-points that differ for each joint. */
static setpoints all_of(uint32_t joints)
{
    setpoints from = {.enabled = 1, .joint_count = joints, .positioned = 0xFF};
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        from.joint[j] = (joint_setpoint){1.0 + j, 0.01 * (j + 1), 20.0 + j};
        from.position_rad[j] = -0.1 * (j + 1);
    }
    return from;
}

static void an_angle_is_that_of_its_joint_where_it_counts(void)
{
    for (uint32_t joint = 0; joint <= JOINTS_MAX; joint++) {
        setpoints from = all_of(6);
        double position_rad = 7.0;
        bool is_there = joint < 6;
        CHECK(setpoint_position(&from, joint, &position_rad) == is_there);
        CHECK(position_rad == (is_there ? from.position_rad[joint] : 7.0));
        CHECK(is_there ? setpoint_of(&from, joint, SETPOINT_POSITION) == position_rad
                       : isnan(setpoint_of(&from, joint, SETPOINT_POSITION)));
        from.positioned = is_there ? 0xFFU & ~(1U << joint) : 0xFF;
        CHECK(!setpoint_position(&from, joint, &position_rad) &&
              isnan(setpoint_of(&from, joint, SETPOINT_POSITION)));
        from = all_of(8);
        from.enabled = 0;
        CHECK(!setpoint_position(&from, joint, &position_rad));
        from = all_of(8);
        from.position_rad[joint % JOINTS_MAX] = NAN;
        CHECK(!setpoint_position(&from, joint, &position_rad));
        from = all_of(JOINTS_MAX + 1); /* a count beyond the table */
        from.positioned = ~0U;
        CHECK(setpoint_position(&from, joint, &position_rad) == (joint < JOINTS_MAX));
    }
}

static void a_speed_a_duty_and_a_torque_are_those_of_their_joint(void)
{
    for (uint32_t joint = 0; joint <= JOINTS_MAX; joint++) {
        setpoints from = all_of(6);
        bool is_there = joint < 6;
        CHECK(setpoint_of(&from, joint, SETPOINT_VELOCITY) ==
              (is_there ? from.joint[joint].velocity_rad_s : 0.0));
        CHECK(setpoint_of(&from, joint, SETPOINT_DUTY) ==
              (is_there ? from.joint[joint].duty : 0.0));
        CHECK(setpoint_of(&from, joint, SETPOINT_TORQUE) ==
              (is_there ? from.joint[joint].torque_n_m : 0.0));
        from.joint[joint % JOINTS_MAX].velocity_rad_s = INFINITY;
        CHECK(setpoint_of(&from, joint, SETPOINT_VELOCITY) == 0.0);
        from = all_of(JOINTS_MAX + 1); /* a count beyond the table */
        CHECK(setpoint_of(&from, JOINTS_MAX, SETPOINT_VELOCITY) == 0.0);
    }
}

static void a_number_is_scaled_and_kept_within_its_ends(void)
{
    setpoints from = all_of(4);
    setpoint_scale scale = {.joint = 2,
                            .kind = SETPOINT_VELOCITY,
                            .raw_per_si = 10.0,
                            .raw_min = -500.0,
                            .raw_max = 600.0};
    CHECK(scaled(&from, true, &scale) == 30.0 && scaled(&from, false, &scale) == 0.0);
    from.joint[2].velocity_rad_s = -3.0;
    CHECK(scaled(&from, true, &scale) == -30.0);
    from.joint[2].velocity_rad_s = 90.0;
    CHECK(scaled(&from, true, &scale) == 600.0);
    from.joint[2].velocity_rad_s = -90.0;
    CHECK(scaled(&from, true, &scale) == -500.0);
}

int main(void)
{
    an_angle_is_that_of_its_joint_where_it_counts();
    a_speed_a_duty_and_a_torque_are_those_of_their_joint();
    a_number_is_scaled_and_kept_within_its_ends();
    return checks_report("test_joint_values");
}
