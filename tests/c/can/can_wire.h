/* SPDX-License-Identifier: Apache-2.0
 * can_wire.h: the machine of a CAN bus in virtual time, with drives that may be silent. */
#ifndef MOTORD_TESTS_CAN_WIRE_H
#define MOTORD_TESTS_CAN_WIRE_H

#include <math.h>
#include <string.h>

#include "can_machine.h"
#include "check.h"

enum {
    SPEED = 0x100,
    CONTROL = 0x200,
    STATE = 0x300,
    MOTION = 0x400,
    ANSWER = 0x500,
    SENT_MAX = 4096
};
enum { ENABLE = 15, QUICK_STOP = 2, DISABLE = 6 };

static const int64_t MS = 1000000;

typedef struct {
    can_table table;
    can_machine machine;
    int64_t now_ns, wake_ns;
    double velocity_rad_s; /* set-points of the core for all joints */
    double reported_rad_s; /* speed that the drives report */
    uint32_t enabled;      /* set by the core; 2: no set-points come any more */
    bool powered, silent, full;
    uint32_t not_taken; /* an identifier that the bus refuses; 0: it refuses nothing */
    can_packet sent[SENT_MAX];
    int64_t sent_ns[SENT_MAX];
    uint32_t sent_count;
} can_wire;

static can_wire w;

static inline bool take(void *sink, const can_packet *packet)
{
    CHECK(sink == &w);
    if (w.full || packet->id == w.not_taken) {
        return false;
    }
    CHECK(w.sent_count < SENT_MAX);
    w.sent_ns[w.sent_count] = w.now_ns;
    w.sent[w.sent_count++] = *packet;
    return true;
}

static inline can_packet packet_of(uint32_t id, uint32_t bytes)
{
    return (can_packet){.id = id, .bytes = bytes};
}

/* A drive whose cyclic frame has a control word and a speed of 16 bits. It sends its state and
 * speed by itself. */
static inline can_drive can_drive_of(uint32_t n)
{
    can_drive drive = {.tries = 3,
                       .slow_every = 8,
                       .idle_setpoints = 1,
                       .reports_enabled = 1,
                       .output_count = 1,
                       .match_count = 3,
                       .input_count = 2,
                       .quick_stop_count = 1,
                       .disarm_count = 1,
                       .watchdog_ns = 500 * MS};
    drive.output[0] = (can_output){.packet = packet_of(SPEED + n, 4), .setpoint_count = 1};
    drive.output[0].setpoint[0] = (can_setpoint){
        .place = {.start_bit = 16, .length = 16, .form = CAN_SIGNED},
        .scale = {.joint = n, .raw_per_si = 100.0, .raw_min = -1000.0, .raw_max = 1000.0}};
    drive.input[0] = (can_input){.silence_ns = 300 * MS, .fast = 1, .field_count = 1};
    drive.input[0].field[0] = (can_field){
        .place = {.length = 8},
        .meaning = {.kind = FIELD_ENABLED, .equals_mask = 0xFF, .equals = 8, .si_per_raw = 1.0}};
    drive.input[1] =
        (can_input){.silence_ns = 200 * MS, .spacing_ns = 5 * MS, .fast = 1, .field_count = 2};
    drive.input[1].field[0] = (can_field){
        .place = {.length = 32, .form = CAN_FLOAT},
        .meaning = {.joint = n, .kind = FIELD_COUNT, .counter_bits = 32, .si_per_raw = 1000.0}};
    drive.input[1].field[1] =
        (can_field){.place = {.start_bit = 32, .length = 32, .form = CAN_FLOAT},
                    .meaning = {.joint = n, .kind = FIELD_VELOCITY, .si_per_raw = 1.0}};
    drive.match[0] = (can_match){.id = STATE + n, .bytes = 1, .input = 1};
    drive.match[1] = (can_match){.id = MOTION + n, .bytes = 8, .input = 2};
    drive.match[2] = (can_match){
        .id = ANSWER + n, .bytes = 8, .begins_bytes = 1, .begins = {0x43}, .begins_mask = {0xFF}};
    drive.quick_stop[0] =
        (can_write){.packet = packet_of(SPEED + n, 4), .output = 1, .mask = {0xFF, 0xFF}};
    drive.quick_stop[0].packet.data[0] = QUICK_STOP;
    drive.disarm[0] = drive.quick_stop[0];
    drive.disarm[0].packet.data[0] = DISABLE;
    return drive;
}

static inline void restart(void)
{
    can_before before = {.epoch = w.machine.drive[0].state.epoch};
    for (uint32_t i = 0; i < w.table.drive_count; i++) {
        before.may_turn |= (uint32_t)w.machine.drive[i].may_turn << i;
    }
    CHECK(can_machine_init(&w.machine, &w.table, &before, take, &w, w.now_ns) == 0);
}

static inline void begin_with(uint32_t drives)
{
    memset(&w, 0, sizeof w);
    w.now_ns = w.wake_ns = 1000 * MS;
    w.velocity_rad_s = 1.0;
    w.enabled = 1;
    w.table = (can_table){.drive_count = drives,
                          .period_ns = 10 * MS,
                          .setpoint_timeout_ns = 100 * MS,
                          .rest_velocity_rad_s = 0.1};
    for (uint32_t i = 0; i < drives; i++) {
        w.table.drive[i] = can_drive_of(i);
    }
    restart();
}

static inline uint32_t say(uint32_t id, const void *data, uint32_t bytes)
{
    can_packet packet = packet_of(id, bytes);
    memcpy(packet.data, data, bytes);
    return can_machine_receive(&w.machine, &packet, w.now_ns, w.now_ns);
}

static inline void report_motion(uint32_t drive, float position, float velocity)
{
    float both[2] = {position, velocity};
    (void)say(MOTION + drive, both, sizeof both);
}

static inline void report_state(uint32_t drive, uint8_t state)
{
    (void)say(STATE + drive, &state, 1);
}

static inline void step(void)
{
    if (w.enabled < 2) {
        w.machine.newest =
            (setpoints){.stamp_ns = w.now_ns, .enabled = w.enabled, .joint_count = JOINTS_MAX};
        for (uint32_t j = 0; j < JOINTS_MAX; j++) {
            w.machine.newest.joint[j] = (joint_setpoint){.velocity_rad_s = w.velocity_rad_s,
                                                         .duty = w.velocity_rad_s,
                                                         .torque_n_m = w.velocity_rad_s};
        }
    }
    w.wake_ns = can_machine_step(&w.machine, w.now_ns);
    CHECK(w.wake_ns > w.now_ns); /* a step never requests an immediate wake-up without need */
}

/* Advances the time. The drives send their state each 10 ms. */
static inline void go_on(int64_t for_ns)
{
    int64_t end_ns = w.now_ns + for_ns, speak_ns = w.now_ns;
    while (w.now_ns < end_ns) {
        for (uint32_t i = 0; !w.silent && w.now_ns >= speak_ns && i < w.table.drive_count; i++) {
            report_state(i, w.powered ? 8 : 1);
            report_motion(i, 1.0F, (float)w.reported_rad_s);
        }
        speak_ns = w.now_ns >= speak_ns ? w.now_ns + 10 * MS : speak_ns;
        step();
        w.now_ns = w.wake_ns < speak_ns ? w.wake_ns : speak_ns;
    }
}

static inline void request(uint32_t drive, uint32_t mode)
{
    w.machine.control.drive[drive].count++;
    w.machine.control.drive[drive].mode = mode;
    step();
}

static inline void arm(uint32_t drive)
{
    go_on(20 * MS);
    request(drive, DRIVE_READY);
    go_on(20 * MS);
    w.powered = true;
    request(drive, DRIVE_ARMED);
    CHECK(w.machine.drive[drive].state.mode == DRIVE_ARMED);
}

static inline can_drive *table_of(uint32_t drive)
{
    return &w.table.drive[drive];
}

static inline const can_drive_state *state_of(uint32_t drive)
{
    return &w.machine.drive[drive];
}

static inline void become_unresponsive(void)
{
    w.silent = true;
    go_on(320 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE);
}

static inline void forget_sent(void)
{
    w.sent_count = 0;
}

static inline uint32_t count_sent(uint32_t id)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < w.sent_count; i++) {
        count += w.sent[i].id == id;
    }
    return count;
}

static inline int16_t speed_in(const can_packet *packet)
{
    return (int16_t)can_get(packet->data,
                            &(can_place){.start_bit = 16, .length = 16, .form = CAN_SIGNED});
}

/* The newest set-point frame of a drive, with speed and control word. */
static inline const can_packet *newest_of(uint32_t drive)
{
    for (uint32_t i = w.sent_count; i > 0; i--) {
        if (w.sent[i - 1].id == SPEED + drive) {
            return &w.sent[i - 1];
        }
    }
    CHECK(false);
    return NULL;
}

/* The time at which a frame with this control word was first sent; 0: never. */
static inline int64_t first_sent_ns(uint32_t drive, uint8_t word)
{
    for (uint32_t i = 0; i < w.sent_count; i++) {
        if (w.sent[i].id == SPEED + drive && w.sent[i].data[0] == word) {
            return w.sent_ns[i];
        }
    }
    return 0;
}

static inline void arm_and_go(void)
{
    arm(0);
    go_on(30 * MS);
    CHECK(state_of(0)->state.sent_motion && speed_in(newest_of(0)) == 100);
}

#endif
