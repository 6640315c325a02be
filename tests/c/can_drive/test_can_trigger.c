/* SPDX-License-Identifier: Apache-2.0
 * Drives that take a target when a bit triggers them, and acknowledge it. */
#include "can_position_rig.h"

/* The trigger is a bit of the last byte. The drive sets bit 4 of its state when it has taken the
 * target. */
static void begin_with_trigger(void)
{
    begin();
    can_output *output = &table_of(0)->output[0];
    output->packet.bytes = 8;
    output->setpoint[0].trigger = (can_place){.start_bit = 60, .length = 1};
    table_of(0)->input[0].field_count = 2;
    table_of(0)->input[0].field[0].meaning.equals_mask = 15;
    table_of(0)->input[0].field[1] = (can_field){
        .place = {.length = 8},
        .meaning = {.kind = FIELD_TAKEN, .equals_mask = 16, .equals = 16, .si_per_raw = 1.0}};
    restart();
}

static uint8_t trigger_sent(void)
{
    return newest_of(0)->data[7];
}

static void take_target(bool taken)
{
    report_state(0, taken ? 8 | 16 : 8);
    put();
    forget_sent();
    for (uint32_t i = 0; i < 20 && count_sent(SPEED) == 0; i++) {
        w.now_ns += 2 * MS;
        put();
        report_motion(0, 2.25F, 0.0F);
        step();
    }
    CHECK(count_sent(SPEED) > 0);
}

static void a_target_is_triggered_until_the_drive_takes_it_and_again_when_it_waits_for_one(void)
{
    begin_with_trigger();
    run(2.25F, 20 * MS);
    ask_for(DRIVE_READY);
    run(2.25F, 50 * MS);
    /* without power the target is the drive's position, and no trigger is sent */
    CHECK(count_sent(SPEED) > 0 && trigger_sent() == 0);
    w.powered = true;
    ask_for(DRIVE_ARMED);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    wanted_rad = 0.5, positioned = 1;
    for (uint32_t i = 0; i < 3; i++) {
        take_target(false);
        CHECK(trigger_sent() == 16);
        take_target(false); /* the frame or its answer was lost */
        CHECK(trigger_sent() == 16);
        take_target(true);
        CHECK(trigger_sent() == 0);
        take_target(true);
        CHECK(trigger_sent() == 0);
    }
    forget_sent();
    positioned = 0;
    run(2.25F, 50 * MS);
    CHECK(count_sent(SPEED) == 0);
}

static void a_stop_or_its_own_position_triggers_nothing(void)
{
    begin_with_trigger();
    make_armed();
    wanted_rad = 0.5, positioned = 1;
    take_target(false);
    CHECK(trigger_sent() == 16);
    make_stopping(3.0F);
    CHECK(quick_stop_sent()->data[7] == 0);
    report_state(0, 1);
    forget_sent();
    run(3.0F, 50 * MS);
    for (uint32_t i = 0; i < w.sent_count; i++) {
        CHECK(w.sent[i].id != SPEED || w.sent[i].data[7] == 0);
    }
}

static void a_drive_that_is_set_up_again_has_taken_no_target(void)
{
    begin_with_trigger();
    make_armed();
    report_state(0, 8 | 16);
    CHECK(m->joint[0].taken == 1 && state_of(0)->state.enabled == 1);
    ask_for(DRIVE_OFF);
    ask_for(DRIVE_READY);
    CHECK(m->joint[0].taken == 0);
}

static void a_trigger_is_a_single_bit_of_the_frame_of_a_target(void)
{
    static const struct {
        can_place trigger;
        uint32_t kind;
        bool good;
    } CASES[] = {
        {{.start_bit = 63, .length = 1}, SETPOINT_POSITION, true},
        {{.start_bit = 0, .length = 0}, SETPOINT_VELOCITY, true},
        {{.start_bit = 64, .length = 1}, SETPOINT_POSITION, false},
        {{.start_bit = 60, .length = 2}, SETPOINT_POSITION, false},
        {{.start_bit = 60, .length = 1, .form = 3}, SETPOINT_POSITION, false},
        {{.start_bit = 60, .length = 1}, SETPOINT_VELOCITY, false},
    };
    char name[FIELD_NAME_BYTES];
    for (uint32_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        begin_with_trigger();
        can_setpoint *setpoint = &table_of(0)->output[0].setpoint[0];
        setpoint->trigger = CASES[i].trigger;
        setpoint->scale.kind = CASES[i].kind;
        if (CASES[i].kind != SETPOINT_POSITION) {
            setpoint->scale.raw_offset = setpoint->scale.raw_per_s = 0.0;
        }
        CHECK((can_table_check(&w.table, name) == NULL) == CASES[i].good);
    }
}

int main(void)
{
    a_target_is_triggered_until_the_drive_takes_it_and_again_when_it_waits_for_one();
    a_stop_or_its_own_position_triggers_nothing();
    a_drive_that_is_set_up_again_has_taken_no_target();
    a_trigger_is_a_single_bit_of_the_frame_of_a_target();
    return checks_report("can trigger");
}
