/* SPDX-License-Identifier: Apache-2.0
 * exchange.h: the inside of api_loop.h's exchange, for loop.c, which holds one in static
 * storage. */
#ifndef MOTORD_EXCHANGE_H
#define MOTORD_EXCHANGE_H

#include "mailbox.h"
#include "rt.h"

typedef struct {
    mailbox mailbox;
    lease_permissions slot[MAILBOX_SLOTS];
} permissions_mailbox;

typedef struct {
    mailbox mailbox;
    command_report slot[MAILBOX_SLOTS];
} commands_mailbox;

typedef struct {
    mailbox mailbox;
    core_control slot[MAILBOX_SLOTS];
} control_mailbox;

typedef struct {
    mailbox mailbox;
    joint_feedback slot[MAILBOX_SLOTS];
} feedback_mailbox;

typedef struct {
    mailbox mailbox;
    imu_sample slot[MAILBOX_SLOTS];
} imu_mailbox;

typedef struct {
    mailbox mailbox;
    setpoints slot[MAILBOX_SLOTS];
} setpoints_mailbox;

struct exchange {
    permissions_mailbox permissions;
    commands_mailbox commands;
    control_mailbox control;
    feedback_mailbox feedback[JOINTS_MAX];
    imu_mailbox imu;
    setpoints_mailbox setpoints[LINES_MAX];
    _Atomic int line_wake_fd[LINES_MAX];
    _Atomic uint64_t takes[LINES_MAX];
    _Atomic uint64_t enabled_count[LINES_MAX];
    bool enabled_before[LINES_MAX]; /* used by the writer only */
};

/* Return the number of times that a line has taken its set-points. The line works while it
 * grows. */
uint64_t exchange_line_takes(const exchange *x, uint32_t line);

#endif
