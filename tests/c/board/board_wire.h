/* SPDX-License-Identifier: Apache-2.0
 * board_wire.h: the machine of a board in virtual time, with the reference board at the other end
 * of the wire. */
#ifndef MOTORD_TESTS_BOARD_WIRE_H
#define MOTORD_TESTS_BOARD_WIRE_H

#include <math.h>
#include <string.h>

#include "../../../docs/mcu/motord_mcu.c"
#include "board_machine.h"
#include "check.h"

enum {
    CONTROL = 0,
    STATUS = 0,
    WATCHDOG = 2,
    FAULTS = 10,
    VOLTAGE = 12,
    TARGET = 6,
    COUNT = 16,
    SPEED = 20,
    MOTORS = 2
};
enum { WATCHDOG_MS = 200, CONTROL_OFF = 0 };

static const int64_t MS = 1000000;

typedef struct {
    board_table table;
    board_machine machine;
    motord_board peer;
    motord_measured measured[MOTORS];
    motord_health health;
    int64_t now_ns, wake_ns;
    double velocity_rad_s; /* set-points of the core for all joints */
    uint32_t enabled;      /* set by the core; 2: no set-points come any more */
    /* the board is silent; it receives nothing; the port takes no bytes */
    bool mute, receives_nothing, full;
    bool stuck;                   /* its wheels keep turning and ignore what they are sent */
    uint8_t sent[BOARD_WIRE_MAX]; /* the newest frame */
    uint32_t sent_bytes, sent_count;
    uint32_t moving_count; /* frames with a set-point that is not zero */
} board_wire;

static board_wire w;

static inline board_place at(uint32_t byte, uint32_t bytes, uint32_t is_signed)
{
    return (board_place){.byte = byte, .bytes = bytes, .is_signed = is_signed};
}

/* A number in the payload of the newest frame. */
static inline int64_t last_sent(uint32_t byte, uint32_t bytes, uint32_t is_signed)
{
    uint8_t raw[BOARD_FRAME_MAX];
    uint32_t count = board_frame_parse(w.sent + 1, w.sent_bytes - 2, raw);
    CHECK(count == BOARD_HEAD_BYTES + w.table.payload_bytes && raw[1] == BOARD_TYPE_SETPOINTS);
    board_place place = at(BOARD_HEAD_BYTES + byte, bytes, is_signed);
    return board_get(raw, &place);
}

static inline bool take_bytes(void *sink, const uint8_t *bytes, uint32_t count)
{
    (void)sink;
    if (w.full) {
        return false;
    }
    memcpy(w.sent, bytes, count);
    w.sent_bytes = count;
    w.sent_count++;
    if (w.table.dialect == BOARD_FRAMES) {
        w.moving_count += last_sent(TARGET, 4, 1) != 0 || last_sent(TARGET + 6, 4, 1) != 0;
        for (uint32_t i = 0; !w.receives_nothing && i < count; i++) {
            motord_board_byte(&w.peer, bytes[i], (uint32_t)(w.now_ns / 1000));
        }
    }
    return true;
}

static inline board_field field_of(uint32_t joint, uint32_t kind, board_place place,
                                   double si_per_raw)
{
    return (board_field){
        .place = place,
        .meaning = {.joint = joint, .kind = kind, .counter_bits = 32, .si_per_raw = si_per_raw}};
}

static inline board_field level_of(uint32_t kind, board_place place, uint32_t mask, uint32_t equals)
{
    return (board_field){.place = place,
                         .meaning = {.kind = kind, .equals_mask = mask, .equals = equals}};
}

/* The table of config/drives/mcu-velocity.toml. */
static inline board_table frames_table(void)
{
    board_table table = {.dialect = BOARD_FRAMES,
                         .answers = 1,
                         .tries = 3,
                         .payload_bytes = 18,
                         .feedback_bytes = 36,
                         .quick_stop_count = 1,
                         .disarm_count = 1,
                         .period_ns = 10 * MS,
                         .silence_ns = 150 * MS,
                         .setpoint_timeout_ns = 100 * MS,
                         .rest_velocity_rad_s = 0.1,
                         .watchdog_ns = WATCHDOG_MS * MS};
    table.payload[1] = MOTORS;
    table.payload[4] = 10; /* feedback period, ms */
    for (uint32_t j = 0; j < MOTORS; j++) {
        table.setpoint[table.setpoint_count++] =
            (board_setpoint){.place = at(TARGET + 6 * j, 4, 1),
                             .scale = {.joint = j,
                                       .raw_per_si = j == 1 ? -1000.0 : 1000.0,
                                       .raw_min = -1e6,
                                       .raw_max = 1e6}};
        table.field[table.field_count++] = field_of(j, FIELD_COUNT, at(COUNT + 10 * j, 4, 1), 1.0);
        table.field[table.field_count++] =
            field_of(j, FIELD_VELOCITY, at(SPEED + 10 * j, 4, 1), j == 1 ? -0.001 : 0.001);
        table.field[table.field_count++] = field_of(j, FIELD_VOLTAGE, at(VOLTAGE, 2, 0), 0.01);
        table.field[table.field_count] = field_of(j, FIELD_FAULT, at(FAULTS, 2, 0), 1.0);
        table.field[table.field_count++].meaning.harmless_bits = 4;
    }
    table.field[table.field_count++] = level_of(FIELD_KEPT, at(STATUS, 1, 0), STATUS_RESTARTED, 0);
    table.field[table.field_count++] =
        level_of(FIELD_KEPT, at(WATCHDOG, 2, 0), UINT32_MAX, WATCHDOG_MS);
    table.field[table.field_count++] =
        level_of(FIELD_ENABLED, at(STATUS, 1, 0), STATUS_ENABLED, STATUS_ENABLED);
    table.quick_stop[0] = (board_write){.place = at(CONTROL, 1, 0), .raw = CONTROL_BRAKE};
    table.disarm[0] = (board_write){.place = at(CONTROL, 1, 0), .raw = CONTROL_OFF};
    return table;
}

/* The board is sent two numbers and reports one velocity. */
static inline board_table text_table(bool answers)
{
    board_table table = {.dialect = BOARD_TEXT,
                         .answers = answers,
                         .tries = 3,
                         .payload_bytes = 8,
                         .setpoint_count = 2,
                         .feedback_bytes = answers ? 6 : 0,
                         .period_ns = 20 * MS,
                         .silence_ns = 150 * MS,
                         .setpoint_timeout_ns = 100 * MS,
                         .rest_velocity_rad_s = 0.1,
                         .written = {.part_count = 3, .literal = ",\n"}};
    for (uint32_t j = 0; j < 2; j++) {
        table.setpoint[j] = (board_setpoint){
            .place = at(4 * j, 4, 1),
            .scale = {.joint = j, .raw_per_si = 1000.0, .raw_min = -1e6, .raw_max = 1e6}};
        table.written.part[j] = (board_part){.literal_bytes = j, .form = NUMBER_INTEGER};
        table.written.part[j].number_per_raw[j] = 0.255;
    }
    table.written.part[2].literal_bytes = 1;
    if (answers) {
        table.read = (board_text){.part_count = 2, .literal = "v \n"};
        table.read.part[0] = (board_part){.literal_bytes = 2,
                                          .form = NUMBER_FIXED,
                                          .place = at(0, 6, 1),
                                          .raw_per_number = 1000.0};
        table.read.part[1].literal_bytes = 1;
        table.field[table.field_count++] = field_of(0, FIELD_VELOCITY, at(0, 6, 1), 0.001);
    }
    return table;
}

static inline void restart(void)
{
    CHECK(board_machine_init(&w.machine, &w.table, w.machine.state.epoch, w.machine.sequence,
                             w.now_ns) == 0);
    w.machine.send = take_bytes;
    w.wake_ns = w.now_ns;
}

static inline void begin_with(board_table table)
{
    memset(&w, 0, sizeof w);
    w.table = table;
    w.now_ns = 1000 * MS;
    w.velocity_rad_s = 1.0;
    w.enabled = 1;
    w.health.voltage_10mv = 2400;
    motord_board_init(&w.peer, MOTORS, (uint32_t)(w.now_ns / 1000));
    restart();
}

static inline void begin(void)
{
    begin_with(frames_table());
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
    w.wake_ns = board_machine_step(&w.machine, w.now_ns);
    CHECK(w.wake_ns > w.now_ns); /* a step never requests an immediate wake-up without need */
}

static inline void receive(const char *text)
{
    board_machine_receive(&w.machine, (const uint8_t *)text, (uint32_t)strlen(text), w.now_ns);
}

static inline void speak(void)
{
    uint8_t bytes[MOTORD_SENT_BYTES_MAX];
    for (uint32_t j = 0; j < MOTORS && !w.stuck; j++) {
        w.measured[j].velocity_mrad_s = w.peer.setpoint[j].velocity_mrad_s;
        w.measured[j].count += w.measured[j].velocity_mrad_s / 1000;
    }
    size_t count =
        motord_board_feedback(&w.peer, (uint32_t)(w.now_ns / 1000), w.measured, &w.health, bytes);
    if (!w.mute && count > 0) {
        board_machine_receive(&w.machine, bytes, (uint32_t)count, w.now_ns);
    }
}

/* Advances the time, with one look at the board each millisecond. */
static inline void go_on(int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        if (w.table.dialect == BOARD_FRAMES) {
            speak();
        }
        if (w.now_ns >= w.wake_ns) {
            step();
        }
        w.now_ns += MS;
    }
}

static inline void request(uint32_t mode)
{
    w.machine.control.request.count++;
    w.machine.control.request.mode = mode;
    step();
}

static inline void order(uint32_t byte, uint32_t bytes, int64_t raw, uint32_t guarded)
{
    board_order one = {.write = {.place = at(byte, bytes, 0), .raw = raw},
                       .guarded = guarded,
                       .stops = w.machine.stops};
    CHECK(board_machine_order(&w.machine, &one));
    for (uint32_t i = 0; i < 300 && w.machine.has_order; i++) {
        go_on(MS);
    }
    CHECK(!w.machine.has_order);
    go_on(20 * MS);
}

static inline void set_up(void)
{
    go_on(150 * MS);
    order(CONTROL, 1, CONTROL_RESTART_NOTED, 0);
    order(CONTROL, 1, CONTROL_OFF, 0); /* else it would clear the flag of the next restart, too */
    order(WATCHDOG, 2, WATCHDOG_MS, 0);
    request(DRIVE_READY);
    CHECK(w.machine.state.mode == DRIVE_READY && w.machine.state.fault_reasons == 0 &&
          w.machine.state.enabled == 2);
    /* feedback from before the set-up does not count */
    CHECK(isnan(w.machine.joint[0].feedback.velocity_rad_s));
}

static inline void arm(void)
{
    set_up();
    w.machine.control.request.arming_until_ns = w.now_ns + 1000 * MS;
    order(CONTROL, 1, CONTROL_ENABLE, 1);
    CHECK(w.peer.enabled == 1 && w.machine.state.enabled == 1);
    request(DRIVE_ARMED);
    CHECK(w.machine.state.mode == DRIVE_ARMED && w.machine.state.enabled == 2);
}

/* Whether Python is to be notified since the last call. */
static inline bool received_changes(void)
{
    bool notify = w.machine.notify;
    w.machine.notify = false;
    return notify;
}

static inline void arm_and_turn(void)
{
    arm();
    go_on(50 * MS);
    CHECK(w.peer.setpoint[0].velocity_mrad_s == 1000 &&
          w.peer.setpoint[1].velocity_mrad_s == -1000);
}

#endif
