/* SPDX-License-Identifier: Apache-2.0 */
#include "exchange.h"

#include <errno.h>
#include <string.h>

size_t exchange_bytes(void)
{
    return sizeof(exchange);
}

void exchange_init(exchange *x)
{
    memset(x, 0, sizeof *x);
    mailbox_init(&x->permissions.mailbox);
    mailbox_init(&x->commands.mailbox);
    mailbox_init(&x->control.mailbox);
    mailbox_init(&x->imu.mailbox);
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        mailbox_init(&x->feedback[joint].mailbox);
    }
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        mailbox_init(&x->setpoints[line].mailbox);
        atomic_store(&x->line_wake_fd[line], -1);
    }
}

void exchange_put_permissions(exchange *x, const lease_permissions *permissions)
{
    mailbox_put(&x->permissions.mailbox, x->permissions.slot, permissions, sizeof *permissions);
}

int exchange_take_permissions(exchange *x, lease_permissions *out)
{
    return mailbox_take(&x->permissions.mailbox, x->permissions.slot, out, sizeof *out);
}

void exchange_put_commands(exchange *x, const command_report *report)
{
    mailbox_put(&x->commands.mailbox, x->commands.slot, report, sizeof *report);
}

int exchange_take_commands(exchange *x, command_report *out)
{
    return mailbox_take(&x->commands.mailbox, x->commands.slot, out, sizeof *out);
}

void exchange_put_control(exchange *x, const core_control *control)
{
    mailbox_put(&x->control.mailbox, x->control.slot, control, sizeof *control);
}

int exchange_take_control(exchange *x, core_control *out)
{
    return mailbox_take(&x->control.mailbox, x->control.slot, out, sizeof *out);
}

int exchange_put_feedback(exchange *x, uint32_t joint, const joint_feedback *feedback)
{
    if (joint >= JOINTS_MAX) {
        return -EINVAL;
    }
    feedback_mailbox *to = &x->feedback[joint];
    mailbox_put(&to->mailbox, to->slot, feedback, sizeof *feedback);
    return 0;
}

int exchange_take_feedback(exchange *x, uint32_t joint, joint_feedback *out)
{
    if (joint >= JOINTS_MAX) {
        return -EINVAL;
    }
    feedback_mailbox *from = &x->feedback[joint];
    return mailbox_take(&from->mailbox, from->slot, out, sizeof *out);
}

void exchange_put_imu(exchange *x, const imu_sample *sample)
{
    mailbox_put(&x->imu.mailbox, x->imu.slot, sample, sizeof *sample);
}

int exchange_take_imu(exchange *x, imu_sample *out)
{
    return mailbox_take(&x->imu.mailbox, x->imu.slot, out, sizeof *out);
}

int exchange_put_setpoints(exchange *x, uint32_t line, const setpoints *value)
{
    if (line >= LINES_MAX) {
        return -EINVAL;
    }
    setpoints_mailbox *to = &x->setpoints[line];
    bool enabled = value->enabled != 0;
    mailbox_put(&to->mailbox, to->slot, value, sizeof *value);
    /* after the set-points, so that no line has the count without them; in every tick, so that the
     * first time touches no new memory */
    (void)atomic_fetch_add_explicit(&x->enabled_count[line], enabled && !x->enabled_before[line],
                                    memory_order_release);
    x->enabled_before[line] = enabled;
    return 0;
}

int exchange_take_setpoints(exchange *x, uint32_t line, setpoints *out)
{
    if (line >= LINES_MAX) {
        return -EINVAL;
    }
    setpoints_mailbox *from = &x->setpoints[line];
    (void)atomic_fetch_add_explicit(&x->takes[line], 1, memory_order_relaxed);
    return mailbox_take(&from->mailbox, from->slot, out, sizeof *out);
}

uint64_t exchange_enabled_count(const exchange *x, uint32_t line)
{
    return line < LINES_MAX ? atomic_load_explicit(&x->enabled_count[line], memory_order_acquire)
                            : 0;
}

uint64_t exchange_line_takes(const exchange *x, uint32_t line)
{
    return atomic_load_explicit(&x->takes[line], memory_order_relaxed);
}

int exchange_set_line_wake(exchange *x, uint32_t line, int fd)
{
    if (line >= LINES_MAX) {
        return -EINVAL;
    }
    atomic_store(&x->line_wake_fd[line], fd);
    return 0;
}

int exchange_line_wake(const exchange *x, uint32_t line)
{
    return line < LINES_MAX ? atomic_load(&x->line_wake_fd[line]) : -1;
}
