/* SPDX-License-Identifier: Apache-2.0
 * board_clock.c: stamps of feedback, whose time in a buffer counts as age. The least difference
 * between both clocks is the offset: Cristian, Probabilistic Clock Synchronization, Distributed
 * Computing 3, 1989. */
#include "board_machine.h"

/* Limit for catching up. When the least delay falls, stamps step back. The core would refuse, as a
 * jump, counts of a longer distance than the time since the previous stamp allows (odometry.c: 1.5
 * times the highest speed), and the distance would be lost. So a frame adds nothing, for at most
 * this long, until its stamp has advanced by three quarters of the board's own time. */
static const int64_t CATCH_UP_NS = 240 * 1000000;
static const int64_t NS_PER_US = 1000;

static int64_t least_offset_ns(const board_clock *clock)
{
    int64_t least_ns = clock->offset_ns[0];
    for (uint32_t i = 1; i < clock->samples; i++) {
        least_ns = clock->offset_ns[i] < least_ns ? clock->offset_ns[i] : least_ns;
    }
    return least_ns;
}

int64_t board_clock_stamp(board_clock *clock, uint32_t time_us, int64_t came_ns)
{
    if (clock->samples > 0) {
        clock->board_ns += (int64_t)(uint32_t)(time_us - clock->last_us) * NS_PER_US;
    }
    clock->last_us = time_us;
    clock->offset_ns[clock->next] = came_ns - clock->board_ns;
    clock->next = (clock->next + 1) % BOARD_CLOCK_SAMPLES;
    clock->samples += clock->samples < BOARD_CLOCK_SAMPLES;
    int64_t stamp_ns = clock->board_ns + least_offset_ns(clock);
    int64_t passed_ns = clock->board_ns - clock->given_board_ns;
    if (stamp_ns - clock->given_ns < 3 * passed_ns / 4 && passed_ns < CATCH_UP_NS) {
        return clock->given_ns < came_ns ? clock->given_ns : came_ns;
    }
    clock->given_ns = stamp_ns;
    clock->given_board_ns = clock->board_ns;
    return stamp_ns;
}
