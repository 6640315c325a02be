/* SPDX-License-Identifier: Apache-2.0
 *
 * travel.h: the travel of each wheel from one sample of its joint to the next. A part of
 * odometry.c. */
#ifndef MOTORD_TRAVEL_H
#define MOTORD_TRAVEL_H

#include "core.h"

#include <math.h>

/* Factor of its configured limit that a wheel may reach (downhill, pushed) before its counter
 * counts as wrong. */
static const double JUMP_MARGIN = 1.5;
static const double JUMP_SLACK_COUNTS = 4.0;
/* Acceleration that no wheel exceeds: of a hub motor at its greatest torque, without a load. */
static const double WHEEL_RAD_S2 = 100.0;
/* Relative error of a measured velocity: it is filtered, rounded to rpm, and late. */
static const double VELOCITY_ERROR = 0.1;

/* Bits of joint_odometry.fresh: the events since the last integration. */
enum { NOTHING = 0, TRAVEL = 1 << 0, ESTIMATE = 1 << 1, SEED = 1 << 2 };

/* Return the difference with sign. unused: number of bits of the word that are not the counter's,
 * 0..63. */
static inline int64_t shortest_difference(uint64_t now, uint64_t before, uint32_t unused)
{
    /* the counter's sign bit becomes the word's; the shift back extends it */
    return (int64_t)((now - before) << unused) >> unused;
}

/* Return the larger one; b if a is NaN: the floor holds. */
static inline double larger(double a, double b)
{
    return a > b ? a : b;
}

static inline double smaller(double a, double b)
{
    return a < b ? a : b;
}

static joint_constants constants_of(const joint_config *joint, double timeout_s)
{
    joint_constants found = {
        .wheel_radius_m = joint->wheel_radius_m,
        .reach_rad_s = JUMP_MARGIN * larger(joint->velocity_max_rad_s, -joint->velocity_min_rad_s),
    };
    if (joint->counter_bits == 0) {
        return found;
    }
    double rad_per_count = fabs(joint->rad_per_count);
    found.counter_bits_unused = 64 - joint->counter_bits;
    found.counter_rad = joint->rad_per_count;
    found.counter_slack_rad = JUMP_SLACK_COUNTS * rad_per_count;
    found.counter_round_rad = ldexp(rad_per_count, (int)joint->counter_bits);
    found.counter_unused_max_rad =
        smaller(found.reach_rad_s * timeout_s, 0.25 * found.counter_round_rad);
    return found;
}

/* Return the travel by the drive's own measured velocity, at both ends if it was measured at both;
 * without one by otherwise_rad_s. After a silence the present speed is not valid for all of it. */
static double travel_by_velocity(double before_rad_s, double now_rad_s, double elapsed_s,
                                 double timeout_s, double otherwise_rad_s)
{
    double mean_rad_s = isfinite(before_rad_s) ? 0.5 * (before_rad_s + now_rad_s) : now_rad_s;
    return (isfinite(mean_rad_s) ? mean_rad_s : otherwise_rad_s) *
           (elapsed_s < timeout_s ? elapsed_s : timeout_s);
}

/* Return the travel that fits the measured velocity, among those that the counter allows, whole
 * turns apart; NaN if it is not certain: the next one must be three times as far off as the
 * velocity's error, without a silence before. */
static double travel_by_turns(const joint_odometry *joint, const joint_feedback *sample,
                              double travel_rad, double elapsed_s, double timeout_s)
{
    double mean_rad = 0.5 * (joint->velocity_rad_s + sample->velocity_rad_s) * elapsed_s;
    double change_rad = 0.5 * fabs(sample->velocity_rad_s - joint->velocity_rad_s) * elapsed_s;
    double whole_rad = joint->constant.counter_round_rad;
    double found_rad = travel_rad + rint((mean_rad - travel_rad) / whole_rad) * whole_rad;
    double sure_rad = 0.25 * whole_rad;
    bool sure = elapsed_s <= timeout_s &&
                change_rad + VELOCITY_ERROR * fabs(mean_rad) <= sure_rad &&
                fabs(found_rad - mean_rad) <= sure_rad;
    return sure ? found_rad : (double)NAN;
}

static inline void gather(joint_odometry *joint, uint32_t kind, double travel_rad)
{
    joint->pending_rad += travel_rad;
    joint->position_rad += travel_rad;
    joint->fresh |= kind;
}

/* Take the velocity of a joint without a counter: the drive's, or the set-point if nothing is
 * measured. */
static void take_velocity(joint_odometry *joint, const joint_feedback *sample,
                          double setpoint_rad_s, double elapsed_s, double timeout_s)
{
    double travel_rad =
        travel_by_velocity(NAN, sample->velocity_rad_s, elapsed_s, timeout_s, setpoint_rad_s);
    if (!(fabs(travel_rad) <= joint->constant.reach_rad_s * elapsed_s)) {
        joint->jumps++;
        travel_rad = 0.0;
    }
    joint->velocity_rad_s = measured(sample->velocity_rad_s);
    gather(joint, ESTIMATE, travel_rad);
}

static inline double travel_since(const joint_odometry *joint, const joint_feedback *sample,
                                  uint64_t before)
{
    return (double)shortest_difference(sample->count, before, joint->constant.counter_bits_unused) *
           joint->constant.counter_rad;
}

/* Whether the counter has begun at zero again: it is nearer to zero than before, so near that the
 * wheel may have turned there since, and the travel to it is more than twice what the speeds at
 * both ends explain. Without a speed at both ends that is not known. */
static inline bool restarted(const joint_odometry *joint, const joint_feedback *sample,
                             double travel_rad, double elapsed_s)
{
    double before_rad_s = joint->velocity_rad_s, now_rad_s = sample->velocity_rad_s;
    if (!isfinite(now_rad_s)) {
        now_rad_s = before_rad_s != 0.0 ? before_rad_s : (double)NAN;
    }
    double most_rad_s = larger(fabs(before_rad_s), fabs(now_rad_s));
    double explained_rad = joint->constant.counter_slack_rad + 2.0 * most_rad_s * elapsed_s +
                           WHEEL_RAD_S2 * elapsed_s * elapsed_s;
    if (!(fabs(travel_rad) > explained_rad) || joint->last != BELIEVED || isnan(before_rad_s)) {
        return false;
    }
    uint32_t unused = joint->constant.counter_bits_unused;
    double rad_per_count = fabs(joint->constant.counter_rad);
    double from_zero_rad =
               fabs((double)shortest_difference(sample->count, 0, unused)) * rad_per_count,
           before_rad = fabs((double)shortest_difference(joint->count, 0, unused)) * rad_per_count;
    return from_zero_rad < before_rad && from_zero_rad <= explained_rad;
}

static void believe(joint_odometry *joint, uint64_t count)
{
    joint->last = BELIEVED;
    joint->count = count;
    joint->since_rad = joint->credited_rad = 0.0;
}

/* Count travel from this sample on. */
static void begin(joint_odometry *joint, const joint_feedback *sample)
{
    joint->epoch = sample->epoch;
    joint->unused_rad = 0.0;
    believe(joint, sample->count);
}

/* Refuse a sample: it moves the pose by an estimate only. The next one is accepted if it agrees
 * with the last accepted one, or with the refused one. known: the sample gives a travel, though an
 * impossible one. */
static void refuse(joint_odometry *joint, const joint_feedback *sample, bool known,
                   double elapsed_s, double timeout_s)
{
    double fresh_rad = joint->constant.reach_rad_s * elapsed_s,
           before_rad_s = joint->velocity_rad_s;
    joint->velocity_rad_s = measured(sample->velocity_rad_s);
    if (known && joint->last == REFUSED) {
        double travel_rad = travel_since(joint, sample, joint->refused);
        if (fabs(travel_rad) <= fresh_rad + joint->constant.counter_slack_rad) {
            if (isnan(joint->velocity_rad_s)) {
                joint->velocity_rad_s = travel_rad / elapsed_s;
            }
            gather(joint, TRAVEL, travel_rad);
            begin(joint, sample);
            return;
        }
    }
    double estimate_rad =
        travel_by_velocity(before_rad_s, sample->velocity_rad_s, elapsed_s, timeout_s, 0.0);
    if (!(fabs(estimate_rad) <= fresh_rad)) {
        estimate_rad = 0.0;
    }
    gather(joint, ESTIMATE, estimate_rad);
    if (!known) {
        begin(joint, sample);
        return;
    }
    joint->jumps++;
    joint->last = REFUSED;
    joint->refused = sample->count;
    joint->credited_rad += estimate_rad;
}

/* Accept a travel within reach_rad, of which sure_rad is possible since the last accepted
 * sample. */
static inline void go(joint_odometry *joint, const joint_feedback *sample, double travel_rad,
                      double sure_rad, double reach_rad)
{
    const joint_constants *constant = &joint->constant;
    double distance_rad = fabs(travel_rad);
    joint->velocity_rad_s = measured(sample->velocity_rad_s);
    if (isnan(joint->velocity_rad_s)) {
        joint->velocity_rad_s =
            travel_rad * constant->reach_rad_s /
            (distance_rad <= sure_rad + constant->counter_slack_rad ? sure_rad : reach_rad);
    }
    joint->unused_rad =
        larger(0.0, smaller(reach_rad - distance_rad, constant->counter_unused_max_rad));
}

/* Take a count. A counter that is updated more slowly than it is read catches up in steps: the
 * unused reach of a sample passes to the next one, as long as feedback is valid, and up to a
 * quarter of a narrow counter. A sample beyond that is refused. */
static void take_count(joint_odometry *joint, const joint_feedback *sample, double elapsed_s,
                       double timeout_s)
{
    const joint_constants *constant = &joint->constant;
    double travel_rad = travel_since(joint, sample, joint->count);
    double sure_rad = joint->since_rad += constant->reach_rad_s * elapsed_s;
    double reach_rad = sure_rad + joint->unused_rad;
    bool again = restarted(joint, sample, travel_rad, elapsed_s);
    bool known = sample->epoch == joint->epoch && !again;
    joint->jumps += again;
    /* whether it could have gone round the counter in the other direction */
    if (known && constant->counter_round_rad - fabs(travel_rad) <= sure_rad) {
        travel_rad = travel_by_turns(joint, sample, travel_rad, elapsed_s, timeout_s);
        known = isfinite(travel_rad) && joint->last != REFUSED;
    }
    if (known && fabs(travel_rad) <= reach_rad + constant->counter_slack_rad) {
        gather(joint, TRAVEL, travel_rad - joint->credited_rad);
        go(joint, sample, travel_rad, sure_rad, reach_rad);
        believe(joint, sample->count);
    } else {
        refuse(joint, sample, known, elapsed_s, timeout_s);
    }
}

/* Take a new sample of any kind. Kept out of the loop over the joints, which it would slow down. */
__attribute__((noinline)) static void take(joint_odometry *joint, const joint_feedback *sample,
                                           double setpoint_rad_s, double timeout_s)
{
    double elapsed_s = (double)(sample->stamp_ns - joint->stamp_ns) * 1e-9;
    if (joint->last == NONE) {
        gather(joint, SEED, 0.0);
        joint->velocity_rad_s = measured(sample->velocity_rad_s);
        begin(joint, sample);
    } else if (joint->constant.counter_round_rad == 0.0) {
        take_velocity(joint, sample, setpoint_rad_s, elapsed_s, timeout_s);
    } else {
        take_count(joint, sample, elapsed_s, timeout_s);
    }
}

/* Take the common case of take_count(): after an accepted sample, one that allows only this travel,
 * within reach. Returns false for other cases. */
static inline bool take_next(joint_odometry *joint, const joint_feedback *sample)
{
    const joint_constants *constant = &joint->constant;
    if (joint->last != BELIEVED || joint->epoch != sample->epoch) {
        return false;
    }
    double sure_rad = constant->reach_rad_s * ((double)(sample->stamp_ns - joint->stamp_ns) * 1e-9);
    double reach_rad = sure_rad + joint->unused_rad;
    double travel_rad = travel_since(joint, sample, joint->count), distance_rad = fabs(travel_rad);
    if (!(distance_rad + sure_rad < constant->counter_round_rad &&
          distance_rad <= reach_rad + constant->counter_slack_rad) ||
        restarted(joint, sample, travel_rad, sure_rad / constant->reach_rad_s)) {
        return false;
    }
    gather(joint, TRAVEL, travel_rad);
    go(joint, sample, travel_rad, sure_rad, reach_rad);
    joint->count = sample->count;
    return true;
}

#endif
