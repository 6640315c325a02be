/* SPDX-License-Identifier: Apache-2.0
 * test_board_clock: the time of feedback, computed from the board's own clock. */
#include <string.h>

#include "board_machine.h"
#include "check.h"

enum { MS = 1000000, US = 1000, PERIOD_US = 10000 };
static const int64_t BEGIN_NS = 5000 * (int64_t)MS;

/* A board whose clock began at `began_us`. It reports every PERIOD_US. */
typedef struct {
    board_clock clock;
    uint32_t time_us;
    int64_t true_ns;
} board;

static board board_at(uint32_t began_us)
{
    return (board){.time_us = began_us - PERIOD_US, .true_ns = BEGIN_NS - PERIOD_US * (int64_t)US};
}

/* The board's next feedback arrives `delay_ns` late. Returns by how much its stamp is later than
 * the true time. */
static int64_t stamped_late_ns(board *b, int64_t delay_ns)
{
    b->time_us += PERIOD_US;
    b->true_ns += PERIOD_US * (int64_t)US;
    return board_clock_stamp(&b->clock, b->time_us, b->true_ns + delay_ns) - b->true_ns;
}

static void the_first_feedback_has_its_time_of_arrival(void)
{
    board b = board_at(12345);
    CHECK(stamped_late_ns(&b, 7 * MS) == 7 * MS);
}

static void feedback_that_was_delayed_longer_is_stamped_older(void)
{
    board b = board_at(0);
    CHECK(stamped_late_ns(&b, 2 * MS) == 2 * MS);
    CHECK(stamped_late_ns(&b, 9 * MS) == 2 * MS);
    CHECK(stamped_late_ns(&b, 3 * MS) == 2 * MS);
    /* a frame with a shorter delay shows that all stamps were too late */
    CHECK(stamped_late_ns(&b, 1 * MS) == 1 * MS);
    CHECK(stamped_late_ns(&b, 9 * MS) == 1 * MS);
}

/* The smallest of the remembered delays counts, wherever it is in the list, until it is dropped. */
static void the_least_of_the_delays_counts_until_it_is_forgotten(void)
{
    for (uint32_t begin = 0; begin < BOARD_CLOCK_SAMPLES; begin++) {
        board b = board_at(0);
        for (uint32_t i = 0; i < BOARD_CLOCK_SAMPLES + begin; i++) {
            (void)stamped_late_ns(&b, 2 * MS);
        }
        CHECK(stamped_late_ns(&b, 1 * MS) == 1 * MS);
        for (uint32_t i = 1; i < BOARD_CLOCK_SAMPLES; i++) {
            CHECK(stamped_late_ns(&b, 2 * MS) == 1 * MS);
        }
        CHECK(stamped_late_ns(&b, 2 * MS) == 2 * MS);
    }
}

static void a_board_s_time_passes_the_end_of_its_32_bits(void)
{
    board b = board_at(UINT32_MAX - 2 * PERIOD_US);
    for (int i = 0; i < 8; i++) {
        CHECK(stamped_late_ns(&b, 2 * MS) == 2 * MS);
    }
}

/* The stamp of the second of two frames of feedback, whose delay is `quicker_ns` less. A stamp that
 * would step back keeps its value until newer ones exceed it. */
static int64_t second_ns(int64_t passed_ns, int64_t quicker_ns, int64_t *first_ns, int64_t *true_ns)
{
    board_clock clock = {0};
    *first_ns = board_clock_stamp(&clock, 0, BEGIN_NS + 400 * MS);
    *true_ns = BEGIN_NS + passed_ns;
    return board_clock_stamp(&clock, (uint32_t)(passed_ns / US), *true_ns + 400 * MS - quicker_ns);
}

static void a_stamp_that_steps_back_is_held_until_three_quarters_have_passed(void)
{
    int64_t first_ns, true_ns;
    CHECK(second_ns(40 * MS, 10 * MS, &first_ns, &true_ns) == first_ns + 30 * MS);
    CHECK(second_ns(40 * MS, 10 * MS + 1, &first_ns, &true_ns) == first_ns);
    CHECK(second_ns(40 * MS, 10 * MS - 1, &first_ns, &true_ns) == first_ns + 30 * MS + 1);
    CHECK(second_ns(40 * MS, 39 * MS, &first_ns, &true_ns) == first_ns);
}

static void a_stamp_is_held_for_a_bounded_time(void)
{
    int64_t first_ns, true_ns;
    CHECK(second_ns(240 * MS - US, 100 * MS, &first_ns, &true_ns) == first_ns);
    CHECK(second_ns(240 * MS, 100 * MS, &first_ns, &true_ns) == first_ns + 140 * MS);
    CHECK(second_ns(241 * MS, 100 * MS, &first_ns, &true_ns) == first_ns + 141 * MS);
}

static void a_stamp_that_is_held_is_never_from_the_future(void)
{
    int64_t first_ns, true_ns;
    /* the time of its arrival */
    CHECK(second_ns(40 * MS, 100 * MS, &first_ns, &true_ns) == true_ns + 300 * MS);
    CHECK(second_ns(40 * MS, 40 * MS, &first_ns, &true_ns) == first_ns);
    CHECK(second_ns(40 * MS, 40 * MS + 1, &first_ns, &true_ns) == first_ns - 1);
}

/* A stamp that is held does not count: three quarters of the time since the last one that was given
 * have to pass. */
static void the_time_since_the_last_stamp_that_was_given_counts(void)
{
    board_clock clock = {0};
    int64_t first_ns = board_clock_stamp(&clock, 0, BEGIN_NS + 100 * MS);
    CHECK(board_clock_stamp(&clock, 10000, BEGIN_NS + 10 * MS + 80 * MS) == BEGIN_NS + 90 * MS);
    CHECK(board_clock_stamp(&clock, 40000, BEGIN_NS + 40 * MS + 90 * MS) == first_ns);
    CHECK(board_clock_stamp(&clock, 79996, BEGIN_NS + 79996 * (int64_t)US + 90 * MS) == first_ns);
    CHECK(board_clock_stamp(&clock, 80000, BEGIN_NS + 80 * MS + 90 * MS) ==
          BEGIN_NS + 80 * MS + 80 * MS);
    CHECK(board_clock_stamp(&clock, 90000, BEGIN_NS + 90 * MS + 90 * MS) ==
          BEGIN_NS + 90 * MS + 80 * MS);
}

int main(void)
{
    the_first_feedback_has_its_time_of_arrival();
    feedback_that_was_delayed_longer_is_stamped_older();
    the_least_of_the_delays_counts_until_it_is_forgotten();
    a_board_s_time_passes_the_end_of_its_32_bits();
    a_stamp_that_steps_back_is_held_until_three_quarters_have_passed();
    a_stamp_is_held_for_a_bounded_time();
    a_stamp_that_is_held_is_never_from_the_future();
    the_time_since_the_last_stamp_that_was_given_counts();
    return checks_report("test_board_clock");
}
