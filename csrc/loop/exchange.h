/* SPDX-License-Identifier: Apache-2.0
 * exchange.h: the inside of api.h's exchange, for loop.c, which holds one in static storage. */
#ifndef MOTORD_EXCHANGE_H
#define MOTORD_EXCHANGE_H

#include "mailbox.h"
#include "rt.h"

typedef struct {
    mailbox box;
    lease_permissions slot[MAILBOX_SLOTS];
} permissions_box;

typedef struct {
    mailbox box;
    command_report slot[MAILBOX_SLOTS];
} commands_box;

typedef struct {
    mailbox box;
    core_control slot[MAILBOX_SLOTS];
} control_box;

typedef struct {
    mailbox box;
    joint_feedback slot[MAILBOX_SLOTS];
} feedback_box;

typedef struct {
    mailbox box;
    imu_sample slot[MAILBOX_SLOTS];
} imu_box;

typedef struct {
    mailbox box;
    setpoints slot[MAILBOX_SLOTS];
} setpoints_box;

struct exchange {
    permissions_box permissions;
    commands_box commands;
    control_box control;
    feedback_box feedback[JOINTS_MAX];
    imu_box imu;
    setpoints_box setpoints[LINES_MAX];
    _Atomic int line_wake_fd[LINES_MAX];
    _Atomic uint64_t takes[LINES_MAX];
    _Atomic uint64_t enabled_count[LINES_MAX];
    bool enabled_before[LINES_MAX]; /* the writer's */
};

/* How often a line has taken its set-points: it lives while this grows. */
uint64_t exchange_line_takes(const exchange *x, uint32_t line);

#endif
