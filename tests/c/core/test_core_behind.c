/* SPDX-License-Identifier: Apache-2.0
 * test_core_behind: entries after the last joint do not count, whatever their numbers. */
#include "steered_bases.h"

static rig r;

/* Adds a joint after the last one: slower, warmer and with a stronger loop than the others.
 * `takes_position`: whether it takes positions. */
static core_config with_one_behind(core_config config, uint32_t takes_position)
{
    joint_config behind = rolling();
    behind.row = (wheel_row){NAN, NAN, NAN};
    behind.wheel_radius_m = 0.0;
    behind.velocity_min_rad_s = -1e-9, behind.velocity_max_rad_s = 1e-9;
    behind.pwm = (pwm_config){0.0, -1e-9, 1e-9, 1e-3, 1.0};
    behind.speed_loop =
        (speed_loop_config){.kind = SPEED_LOOP_DUTY, .gains = {.gain_u_s_per_rad = 1.0}};
    behind.derating.range[DERATED_BY_TEMPERATURE] = (derating_range){60.0, 80.0};
    behind.plausible = (plausible_config){
        .slow_rad_s = 0.1, .stall_s = 1e-3, .runaway_s = 1e-3, .direction_s = 1e-3};
    behind.position = turning_within(2.0).position;
    behind.position.reference = REFERENCE_HOMED; /* it has never been homed */
    behind.position.following_rad = 1e-3, behind.position.following_s = 1e-3;
    behind.position.used = takes_position;
    config.joint[config.joint_count] = behind;
    for (uint32_t j = 0; j < config.joint_count; j++) {
        config.joint[j].pwm.slew_per_s = INFINITY;
    }
    return config;
}

typedef struct {
    joint_odometry odometry;
    joint_state shown;
    plausible_state plausible;
    position_profile profile;
    position_following following;
    speed_loop_shown loop;
    double angle_rad, setpoint_rad;
    uint32_t stale;
} place;

static void note(place *found)
{
    const core_state *state = &r.state;
    uint32_t j = state->config.joint_count;
    memset(found, 0, sizeof *found);
    memcpy(&found->odometry, &state->odometry.joint[j], sizeof found->odometry);
    memcpy(&found->shown, &state->snapshot.joint[j], sizeof found->shown);
    memcpy(&found->plausible, &state->plausible[j], sizeof found->plausible);
    memcpy(&found->profile, &state->steer.profile[j], sizeof found->profile);
    memcpy(&found->following, &state->steer.following[j], sizeof found->following);
    memcpy(&found->loop, &state->snapshot.speed_loop[j], sizeof found->loop);
    found->angle_rad = state->odometry.angle_rad[j];
    found->setpoint_rad = state->snapshot.steering.position_setpoints_rad[j];
    found->stale = state->stale[j];
}

static void write_behind(uint32_t j)
{
    core_state *state = &r.state;
    r.input.feedback[j] = (joint_feedback){.stamp_ns = r.input.now_ns,
                                           .count = 5000,
                                           .velocity_rad_s = 99.0,
                                           .temperature_c = 200.0,
                                           .drive_faults = 1};
    r.input.joints.value_u[j] = 0.5, r.input.joints.named |= 1U << j;
    r.input.control.gains[j].gain_u_s_per_rad = NAN;
    state->wheels.joint[j] = (joint_setpoint){NAN, NAN, NAN};
    state->odometry.joint[j].last = BELIEVED, state->odometry.joint[j].count = 5000;
    state->odometry.joint[j].velocity_rad_s = 99.0, state->odometry.joint[j].position_rad = NAN;
    state->odometry.joint[j].stamp_ns = r.input.now_ns;
    state->odometry.angle_rad[j] = 1.5;
    state->plausible[j].stamp_ns = 7;
    state->steer.profile[j] = (position_profile){.position_rad = 0.7, .velocity_rad_s = 0.2};
    state->snapshot.joint[j].setpoint_rad_s = state->snapshot.joint[j].duty = 0.3;
    state->snapshot.joint[j].feedback_age_s = 5.0;
    state->snapshot.steering.position_setpoints_rad[j] = 6.0;
    state->snapshot.speed_loop[j].output_u = 4.0;
}

/* Writes numbers into the entry after the last joint, makes one tick, and checks that the entry has
 * not changed. */
static const robot_state *tick_beside(void)
{
    uint32_t j = r.config.joint_count;
    place before, after;
    write_behind(j);
    note(&before);
    tick(&r);
    note(&after);
    CHECK(memcmp(&before, &after, sizeof before) == 0);
    CHECK((r.state.slewed | r.state.loops) == 0 &&
          r.state.derates == derating_used(&r.config.joint[0].derating));
    CHECK(r.shown.steering.position_joints >> j == 0);
    CHECK(r.state.steer.unknown >> j == 0 && r.out.positioned >> j == 0 &&
          r.out.position_rad[j] == 0.0);
    CHECK(r.shown.derating.since_ns == 0 && r.shown.odometry_degraded == 0 &&
          r.shown.doubt.fault == 0);
    return &r.shown;
}

static void no_tick_reads_or_changes_entries_after_the_last_joint(void)
{
    const core_config bases[] = {good_config(), bicycle(), ackermann(WHEELBASE_M), head_and_belt()};
    for (uint32_t i = 0; i < 2 * COUNT_OF(bases); i++) {
        core_config config = with_one_behind(bases[i / 2], i % 2);
        config.joint[0].derating =
            i % 2 == 0 ? config.joint[0].derating : config.joint[config.joint_count].derating;
        ready(&r, &config);
        for (int ms = 0; ms < 5; ms++) {
            CHECK(tick_beside()->at_rest == 1 && r.shown.reasons == REASON_NOT_ARMED);
        }
        r.input.control.armed = 1;
        CHECK(tick_beside()->armed == 1 && r.shown.faults == 0);
        r.input.command.linear_m_s = 0.4, r.input.command.angular_rad_s = 0.2;
        r.input.joints = (joint_command){.named = 3, .value_u = {0.2, 1.0}};
        for (int ms = 0; ms < 1200; ms++) {
            CHECK(tick_beside()->faults == 0 && r.shown.armed == 1);
        }
        CHECK(r.shown.reasons == 0 && r.shown.saturation == 1.0 && r.shown.at_rest == 0);
        r.input.command.linear_m_s = r.input.command.angular_rad_s = 0.0;
        r.input.control.armed = 0; /* the power goes off in this tick */
        CHECK(tick_beside()->faults == 0 && r.out.enabled == 0);
        CHECK(tick_beside()->at_rest == 1 && r.shown.reasons == REASON_NOT_ARMED);
    }
}

int main(void)
{
    no_tick_reads_or_changes_entries_after_the_last_joint();
    return checks_report("test_core_behind");
}
