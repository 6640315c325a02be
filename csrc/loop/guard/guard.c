/* SPDX-License-Identifier: Apache-2.0
 * guard.c: decides when the emergency stop's contact stops the robot, and whether all threads work,
 * so that the watchdog's pin may change. Pure: time is an argument. */
#include "guard.h"

#include <errno.h>

#include "fresh.h"

int guard_config_check(const guard_config *config)
{
    bool good = config->watchdog == 0 ||
                (config->watchdog_every_ticks > 0 && config->heartbeat_timeout_ns > 0);
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        good = good && config->line_timeout_ns[line] >= 0;
    }
    return good ? 0 : -EINVAL;
}

/* Return ESTOP_*. A contact that opens for less than a tick counts as open. */
uint32_t estop_judge(const guard_config *config, const estop_reading *reading)
{
    if (!reading->known) {
        return ESTOP_LOST;
    }
    return reading->opened || reading->high == (config->estop_high != 0) ? ESTOP_ACTIVE
                                                                         : ESTOP_CLEAR;
}

/* Whether a line works. One with enabled drives has to. A line that hangs counts as hanging until
 * it works again, even if the core has disabled it since: the state of its drives is unknown. */
static bool line_lives(watchdog_state *state, const guard_config *config,
                       const watchdog_input *input, uint32_t line)
{
    int64_t timeout_ns = config->line_timeout_ns[line];
    if (timeout_ns == 0) {
        return true;
    }
    bool armed_now = input->enabled && !state->was_enabled;
    if (input->takes[line] != state->takes[line] || (armed_now && !state->watched[line])) {
        state->takes[line] = input->takes[line];
        state->taken_ns[line] = input->now_ns;
    }
    bool lives = fresh_stamp(input->now_ns, state->taken_ns[line], timeout_ns);
    state->watched[line] = input->enabled || (state->watched[line] && !lives);
    return lives || !state->watched[line];
}

bool watchdog_step(watchdog_state *state, const guard_config *config, const watchdog_input *input)
{
    bool well = fresh_stamp(input->now_ns, input->heartbeat_ns, config->heartbeat_timeout_ns);
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        bool lives = line_lives(state, config, input, line);
        well = well && lives;
    }
    state->was_enabled = input->enabled;
    state->ticks++;
    if (!well) {
        state->high = false;
        state->ticks = 0;
    } else if (state->ticks >= config->watchdog_every_ticks) {
        state->high = !state->high;
        state->ticks = 0;
    }
    return well;
}
