/* SPDX-License-Identifier: Apache-2.0
 * arbiter.c: decides which lease is in command: the fresh one with the highest priority; among
 * equals the first. The command of a sender that is held (holds.c) counts as zero. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "fresh.h"
#include "holds.h"
#include "rt.h"

_Static_assert(sizeof(command_datagram) == COMMAND_BYTES, "docs/commands.md promises this layout");
_Static_assert(sizeof(joint_datagram) == JOINT_COMMAND_BYTES,
               "docs/commands.md promises this layout");
_Static_assert(sizeof(joint_position_datagram) == JOINT_POSITION_BYTES,
               "docs/commands.md promises this layout");
_Static_assert(offsetof(command_datagram, lateral_m_s) == COMMAND_BYTES_PLANE,
               "version 1 ends before it");
_Static_assert(offsetof(joint_datagram, velocity_rad_s) == offsetof(command_datagram, linear_m_s),
               "one head for both");

/* The request in a datagram: a twist of a base, or a command for each joint without a base. */
typedef struct {
    command_datagram twist;
    joint_command joints;
    bool possible; /* the robot can carry it out, if it is finite */
    bool clamps;   /* a position beyond its range means its end */
    uint32_t sender;
} request;

static const int64_t NS_PER_MS = 1000000;
/* commands that may come early; weight of the newest interval: 1/SMOOTH */
enum { BURST = 4, SMOOTH = 8 };
/* Least lifetime. A shorter one would lapse between two commands. */
static const int64_t LIFETIME_LEAST_NS = 20000000;
static const double OUT_OF_RANGE = 10.0; /* times the limit: beyond it, a unit is wrong or a program
                                            broken, and the speed is not scaled down */
/* How far a position may be beyond its range, for rounding: it means the end then. A degree is more
 * than its like in radians, so any farther one may have a wrong unit. */
static const double BEYOND_RAD = 0.02;

void arbiter_init(arbiter *a, const core_config *base, const base_limits *limits)
{
    memset(a, 0, sizeof *a);
    a->base = base;
    a->limits = limits;
}

void arbiter_resume(arbiter *a, int64_t resumed_ns)
{
    a->resumed_ns = resumed_ns;
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        a->report.lease[i].expires_ns = 0;
    }
}

void arbiter_arm(arbiter *a, int64_t now_ns)
{
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        holds_arm(&a->senders[i], now_ns);
        holds_show(&a->senders[i], &a->report.lease[i]);
    }
}

static bool alive(const lease_state *lease, int64_t now_ns)
{
    return lease->number != 0 && lease->sequence != 0 && now_ns < lease->expires_ns;
}

void arbiter_grant(arbiter *a, const lease_permissions *permissions)
{
    bool let_go = permissions->releases != a->permissions.releases;
    lease_state kept[LEASES_MAX] = {0};
    lease_senders senders[LEASES_MAX] = {0};
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        const lease_permission *grant = &permissions->lease[i];
        kept[i].number = grant->number;
        for (uint32_t before = 0; before < LEASES_MAX && grant->number != 0; before++) {
            if (a->report.lease[before].number == grant->number) {
                kept[i] = a->report.lease[before];
                senders[i] = a->senders[before];
            }
        }
        kept[i].priority = grant->priority;
        if (let_go) {
            holds_clear(&senders[i]);
            kept[i].barred_ns = 0;
        }
        if (grant->number != 0 && grant->barred_ns > kept[i].barred_ns) {
            holds_inherit(&senders[i], grant->barred_ns);
            kept[i].barred_ns = grant->barred_ns;
        }
        holds_show(&senders[i], &kept[i]);
    }
    a->permissions = *permissions;
    memcpy(a->report.lease, kept, sizeof kept);
    memcpy(a->senders, senders, sizeof senders);
}

/* Compare tokens, in the same time for a right token and a wrong one. */
static bool same_token(const uint8_t *one, const uint8_t *other)
{
    uint32_t differs = 0;
    for (uint32_t i = 0; i < TOKEN_BYTES; i++) {
        differs |= (uint32_t)(one[i] ^ other[i]);
    }
    return differs == 0;
}

static uint32_t find(const arbiter *a, const uint8_t *token)
{
    uint32_t found = LEASES_MAX;
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        if (a->permissions.lease[i].number != 0 &&
            same_token(token, a->permissions.lease[i].token)) {
            found = i;
        }
    }
    return found;
}

static int refuse(arbiter *a, command_refusal why)
{
    a->report.refused[why]++;
    return 1 + (int)why;
}

/* Return the lifetime of a command; 0: it is not allowed. */
static int64_t lifetime_ns(const lease_permission *grant, const command_datagram *command)
{
    int64_t requested_ns = (int64_t)command->lifetime_ms * NS_PER_MS;
    if (requested_ns == 0) {
        return grant->lifetime_ns;
    }
    return requested_ns >= LIFETIME_LEAST_NS && requested_ns <= grant->lifetime_ns ? requested_ns
                                                                                   : 0;
}

/* Whether a command's number is new. 0 never belongs to a command: in a lease it means that none
 * came. */
static bool is_new(const lease_state *lease, uint64_t sequence)
{
    return sequence != 0 && (lease->sequence == 0 || (int64_t)(sequence - lease->sequence) > 0);
}

/* Whether a command comes too often, by the generic cell rate algorithm of ITU-T I.371: as many as
 * are due, some of them early. */
static bool too_often(const lease_permission *grant, lease_state *lease, int64_t now_ns)
{
    if (grant->interval_least_ns == 0) {
        return false;
    }
    if (lease->due_ns - now_ns > BURST * grant->interval_least_ns) {
        return true;
    }
    lease->due_ns = (lease->due_ns > now_ns ? lease->due_ns : now_ns) + grant->interval_least_ns;
    return false;
}

/* Measure the time between commands. The pause after a request that has ended does not count. */
static void measure_interval(lease_state *lease, int64_t now_ns)
{
    bool lapsed = !alive(lease, now_ns), ended = lapsed && lease->wants_motion == 0;
    int64_t interval_ns = now_ns - lease->taken_ns;
    lease->lapses = lapsed && !ended ? lease->lapses + 1 : 0;
    if (ended) {
        lease->interval_ns = 0;
    } else if (lease->interval_ns > 0) {
        lease->interval_ns += (interval_ns - lease->interval_ns) / SMOOTH;
    } else if (lease->taken_ns > 0) {
        lease->interval_ns = interval_ns;
    }
    lease->taken_ns = now_ns;
}

/* Return the larger of two limits, which are numbers. fmax would have to be fetched from a new code
 * page at the first command. */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

static bool takes_position(const arbiter *a, uint32_t j)
{
    return a->base->joint[j].position.used != 0;
}

/* Whether a request wants motion. A position does, wherever the joint is. */
static bool wants_motion(const arbiter *a, const request *wanted)
{
    bool motion = wanted->twist.linear_m_s != 0.0 || wanted->twist.angular_rad_s != 0.0 ||
                  wanted->twist.lateral_m_s != 0.0;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        motion |= (wanted->joints.named >> j & 1U) &&
                  (takes_position(a, j) || wanted->joints.value_u[j] != 0.0);
    }
    return motion;
}

static bool is_finite(const request *wanted)
{
    bool finite = isfinite(wanted->twist.linear_m_s) && isfinite(wanted->twist.angular_rad_s) &&
                  isfinite(wanted->twist.lateral_m_s);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        finite &= isfinite(wanted->joints.value_u[j]) != 0;
    }
    return finite;
}

static bool position_in_range(const position_config *own, double position_rad)
{
    return position_rad >= own->position_min_rad - BEYOND_RAD &&
           position_rad <= own->position_max_rad + BEYOND_RAD;
}

static bool joints_in_range(const arbiter *a, const request *wanted)
{
    bool within = true;
    for (uint32_t j = 0; j < a->base->joint_count; j++) {
        const joint_config *joint = &a->base->joint[j];
        double value_u = wanted->joints.value_u[j];
        if (!takes_position(a, j)) {
            double most_rad_s = larger(-joint->velocity_min_rad_s, joint->velocity_max_rad_s);
            within &= fabs(value_u) <= OUT_OF_RANGE * most_rad_s;
        } else if (wanted->joints.named >> j & 1U) {
            within &= wanted->clamps || position_in_range(&joint->position, value_u);
        }
    }
    return within;
}

/* Whether a request is in range. The greater of the robot file's limit and the one in force
 * decides: so a lowered limit does not make commands invalid. */
static bool in_range(const arbiter *a, const request *wanted)
{
    const command_datagram *command = &wanted->twist;
    if (a->base == NULL) {
        return true;
    }
    if (a->base->independent) {
        return joints_in_range(a, wanted);
    }
    const base_limits *file = &a->base->limits, *now = a->limits != NULL ? a->limits : file;
    double linear_m_s = larger(file->linear.velocity_u_s, now->linear.velocity_u_s);
    double angular_rad_s = larger(file->angular.velocity_u_s, now->angular.velocity_u_s);
    double lateral_m_s = larger(file->lateral.velocity_u_s, now->lateral.velocity_u_s);
    bool sideways =
        !kinematics_strafes(a->base) || fabs(command->lateral_m_s) <= OUT_OF_RANGE * lateral_m_s;
    return fabs(command->linear_m_s) <= OUT_OF_RANGE * linear_m_s &&
           fabs(command->angular_rad_s) <= OUT_OF_RANGE * angular_rad_s && sideways;
}

static void count_impossible(arbiter *a, const command_datagram *command)
{
    if (a->base == NULL || a->base->independent) {
        return;
    }
    bool on_spot =
        command->linear_m_s == 0.0 && command->lateral_m_s == 0.0 && command->angular_rad_s != 0.0;
    a->report.sideways += command->lateral_m_s != 0.0 && !kinematics_strafes(a->base);
    a->report.on_spot += on_spot && !kinematics_spins(a->base);
}

/* Whether a command moves nothing, and takes nothing from another sender of its lease: the sender
 * is held, the other one commands. */
static bool is_idle(const lease_senders *senders, uint32_t sender, const lease_state *lease,
                    int64_t now_ns)
{
    return sender != senders->newest && holds_sender(senders, sender) && alive(lease, now_ns) &&
           lease->wants_motion != 0 && lease->held == 0;
}

static int take(arbiter *a, uint32_t place, const request *wanted, int64_t now_ns, bool may_move)
{
    const command_datagram *command = &wanted->twist;
    const lease_permission *grant = &a->permissions.lease[place];
    lease_state *lease = &a->report.lease[place];
    lease_senders *senders = &a->senders[place];
    uint32_t sender = wanted->sender;
    int64_t life_ns = lifetime_ns(grant, command);
    if (!is_new(lease, command->sequence)) {
        return refuse(a, REFUSED_SEQUENCE);
    }
    if (life_ns == 0) {
        return refuse(a, REFUSED_LIFETIME);
    }
    /* no stamp from the future either: the sender has the same clock */
    if (!fresh_stamp(now_ns, stamp_since(command->stamp_ns, a->resumed_ns), life_ns - 1)) {
        return refuse(a, REFUSED_AGE);
    }
    bool finite = is_finite(wanted);
    bool good = finite && wanted->possible && in_range(a, wanted);
    bool motion = good && wants_motion(a, wanted);
    if (motion && too_often(grant, lease, now_ns)) {
        return refuse(a, REFUSED_RATE);
    }
    if (good) { /* else what was open or held stays so: the command was not zero */
        holds_note(senders, sender, motion, now_ns, may_move);
    }
    lease->sequence = command->sequence;
    if (motion && is_idle(senders, sender, lease, now_ns)) {
        holds_show(senders, lease);
        a->report.accepted++;
        return 0;
    }
    measure_interval(lease, now_ns);
    senders->newest = sender;
    lease->since = alive(lease, now_ns) ? lease->since : ++a->comers;
    lease->stamp_ns = command->stamp_ns;
    lease->expires_ns = command->stamp_ns + life_ns;
    lease->linear_m_s = good ? command->linear_m_s : 0.0;
    lease->angular_rad_s = good ? command->angular_rad_s : 0.0;
    lease->lateral_m_s = good ? command->lateral_m_s : 0.0;
    lease->joints = good ? wanted->joints : (joint_command){0};
    lease->wants_motion = motion;
    holds_show(senders, lease);
    if (!good) {
        return refuse(a, !finite             ? REFUSED_NOT_FINITE
                         : !wanted->possible ? REFUSED_JOINTS
                                             : REFUSED_OUT_OF_RANGE);
    }
    a->report.accepted++;
    count_impossible(a, command);
    return 0;
}

/* Read the datagram as a twist, and its sender; missing fields stay zero. */
static bool read_form(const void *datagram, size_t bytes, request *wanted)
{
    command_datagram *command = &wanted->twist;
    if (bytes != COMMAND_BYTES && bytes != COMMAND_BYTES_PLANE && bytes != JOINT_COMMAND_BYTES &&
        bytes != JOINT_POSITION_BYTES) {
        return false;
    }
    memcpy(command, datagram, bytes < sizeof *command ? bytes : sizeof *command);
    wanted->sender = command->kind >> SENDER_SHIFT;
    command->kind &= (1 << SENDER_SHIFT) - 1;
    if (command->magic != COMMAND_MAGIC || wanted->sender >= SENDERS_MAX) {
        return false;
    }
    if (command->version == COMMAND_VERSION_POSITIONS) {
        return bytes == JOINT_POSITION_BYTES && command->kind == COMMAND_JOINTS;
    }
    if (command->version != COMMAND_VERSION && command->version != COMMAND_VERSION_PLANE) {
        return false;
    }
    if (bytes == JOINT_COMMAND_BYTES) {
        return command->kind == COMMAND_JOINTS;
    }
    if (bytes != (command->version == COMMAND_VERSION ? COMMAND_BYTES : COMMAND_BYTES_PLANE)) {
        return false;
    }
    return command->kind == COMMAND_TWIST || command->kind == COMMAND_RELEASE;
}

/* Read a joint command into its newest form. Older forms have a velocity for each joint: only zero
 * is possible for a joint that takes positions. */
static void read_joint_datagram(const arbiter *a, const void *datagram, size_t bytes,
                                joint_position_datagram *found)
{
    memset(found, 0, sizeof *found);
    memcpy(found, datagram, bytes);
    if (bytes == JOINT_POSITION_BYTES || a->base == NULL || found->head.joint_count > JOINTS_MAX) {
        return;
    }
    for (uint32_t j = 0; j < found->head.joint_count; j++) {
        bool counts = !takes_position(a, j) || found->head.velocity_rad_s[j] != 0.0;
        found->velocities |= (uint32_t)counts << j;
    }
}

/* Read a command of joints without a base. False: one is not a joint here, or takes the other kind
 * of set-point. */
static bool read_independent(const arbiter *a, const joint_position_datagram *from,
                             joint_command *joints)
{
    bool possible = ((from->velocities | from->positions) >> a->base->joint_count) == 0;
    for (uint32_t j = 0; j < a->base->joint_count; j++) {
        uint32_t bit = 1U << j;
        possible &= !((takes_position(a, j) ? from->velocities : from->positions) & bit);
        if ((from->velocities | from->positions) & bit) {
            joints->value_u[j] =
                takes_position(a, j) ? from->position_rad[j] : from->head.velocity_rad_s[j];
            joints->named |= bit;
        }
    }
    return possible;
}

/* Read wheel speeds. False: this base cannot drive them. */
static bool read_wheels(const arbiter *a, joint_position_datagram *from, command_datagram *command)
{
    double twist_u_s[AXES];
    bool foreign = from->positions != 0 || (from->velocities >> a->base->joint_count) != 0;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        from->head.velocity_rad_s[j] =
            from->velocities >> j & 1U ? from->head.velocity_rad_s[j] : 0.0;
    }
    if (foreign || !joints_twist(a->base, from->head.velocity_rad_s, twist_u_s)) {
        return false;
    }
    command->linear_m_s = twist_u_s[AXIS_LINEAR];
    command->angular_rad_s = twist_u_s[AXIS_ANGULAR];
    command->lateral_m_s = twist_u_s[AXIS_LATERAL];
    return true;
}

static void read_joints(const arbiter *a, const void *datagram, size_t bytes, request *wanted)
{
    joint_position_datagram from;
    read_joint_datagram(a, datagram, bytes, &from);
    wanted->clamps = (from.positions & POSITIONS_CLAMP) != 0;
    from.positions &= ~(uint32_t)POSITIONS_CLAMP;
    wanted->twist.linear_m_s = wanted->twist.angular_rad_s = wanted->twist.lateral_m_s = 0.0;
    if (a->base == NULL || from.head.joint_count != a->base->joint_count) {
        wanted->possible = false;
    } else if (a->base->independent) {
        wanted->possible = read_independent(a, &from, &wanted->joints);
    } else {
        wanted->possible = read_wheels(a, &from, &wanted->twist);
    }
}

int arbiter_submit(arbiter *a, const void *datagram, size_t bytes, int64_t now_ns, bool may_move)
{
    request wanted = {.possible = true};
    if (!read_form(datagram, bytes, &wanted)) {
        return refuse(a, REFUSED_FORM);
    }
    uint32_t place = find(a, wanted.twist.token);
    if (place == LEASES_MAX) {
        return refuse(a, REFUSED_TOKEN);
    }
    if (wanted.twist.kind == COMMAND_RELEASE) {
        a->report.lease[place].expires_ns = 0;
        a->report.lease[place].wants_motion = 0;
        holds_note(&a->senders[place], wanted.sender, false, now_ns, may_move);
        holds_show(&a->senders[place], &a->report.lease[place]);
        a->report.accepted++;
        return 0;
    }
    if (wanted.twist.kind == COMMAND_JOINTS) {
        read_joints(a, datagram, bytes, &wanted);
    } else if (a->base != NULL && a->base->independent) {
        /* without a base, only a twist of zero is possible */
        wanted.possible = !wants_motion(a, &wanted);
    }
    return take(a, place, &wanted, now_ns, may_move);
}

static const lease_state *commander(arbiter *a, int64_t now_ns, bool may_move)
{
    const lease_state *best = NULL;
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        lease_state *lease = &a->report.lease[i];
        lease->fresh = alive(lease, now_ns);
        if (!may_move && lease->open != 0) { /* also one that has lapsed: it may come late */
            holds_stop(&a->senders[i], now_ns);
            holds_show(&a->senders[i], lease);
        }
        if (lease->fresh == 0) {
            continue;
        }
        bool better = best == NULL || lease->priority > best->priority ||
                      (lease->priority == best->priority && lease->since < best->since);
        best = better ? lease : best;
    }
    return best;
}

void arbiter_command(arbiter *a, int64_t now_ns, bool may_move, twist_command *out)
{
    const lease_state *lease = commander(a, now_ns, may_move);
    a->report.may_move = may_move;
    a->report.commander = lease != NULL ? lease->number : 0;
    *out = (twist_command){.stamp_ns = a->last_stamp_ns}; /* no command: it has ended */
    if (lease == NULL) {
        return;
    }
    a->last_stamp_ns = lease->stamp_ns;
    out->stamp_ns = lease->stamp_ns;
    out->expires_ns = lease->expires_ns;
    out->sequence = lease->sequence;
    if (lease->held == 0) {
        out->linear_m_s = lease->linear_m_s;
        out->angular_rad_s = lease->angular_rad_s;
        out->lateral_m_s = lease->lateral_m_s;
    }
}

void arbiter_joints(const arbiter *a, joint_command *out)
{
    *out = (joint_command){0};
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        const lease_state *lease = &a->report.lease[i];
        if (a->report.commander != 0 && lease->number == a->report.commander && lease->held == 0) {
            *out = lease->joints;
        }
    }
}
