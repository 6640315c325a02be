/* SPDX-License-Identifier: Apache-2.0
 * test_snapshot: the report of a tick: each field has its own value, and is NaN if it is not
 * measured. */
#include <stdlib.h>

#include "steered_bases.h"

static rig *r;

static core_config config_with_gyro(void)
{
    core_config config = good_config();
    config.gyro = good_gyro(0.05);
    return config;
}

/* Makes a tick in which the sensor reports this rate about z. */
static const robot_state *tick_with(double rate_rad_s)
{
    r->input.imu = (imu_sample){.stamp_ns = r->input.now_ns + TICK_NS,
                                .angular_rad_s = {0.25, -0.5, rate_rad_s},
                                .acceleration_m_s2 = {1.0, 2.0, 9.5}};
    return tick(r);
}

static void begin(void)
{
    core_config config = config_with_gyro();
    start(r, &config);
    for (uint32_t j = 0; j < config.joint_count; j++) {
        joint_feedback *feedback = &r->input.feedback[j];
        feedback->current_a = 1.0 + j, feedback->voltage_v = 24.0 + j,
        feedback->temperature_c = 40.0 + j;
    }
    for (int i = 0; i < 2500; i++) {
        (void)tick_with(0.125); /* until the gyro's bias is known */
    }
}

static void drive(void)
{
    r->input.control.armed = 1;
    (void)tick_with(0.125);
    r->input.command.linear_m_s = 0.5, r->input.command.angular_rad_s = 0.75;
    for (int i = 0; i < 1500; i++) {
        (void)tick_with(0.875);
    }
}

static void each_wheel_is_reported_separately(void)
{
    begin();
    drive();
    r->input.feedback[1].drive_faults = 0; /* a fault would stop the base; the fault word is checked
                                              below */
    const robot_state *shown = tick_with(0.875);
    for (uint32_t j = 0; j < 4; j++) {
        const joint_state *joint = &shown->joint[j];
        const joint_odometry *odometry = &r->state.odometry.joint[j];
        CHECK(joint->position_rad == odometry->position_rad && fabs(joint->position_rad) > 1.0);
        CHECK(joint->velocity_rad_s == odometry->velocity_rad_s &&
              fabs(joint->velocity_rad_s) > 1.0);
        CHECK(joint->current_a == 1.0 + j && joint->voltage_v == 24.0 + j &&
              joint->temperature_c == 40.0 + j);
        CHECK(joint->enabled == 1 && joint->stale == 0 && joint->drive_faults == 0);
    }
    CHECK(shown->joint[0].position_rad != shown->joint[1].position_rad);
    r->input.feedback[2].current_a = r->input.feedback[2].voltage_v =
        r->input.feedback[2].temperature_c = INFINITY;
    r->input.feedback[2].drive_faults = 0x30;
    shown = tick_with(0.875);
    CHECK(isnan(shown->joint[2].current_a) && isnan(shown->joint[2].voltage_v) &&
          isnan(shown->joint[2].temperature_c));
    CHECK(shown->joint[2].drive_faults == 0x30 && shown->joint[3].drive_faults == 0 &&
          shown->joint[3].current_a == 4.0);
}

static void a_wheel_without_fresh_feedback_has_no_values(void)
{
    core_config config = good_config();
    start(r, &config);
    r->stale = true;
    r->input.feedback[0].stamp_ns = 1;
    r->input.feedback[1].stamp_ns = r->input.now_ns;
    const robot_state *shown = tick(r);
    CHECK(shown->joint[1].current_a == 0.0 && shown->joint[1].enabled == 1);
    for (int j = 0; j < 4; j += 2) {
        CHECK(isnan(shown->joint[j].current_a) && isnan(shown->joint[j].voltage_v) &&
              isnan(shown->joint[j].temperature_c));
        CHECK(shown->joint[j].enabled == 2 && shown->joint[j].stale == 1);
    }
}

static void a_twist_that_nothing_measures_has_no_covariance(void)
{
    begin();
    drive();
    const robot_state *shown = &r->shown;
    int64_t stamp_ns = shown->odometry_stamp_ns;
    double x_m = shown->x_m;
    r->stale = true;
    for (int j = 0; j < 4; j++) {
        r->input.feedback[j].stamp_ns = 1;
    }
    shown = tick(r);
    CHECK(isnan(shown->linear_m_s) && isnan(shown->angular_rad_s) &&
          isnan(shown->lateral.lateral_m_s) && isnan(shown->lateral.slip_m_s));
    for (int i = 0; i < 3; i++) {
        CHECK(isnan(shown->twist_covariance[i]));
    }
    CHECK(shown->odometry_stamp_ns == stamp_ns && shown->x_m == x_m);
}

static void all_of_the_odometry_is_reported(void)
{
    begin();
    drive();
    const odometry_state *from = &r->state.odometry;
    const robot_state *shown = &r->shown;
    CHECK(shown->x_m == from->x_m && shown->y_m == from->y_m &&
          shown->heading_rad == from->heading_rad);
    CHECK(shown->distance_m == from->distance_m && shown->turned_rad == from->turned_rad);
    CHECK(fabs(shown->x_m) > 0.01 && fabs(shown->y_m) > 0.01 && shown->distance_m > 0.1 &&
          shown->turned_rad > 0.1);
    CHECK(shown->linear_m_s == from->linear_m_s && shown->angular_rad_s == from->angular_rad_s);
    CHECK(shown->linear_m_s > 0.1 && shown->angular_rad_s > 0.1);
    CHECK(shown->odometry_stamp_ns == from->stamp_ns && shown->odometry_stamp_ns > 0);
    for (int i = 0; i < 6; i++) {
        CHECK(shown->pose_covariance[i] == from->pose_covariance[i]);
        CHECK(i >= 3 || shown->twist_covariance[i] == from->twist_covariance[i]);
    }
    CHECK(shown->pose_covariance[0] > 0.0 && shown->pose_covariance[5] > 0.0 &&
          shown->twist_covariance[0] > 0.0);
    r->input.control.odometry_reset_count++;
    uint32_t epoch = shown->odometry_epoch;
    CHECK(tick_with(0.875)->odometry_epoch == epoch + 1 && r->state.odometry.epoch == epoch + 1);
}

static void the_bias_of_the_sensor_is_subtracted(void)
{
    core_config config = config_with_gyro();
    start(r, &config);
    const imu_state *imu = &tick_with(0.125)->imu;
    CHECK(isnan(imu->bias_rad_s) && isnan(imu->bias_variance_rad2_s2) &&
          isnan(imu->rate_variance_rad2_s2));
    CHECK(imu->state == gyro_status(&r->state.odometry.gyro, &config.gyro, r->input.now_ns) &&
          imu->heading_by_gyro == 0);
    begin();
    const gyro_state *gyro = &r->state.odometry.gyro;
    imu = &r->shown.imu;
    CHECK(imu->bias_rad_s == gyro->bias_rad_s && fabs(imu->bias_rad_s - 0.125) < 1e-9 &&
          imu->still == 1);
    CHECK(imu->bias_variance_rad2_s2 == gyro->bias_variance_rad2_s2 && imu->state == GYRO_USED);
    CHECK(imu->rate_variance_rad2_s2 == gyro->rate_variance_rad2_s2);
    CHECK(imu->angular_rad_s[0] == 0.25 && imu->angular_rad_s[1] == -0.5 &&
          fabs(imu->angular_rad_s[2]) < 1e-9);
    CHECK(imu->acceleration_m_s2[0] == 1.0 && imu->acceleration_m_s2[1] == 2.0 &&
          imu->acceleration_m_s2[2] == 9.5);
    CHECK(imu->stamp_ns == r->input.now_ns);
    drive();
    CHECK(fabs(r->shown.imu.angular_rad_s[2] - 0.75) < 1e-9 && r->shown.imu.heading_by_gyro == 1 &&
          r->shown.imu.still == 0);
    r->input.imu.angular_rad_s[2] = 1e9;
    r->input.imu.angular_rad_s[0] = r->input.imu.acceleration_m_s2[1] = INFINITY;
    r->input.imu.stamp_ns += TICK_NS;
    imu = &tick(r)->imu;
    CHECK(imu->refused == gyro->refused && imu->refused > 0 && isnan(imu->angular_rad_s[0]) &&
          isnan(imu->acceleration_m_s2[1]));
    config.gyro.used = 0;
    start(r, &config);
    CHECK(tick_with(0.5)->imu.stamp_ns == 0);
}

static void the_motion_of_the_base_and_its_reasons_are_reported(void)
{
    begin();
    r->input.control.machine_state = 5, r->input.control.owner = 7;
    const robot_state *shown = tick_with(0.125);
    CHECK(shown->stamp_ns == r->input.now_ns && shown->tick == r->state.tick && shown->tick > 2000);
    CHECK(shown->machine_state == 5 && shown->owner == 7 && shown->armed == 0 &&
          shown->at_rest == 1 && shown->enabled == 0);
    CHECK((shown->reasons & REASON_NOT_ARMED) != 0 &&
          (shown->reasons & (REASON_STOP_REQUESTED | REASON_FAULT)) == 0);
    CHECK(shown->dt_s == 1e-3 && shown->faults == 0 && shown->command_age_s >= 0.0);
    r->input.control.stop = 1;
    CHECK((tick_with(0.125)->reasons & REASON_STOP_REQUESTED) != 0);
    r->input.control.stop = 0;
    drive();
    shown = tick_with(0.875);
    CHECK(shown->armed == 1 && shown->enabled == 1 && shown->at_rest == 0 &&
          (shown->reasons & REASON_NOT_ARMED) == 0);
    CHECK(shown->wanted_linear_m_s == 0.5 && shown->wanted_angular_rad_s == 0.75);
    CHECK(shown->setpoint_linear_m_s == 0.5 && shown->setpoint_angular_rad_s == 0.75 &&
          shown->saturation == 1.0);
    r->mute = true;
    r->input.command.stamp_ns = r->input.now_ns - 50 * MS_NS;
    shown = tick_with(0.875);
    CHECK(fabs(shown->command_age_s - 0.051) < 1e-9);
    r->input.command.stamp_ns = r->input.now_ns + 2 * TICK_NS; /* a little ahead: its age is 0 */
    CHECK(tick_with(0.875)->command_age_s == 0.0);
    r->input.command.stamp_ns = r->input.now_ns - 400 * MS_NS;
    shown = tick_with(0.875);
    CHECK(shown->wanted_linear_m_s == 0.0 && shown->wanted_angular_rad_s == 0.0 &&
          shown->command_age_s > 0.4);
    r->mute = false;
    r->input.feedback[1].drive_faults = 1;
    shown = tick_with(0.875);
    CHECK(shown->faults == r->state.faults && shown->faults != 0 &&
          (shown->reasons & REASON_FAULT) != 0 && shown->armed == 0);
}

static void a_heading_stays_within_half_a_turn(void)
{
    begin();
    drive();
    for (int i = 0; i < 8000; i++) {
        CHECK(fabs(tick_with(0.875)->heading_rad) <= 3.14159265358979324);
    }
    CHECK(r->shown.turned_rad > 6.5);
}

/* The base strafes, and one wheel slips. */
static void lateral_motion_is_reported_like_the_other_two(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        config.joint[j].row.y = j == 0 || j == 3 ? -1.0 : 1.0;
    }
    start(r, &config);
    go(r, 0.2, 0.0);
    r->input.command.lateral_m_s = 0.25;
    for (int i = 0; i < 1500; i++) {
        r->position_rad[0] += 0.0005;
        tick(r);
    }
    const odometry_state *from = &r->state.odometry;
    const lateral_state *lateral = &r->shown.lateral;
    CHECK(lateral->wanted_lateral_m_s == 0.25 && lateral->setpoint_lateral_m_s == 0.25 &&
          r->state.axis[AXIS_LATERAL].velocity_u_s == 0.25);
    CHECK(lateral->lateral_m_s == from->lateral_m_s && lateral->lateral_m_s > 0.1);
    CHECK(lateral->slip_m_s == from->spread.slip_m_s && lateral->slip_m_s > 0.001);
    for (int i = 0; i < 3; i++) {
        CHECK(lateral->lateral_covariance[i] == from->lateral_covariance[i] &&
              lateral->lateral_covariance[i] != 0.0);
    }
    r->mute = true;
    CHECK(ticks(r, 310)->lateral.wanted_lateral_m_s == 0.0);
    config = good_config();
    start(r, &config);
    go(r, 0.2, 0.0);
    /* this base has no lateral axis */
    r->state.odometry.lateral_covariance[0] = r->state.odometry.lateral_covariance[2] = 1.0;
    CHECK(tick(r)->lateral.lateral_covariance[0] == 0.0 &&
          r->shown.lateral.lateral_covariance[2] == 0.0);
}

/* A steering joint is reported with its angle, and with its target while it has power and a known
 * position. */
static void joints_that_take_positions_are_reported_with_their_set_points(void)
{
    core_config config = bicycle();
    config.joint[1].position.reference = REFERENCE_HOMED;
    start(r, &config);
    r->input.feedback[1].referenced = 1;
    r->position_rad[1] = 0.125;
    const robot_state *shown = ticks(r, 3);
    const steering_state *steering = &r->shown.steering;
    CHECK(steering->position_joints == 2 && isnan(steering->position_setpoints_rad[0]) &&
          isnan(steering->position_setpoints_rad[1]));
    CHECK(fabs(shown->joint[1].position_rad - 0.125) < 2e-5 &&
          shown->joint[1].setpoint_rad_s == 0.0);
    r->input.control.armed = 1;
    CHECK(tick(r)->armed == 1);
    r->input.command.linear_m_s = 0.5, r->input.command.angular_rad_s = 0.9;
    for (int ms = 0; ms < 50; ms++) {
        shown = tick(r);
        CHECK(steering->misaligned_rad == r->state.steer.misaligned_rad &&
              steering->misaligned_rad > 0.1);
        CHECK(steering->position_setpoints_rad[1] == r->out.position_rad[1] &&
              isnan(steering->position_setpoints_rad[0]));
        CHECK(shown->joint[1].setpoint_rad_s == r->out.joint[1].velocity_rad_s &&
              shown->joint[1].setpoint_rad_s > 0.0);
        CHECK(shown->joint[1].position_rad == r->state.odometry.angle_rad[1] &&
              steering->position_joints == 2);
    }
    r->input.feedback[1].referenced = 0;
    shown = tick(r);
    CHECK(shown->faults == FAULT_POSITION_UNKNOWN && shown->enabled == 1 &&
          steering->position_unknown == 2);
    CHECK(isnan(steering->position_setpoints_rad[1]) && shown->joint[1].setpoint_rad_s == 0.0);
}

static void every_reason_is_reported_independently_with_its_start_time(void)
{
    core_config config = bicycle();
    config.joint[1].position.reference = REFERENCE_HOMED;
    start(r, &config);
    r->mute = true;
    r->input.control.stop = r->input.control.estop = 1;
    uint32_t all = REASON_NOT_ARMED | REASON_POSITION_UNKNOWN | REASON_STOP_REQUESTED |
                   REASON_FAULT | REASON_COMMAND_STALE;
    const robot_state *shown = ticks(r, 2);
    int64_t since_ns = r->input.now_ns - TICK_NS;
    for (int i = 0; i < 3; i++) {
        CHECK(shown->reasons == all);
        for (uint32_t bit = 0; bit < REASONS_MAX; bit++) {
            CHECK((shown->reason.since_ns[bit] != 0) == ((all >> bit & 1U) != 0));
        }
        shown = tick(r);
    }
    CHECK(since_ns < shown->stamp_ns && shown->reason.since_ns[16] <= since_ns);
    r->input.control.stop = 0; /* one reason ends; the others keep the time of their beginning */
    all &= ~(uint32_t)REASON_STOP_REQUESTED;
    shown = tick(r);
    for (uint32_t bit = 0; bit < REASONS_MAX; bit++) {
        int64_t since = shown->reason.since_ns[bit];
        CHECK((all >> bit & 1U) != 0 ? since > 0 && since < shown->stamp_ns : since == 0);
    }
    CHECK(shown->reasons == all);
    core_config base = good_config();
    start(r, &base);
    go(r, 0.5, 0.0);
    r->input.command.linear_m_s = 1.05; /* beyond the limit: a single reason, the first bit */
    r->input.control.limits.linear.velocity_u_s = 0.5;
    since_ns = tick(r)->stamp_ns;
    shown = ticks(r, 3);
    CHECK(shown->reasons == REASON_LINEAR_VELOCITY && shown->reason.since_ns[0] == since_ns);
    r->input.command.linear_m_s = 0.5;
    CHECK(tick(r)->reasons == 0 && shown->reason.since_ns[0] == 0);
}

int main(void)
{
    r = malloc(sizeof *r);
    each_wheel_is_reported_separately();
    a_wheel_without_fresh_feedback_has_no_values();
    a_twist_that_nothing_measures_has_no_covariance();
    all_of_the_odometry_is_reported();
    the_bias_of_the_sensor_is_subtracted();
    the_motion_of_the_base_and_its_reasons_are_reported();
    a_heading_stays_within_half_a_turn();
    lateral_motion_is_reported_like_the_other_two();
    joints_that_take_positions_are_reported_with_their_set_points();
    every_reason_is_reported_independently_with_its_start_time();
    free(r);
    return checks_report("snapshot");
}
