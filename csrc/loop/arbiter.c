/* SPDX-License-Identifier: Apache-2.0
 * arbiter.c: which lease is in command. The fresh one with the highest priority; among equals the first. A lease that
 * requests motion while nothing may move is held: its command counts as zero until it has sent zero itself or has let
 * it lapse. So a source that goes on sending through a stop, or before arming, moves nothing. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "fresh.h"
#include "rt.h"

_Static_assert(sizeof(command_datagram) == COMMAND_BYTES, "docs/commands.md promises this layout");
_Static_assert(sizeof(joint_datagram) == JOINT_COMMAND_BYTES, "docs/commands.md promises this layout");
_Static_assert(offsetof(command_datagram, lateral_m_s) == COMMAND_BYTES_PLANE, "version 1 ends before it");
_Static_assert(offsetof(joint_datagram, velocity_rad_s) == offsetof(command_datagram, linear_m_s), "one head for both");

static const int64_t NS_PER_MS = 1000000;
enum { BURST = 4, SMOOTH = 8 }; /* commands that may come early; of the interval between them the newest counts 1/SMOOTH */
/* What is shorter would lapse between two commands, and the hold of a held lease with it. */
static const int64_t LIFETIME_LEAST_NS = 20000000;
static const double OUT_OF_RANGE = 10.0; /* times the limit: a wrong unit or a broken program, nothing to be scaled down */

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

static bool alive(const lease_state *lease, int64_t now_ns)
{
    return lease->number != 0 && lease->sequence != 0 && now_ns < lease->expires_ns;
}

static bool wants_motion(const lease_state *lease)
{
    return lease->linear_m_s != 0.0 || lease->angular_rad_s != 0.0 || lease->lateral_m_s != 0.0;
}

void arbiter_grant(arbiter *a, const lease_permissions *permissions)
{
    lease_state kept[LEASES_MAX];
    memset(kept, 0, sizeof kept);
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        kept[i].number = permissions->lease[i].number;
        kept[i].priority = permissions->lease[i].priority;
        for (uint32_t before = 0; before < LEASES_MAX && kept[i].number != 0; before++) {
            if (a->report.lease[before].number == kept[i].number) {
                kept[i] = a->report.lease[before];
                kept[i].priority = permissions->lease[i].priority;
            }
        }
    }
    a->permissions = *permissions;
    memcpy(a->report.lease, kept, sizeof kept);
}

/* The same time for a right token and a wrong one. */
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
        if (a->permissions.lease[i].number != 0 && same_token(token, a->permissions.lease[i].token)) {
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

/* How long it lives, 0: it cannot. */
static int64_t lifetime_ns(const lease_permission *grant, const command_datagram *command)
{
    int64_t requested_ns = (int64_t)command->lifetime_ms * NS_PER_MS;
    if (requested_ns == 0) {
        return grant->lifetime_ns;
    }
    return requested_ns >= LIFETIME_LEAST_NS && requested_ns <= grant->lifetime_ns ? requested_ns : 0;
}

/* 0 is never a command's: in a lease it means that none came. */
static bool is_new(const lease_state *lease, uint64_t sequence)
{
    return sequence != 0 && (lease->sequence == 0 || (int64_t)(sequence - lease->sequence) > 0);
}

/* The generic cell rate algorithm, ITU-T I.371: as many as are due, and some of them early. */
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

static void measure_interval(lease_state *lease, int64_t now_ns)
{
    int64_t interval_ns = now_ns - lease->taken_ns;
    if (lease->interval_ns > 0) {
        lease->interval_ns += (interval_ns - lease->interval_ns) / SMOOTH;
    } else if (lease->taken_ns > 0) {
        lease->interval_ns = interval_ns;
    }
    lease->taken_ns = now_ns;
}

/* Of two limits, which are numbers. Not fmax: its code is a page that the loop's first command would have to fetch. */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

/* Of the robot file's limit and the one in force the greater counts: a source that slows the robot down by a limit stops none. */
static bool in_range(const arbiter *a, const command_datagram *command)
{
    if (a->base == NULL) {
        return true;
    }
    const base_limits *file = &a->base->limits, *now = a->limits != NULL ? a->limits : file;
    double linear_m_s = larger(file->linear.velocity_u_s, now->linear.velocity_u_s);
    double angular_rad_s = larger(file->angular.velocity_u_s, now->angular.velocity_u_s);
    double lateral_m_s = larger(file->lateral.velocity_u_s, now->lateral.velocity_u_s);
    bool sideways = !kinematics_strafes(a->base) || fabs(command->lateral_m_s) <= OUT_OF_RANGE * lateral_m_s;
    return fabs(command->linear_m_s) <= OUT_OF_RANGE * linear_m_s &&
           fabs(command->angular_rad_s) <= OUT_OF_RANGE * angular_rad_s && sideways;
}

/* `possible`: the base can do it, if it is finite. */
static int take(arbiter *a, uint32_t place, const command_datagram *command, bool possible, int64_t now_ns, bool may_move)
{
    const lease_permission *grant = &a->permissions.lease[place];
    lease_state *lease = &a->report.lease[place];
    int64_t life_ns = lifetime_ns(grant, command);
    if (!is_new(lease, command->sequence)) {
        return refuse(a, REFUSED_SEQUENCE);
    }
    if (life_ns == 0) {
        return refuse(a, REFUSED_LIFETIME);
    }
    /* of the future, too: the sender's clock is this machine's */
    if (!fresh_stamp(now_ns, stamp_since(command->stamp_ns, a->resumed_ns), life_ns - 1)) {
        return refuse(a, REFUSED_AGE);
    }
    bool finite = isfinite(command->linear_m_s) && isfinite(command->angular_rad_s) && isfinite(command->lateral_m_s);
    bool good = finite && possible && in_range(a, command);
    bool motion = good && (command->linear_m_s != 0.0 || command->angular_rad_s != 0.0 || command->lateral_m_s != 0.0);
    if (motion && too_often(grant, lease, now_ns)) {
        return refuse(a, REFUSED_RATE);
    }
    measure_interval(lease, now_ns);
    lease->since = alive(lease, now_ns) ? lease->since : ++a->comers;
    bool left_held = grant->barred_until_ns > lease->lifted_ns && now_ns < grant->barred_until_ns;
    bool barred = alive(lease, now_ns) ? lease->held != 0 : left_held;
    lease->lifted_ns = grant->barred_until_ns; /* from here on it is in lease->held */
    lease->sequence = command->sequence;
    lease->stamp_ns = command->stamp_ns;
    lease->expires_ns = command->stamp_ns + life_ns;
    lease->linear_m_s = good ? command->linear_m_s : 0.0;
    lease->angular_rad_s = good ? command->angular_rad_s : 0.0;
    lease->lateral_m_s = good ? command->lateral_m_s : 0.0;
    lease->held = wants_motion(lease) && (!may_move || barred);
    if (!good) {
        lease->held = barred; /* that was no zero */
        return refuse(a, !finite ? REFUSED_NOT_FINITE : !possible ? REFUSED_JOINTS : REFUSED_OUT_OF_RANGE);
    }
    a->report.accepted++;
    if (a->base != NULL) {
        bool on_spot = command->linear_m_s == 0.0 && command->lateral_m_s == 0.0 && command->angular_rad_s != 0.0;
        a->report.sideways += command->lateral_m_s != 0.0 && !kinematics_strafes(a->base);
        a->report.on_spot += on_spot && !kinematics_spins(a->base);
    }
    return 0;
}

/* The datagram in the form of a twist. */
static bool read_form(const void *datagram, size_t bytes, command_datagram *command)
{
    if (bytes != COMMAND_BYTES && bytes != COMMAND_BYTES_PLANE && bytes != JOINT_COMMAND_BYTES) {
        return false;
    }
    *command = (command_datagram){0};
    memcpy(command, datagram, bytes < sizeof *command ? bytes : sizeof *command);
    if (command->magic != COMMAND_MAGIC || (command->version != COMMAND_VERSION && command->version != COMMAND_VERSION_PLANE)) {
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

/* False: nothing that this base can do. */
static bool read_joints(const arbiter *a, const void *datagram, command_datagram *command)
{
    joint_datagram joints;
    memcpy(&joints, datagram, sizeof joints);
    double twist_u_s[AXES] = {0.0};
    bool possible =
        a->base != NULL && joints.joint_count == a->base->joint_count && joints_twist(a->base, joints.velocity_rad_s, twist_u_s);
    command->linear_m_s = twist_u_s[AXIS_LINEAR];
    command->angular_rad_s = twist_u_s[AXIS_ANGULAR];
    command->lateral_m_s = twist_u_s[AXIS_LATERAL];
    return possible;
}

int arbiter_submit(arbiter *a, const void *datagram, size_t bytes, int64_t now_ns, bool may_move)
{
    command_datagram command;
    if (!read_form(datagram, bytes, &command)) {
        return refuse(a, REFUSED_FORM);
    }
    uint32_t place = find(a, command.token);
    if (place == LEASES_MAX) {
        return refuse(a, REFUSED_TOKEN);
    }
    if (command.kind == COMMAND_RELEASE) {
        a->report.lease[place].expires_ns = 0;
        a->report.accepted++;
        return 0;
    }
    bool possible = command.kind != COMMAND_JOINTS || read_joints(a, datagram, &command);
    return take(a, place, &command, possible, now_ns, may_move);
}

static const lease_state *commander(arbiter *a, int64_t now_ns, bool may_move)
{
    const lease_state *best = NULL;
    for (uint32_t i = 0; i < LEASES_MAX; i++) {
        lease_state *lease = &a->report.lease[i];
        lease->fresh = alive(lease, now_ns);
        if (lease->fresh == 0) {
            continue;
        }
        lease->held |= !may_move && wants_motion(lease);
        bool better =
            best == NULL || lease->priority > best->priority || (lease->priority == best->priority && lease->since < best->since);
        best = better ? lease : best;
    }
    return best;
}

void arbiter_command(arbiter *a, int64_t now_ns, bool may_move, twist_command *out)
{
    const lease_state *lease = commander(a, now_ns, may_move);
    a->report.may_move = may_move;
    a->report.commander = lease != NULL ? lease->number : 0;
    *out = (twist_command){.stamp_ns = a->last_stamp_ns}; /* none: its end lies behind us */
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
