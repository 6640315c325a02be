/* SPDX-License-Identifier: Apache-2.0
 * test_position_place: which target is sent to a joint that takes positions, in the numbers of its
 * drive. */
#include "check.h"
#include "position_place.h"

static const int64_t NOW_NS = 5000000000, MS_NS = 1000000;
static const position_range RANGE = {
    .least = -100.0, .most = 200.0, .per_s = 50.0, .window_ns = 400000000};

/* A position that was measured 10 ms ago; no target has been sent. */
static position_place measured_at(double place)
{
    return (position_place){.measured = place, .sent = NAN, .measured_ns = NOW_NS - 10 * MS_NS};
}

static void a_window_is_the_time_out_or_three_slow_cycles(void)
{
    CHECK(place_window_ns(100, 10) == 100 && place_window_ns(10, 100) == 300);
    CHECK(place_window_ns(300, 100) == 300 && place_window_ns(301, 100) == 301 &&
          place_window_ns(299, 100) == 300);
}

static void a_position_is_valid_when_known_fresh_and_within_its_range(void)
{
    static const struct {
        double measured;
        int64_t age_ms;
        bool known;
    } CASES[] = {{0.0, 10, true},    {-100.0, 10, true}, {200.0, 10, true}, {-100.1, 10, false},
                 {200.1, 10, false}, {NAN, 10, false},   {0.0, 399, true},  {0.0, 401, false}};
    for (int i = 0; i < 8; i++) {
        position_place place = {.measured = CASES[i].measured,
                                .sent = NAN,
                                .measured_ns = NOW_NS - CASES[i].age_ms * MS_NS};
        CHECK(place_is_known(&place, &RANGE, NOW_NS) == CASES[i].known);
        CHECK(place_is_missing(&place, &RANGE, NAN, NOW_NS) == !CASES[i].known);
    }
    position_place never = {.measured = 0.0, .sent = NAN};
    CHECK(!place_is_known(&never, &RANGE, NOW_NS) && place_is_missing(&never, &RANGE, NAN, NOW_NS));
}

static void a_step_is_the_speed_for_the_time_but_no_longer_than_the_window(void)
{
    CHECK(fabs(place_step(&RANGE, 100 * MS_NS) - 5.0) < 1e-9 &&
          fabs(place_step(&RANGE, 400 * MS_NS) - 20.0) < 1e-9);
    CHECK(fabs(place_step(&RANGE, 9000 * MS_NS) - 20.0) < 1e-9 &&
          fabs(place_step(&RANGE, INT64_MAX) - 20.0) < 1e-9);
    CHECK(place_step(&RANGE, 0) == 0.0 && place_step(&RANGE, -5 * MS_NS) == 0.0);
    CHECK(fabs(place_step(&RANGE, 1) - 50e-9) < 1e-15);
}

/* The first target is the measured position, and only if the wanted target is near. */
static void the_first_target_of_a_drive_is_its_measured_position(void)
{
    static const struct {
        double measured, wanted;
        bool begins;
    } CASES[] = {{10.0, 15.0, true},    {10.0, 29.9, true},    {10.0, 30.1, false},
                 {10.0, -9.9, true},    {10.0, -10.1, false},  {190.0, 900.0, true},
                 {-90.0, -900.0, true}, {250.0, 200.0, false}, {10.0, 900.0, false},
                 {NAN, 10.0, false}};
    for (int i = 0; i < 10; i++) {
        position_place place = measured_at(CASES[i].measured);
        double next = place_next(&place, &RANGE, CASES[i].wanted, NOW_NS);
        CHECK(CASES[i].begins ? next == CASES[i].measured : isnan(next));
        CHECK(place_is_missing(&place, &RANGE, CASES[i].wanted, NOW_NS) == !CASES[i].begins);
        CHECK(isnan(place_next(&place, &RANGE, NAN, NOW_NS)));
    }
}

static void later_targets_move_at_the_speed_of_the_joint_and_within_its_range(void)
{
    static const struct {
        double wanted, next;
    } CASES[] = {{12.0, 12.0}, {90.0, 15.0}, {-90.0, 5.0}, {15.0, 15.0}};
    for (int i = 0; i < 4; i++) {
        position_place place = {.measured = NAN, .sent = 10.0, .sent_ns = NOW_NS - 100 * MS_NS};
        CHECK(fabs(place_next(&place, &RANGE, CASES[i].wanted, NOW_NS) - CASES[i].next) < 1e-9);
        CHECK(!place_is_missing(&place, &RANGE, CASES[i].wanted, NOW_NS) &&
              !place_is_missing(&place, &RANGE, NAN, NOW_NS));
        CHECK(isnan(place_next(&place, &RANGE, NAN, NOW_NS)));
        place.sent = 199.0;
        CHECK(place_next(&place, &RANGE, 900.0, NOW_NS) == 200.0);
        place.sent = -99.0;
        CHECK(place_next(&place, &RANGE, -900.0, NOW_NS) == -100.0);
    }
}

int main(void)
{
    a_window_is_the_time_out_or_three_slow_cycles();
    a_position_is_valid_when_known_fresh_and_within_its_range();
    a_step_is_the_speed_for_the_time_but_no_longer_than_the_window();
    the_first_target_of_a_drive_is_its_measured_position();
    later_targets_move_at_the_speed_of_the_joint_and_within_its_range();
    return checks_report("test_position_place");
}
