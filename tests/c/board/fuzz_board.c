/* SPDX-License-Identifier: Apache-2.0
 * fuzz_board.c: the machine of a board with random bytes, requests and set-points, in each dialect.
 * For any input, motion is sent only to an armed board and only while the core requests it, no
 * frames are sent except in cycles and stops, and the line ends. */
#include "board_wire.h"
#include "tape.h"

#define FUZZ_NAME "fuzz_board"
enum { FUZZ_MAX = 256 };

static uint32_t mode_before;

static bool may_move(void)
{
    const setpoints *from = &w.machine.newest;
    return w.machine.state.mode == DRIVE_ARMED && from->enabled == 1 && from->stamp_ns > 0 &&
           w.machine.end.stage == END_NOT &&
           w.now_ns - from->stamp_ns <= w.table.setpoint_timeout_ns && isfinite(w.velocity_rad_s);
}

static bool judge(void *sink, const uint8_t *bytes, uint32_t count)
{
    (void)sink;
    CHECK(w.machine.end.stage != END_SILENT);
    if (w.full) {
        return false;
    }
    w.sent_count++;
    memcpy(w.sent, bytes, count);
    w.sent_bytes = count;
    if (w.table.dialect > BOARD_TEXT) {
        static const uint8_t rest[] = {0xCD, 0xAB, 0, 0, 0, 0, 0xCD, 0xAB};
        static const uint8_t still[] = {128, 0, 0, 0, 128, 4, 0, 4, 129, 0, 0, 1, 129, 4, 0, 5};
        bool saber = w.table.dialect == BOARD_SABERTOOTH;
        uint32_t size = saber ? sizeof still : sizeof rest;
        CHECK(count == size && (may_move() || memcmp(bytes, saber ? still : rest, size) == 0));
        return true;
    }
    if (w.table.dialect == BOARD_TEXT) {
        CHECK(count <= BOARD_TEXT_MAX && bytes[count - 1] == '\n');
        CHECK(may_move() || (count == 4 && memcmp(bytes, "0,0\n", 4) == 0));
        return true;
    }
    CHECK(may_move() || (last_sent(TARGET, 4, 1) == 0 && last_sent(TARGET + 6, 4, 1) == 0));
    CHECK(w.machine.state.mode != DRIVE_UNRESPONSIVE || last_sent(CONTROL, 1, 0) == CONTROL_BRAKE ||
          w.machine.state.back || w.machine.end.stage != END_NOT);
    return true;
}

/* The board sends a complete frame with a random payload. */
static void report_something(void)
{
    uint8_t frame[BOARD_WIRE_MAX], payload[BOARD_PAYLOAD_MAX] = {0};
    uint32_t size = next_byte() % 4 == 0 ? next_byte() % BOARD_PAYLOAD_MAX : 36;
    for (uint32_t i = 0; i < size && i < 36; i++) {
        payload[i] = next_byte() % 4 == 0 ? next_byte() : 0;
    }
    /* may announce a sensor, also in a payload that is too short for one */
    payload[STATUS] &= STATUS_ENABLED | STATUS_RESTARTED | STATUS_IMU;
    payload[WATCHDOG] = WATCHDOG_MS;
    board_place received = at(6, 2, 0);
    board_put(payload, &received, w.machine.sequence - next_byte() % 4);
    uint32_t count = board_frame_build(BOARD_TYPE_FEEDBACK, 0, (uint32_t)(w.now_ns / 1000), payload,
                                       size, frame);
    board_machine_receive(&w.machine, frame, count, w.now_ns);
}

/* A hoverboard sends a frame or the end of one, sometimes with a wrong check sum. */
static void report_packet(void)
{
    uint8_t frame[HOVERBOARD_FEEDBACK_BYTES] = {0xCD, 0xAB};
    for (uint32_t i = 2; i < 16; i++) {
        frame[i] =
            next_byte() % 4 == 0 ? (uint8_t)(next_byte() % 2 == 0 ? 0xCD : 0xAB) : next_byte();
    }
    for (uint32_t i = 0; i < 16; i++) {
        frame[16 + i % 2] ^= frame[i];
    }
    frame[16] ^= next_byte() % 4 == 0;
    uint32_t from = next_byte() % 4 == 0 ? next_byte() % HOVERBOARD_FEEDBACK_BYTES : 0;
    board_machine_receive(&w.machine, frame + from, HOVERBOARD_FEEDBACK_BYTES - from, w.now_ns);
    CHECK(w.machine.packet.count < HOVERBOARD_FEEDBACK_BYTES);
}

static void report_bytes(void)
{
    static const char *const words[] = {"v ",
                                        "1",
                                        ".",
                                        "e",
                                        "-",
                                        "\n",
                                        ";",
                                        "999999999999999999999",
                                        "v 1.5\n",
                                        "+",
                                        "{\"T\":1,\"v\":2}\n",
                                        "{",
                                        "}",
                                        "[",
                                        "\"",
                                        ":",
                                        ",",
                                        "\"v\":",
                                        "\\",
                                        "\"T\":1,"};
    for (uint32_t i = next_byte() % 8; i > 0; i--) {
        uint8_t byte = next_byte();
        const char *word = words[byte % 20];
        if (byte < 128) {
            board_machine_receive(&w.machine, &byte, 1, w.now_ns);
        } else {
            board_machine_receive(&w.machine, (const uint8_t *)word, (uint32_t)strlen(word),
                                  w.now_ns);
        }
    }
}

static void set_points(uint8_t choice)
{
    static const double wanted[] = {0.0,     1.0, -1.0, 1e300, (double)NAN, (double)INFINITY,
                                    -0.0001, 3.0};
    w.velocity_rad_s = wanted[choice % 8];
    setpoints *newest = &w.machine.newest;
    *newest = (setpoints){.stamp_ns = w.now_ns - (choice >> 6) * 40 * MS,
                          .enabled = choice >> 3 & 1,
                          .joint_count = choice >> 4 & 3};
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        newest->joint[j] = (joint_setpoint){.velocity_rad_s = w.velocity_rad_s,
                                            .duty = w.velocity_rad_s,
                                            .torque_n_m = w.velocity_rad_s};
    }
}

static void requests(uint8_t choice)
{
    mode_request *asked = &w.machine.control.request;
    asked->count += choice & 1;
    asked->mode = choice / 2 % 6;
    asked->arming_until_ns = (choice & 64) != 0 ? w.now_ns + 100 * MS : 0;
    if (choice >= 200) {
        /* the payload of a packet has set-points only */
        bool packets = w.table.dialect > BOARD_TEXT;
        board_order one = {.write = {.place = at(CONTROL, 1, 0), .raw = packets ? 0 : choice % 16},
                           .guarded = choice & 1,
                           .stops = w.machine.stops};
        (void)board_machine_order(&w.machine, &one);
    }
}

static void look(void)
{
    w.wake_ns = board_machine_step(&w.machine, w.now_ns);
    CHECK(w.wake_ns > w.now_ns);
    uint32_t mode = w.machine.state.mode;
    judge_mode(mode_before, mode, &w.machine.control.request);
    mode_before = mode;
    CHECK(w.machine.feedback_bytes <= BOARD_PAYLOAD_MAX && w.machine.tail.count <= BOARD_LINE_MAX);
}

/* The board sends something, which may change its mode: `judge_mode` compares with the new one. */
static void say(uint8_t choice)
{
    if (w.table.dialect == BOARD_FRAMES && choice % 4 != 0) {
        report_something();
    } else if (w.table.dialect == BOARD_HOVERBOARD && choice % 4 != 0) {
        report_packet();
    } else {
        report_bytes();
    }
    mode_before = w.machine.state.mode;
}

static board_table text(void)
{
    board_table table = {.dialect = BOARD_TEXT,
                         .answers = 1,
                         .tries = 3,
                         .payload_bytes = 12,
                         .setpoint_count = 2,
                         .feedback_bytes = 6,
                         .period_ns = 20 * MS,
                         .silence_ns = 150 * MS,
                         .setpoint_timeout_ns = 100 * MS,
                         .rest_velocity_rad_s = 0.1,
                         .written = {.part_count = 3, .literal = ",\n"},
                         .read = {.part_count = 2, .literal = "v \n"}};
    for (uint32_t j = 0; j < 2; j++) {
        table.setpoint[j] = (board_setpoint){
            .place = at(4 * j, 4, 1),
            .scale = {.joint = j, .raw_per_si = 1000.0, .raw_min = -1e6, .raw_max = 1e6}};
        table.written.part[j] =
            (board_part){.literal_bytes = j, .form = NUMBER_GENERAL, .precision = 6};
        table.written.part[j].number_per_raw[j] = 1.0;
    }
    table.written.part[2].literal_bytes = 1;
    table.read.part[0] = (board_part){
        .literal_bytes = 2, .form = NUMBER_FIXED, .place = at(0, 6, 1), .raw_per_number = 1e3};
    table.read.part[1].literal_bytes = 1;
    table.field[table.field_count++] = field_of(0, FIELD_VELOCITY, at(0, 6, 1), 0.001);
    return table;
}

/* The board reports {"T":1,"v":velocity}. */
static board_table json(void)
{
    board_table table = text();
    table.read = (board_text){.part_count = 2, .json = 1, .literal = "Tv"};
    table.read.part[0] =
        (board_part){.literal_bytes = 1, .form = NUMBER_CONSTANT, .raw_per_number = 1.0};
    table.read.part[1] = (board_part){
        .literal_bytes = 1, .form = NUMBER_FIXED, .place = at(0, 6, 1), .raw_per_number = 1e3};
    return table;
}

static board_table packets(uint32_t dialect, uint32_t mixed)
{
    bool saber = dialect == BOARD_SABERTOOTH;
    board_table table = {.dialect = dialect,
                         .answers = !saber,
                         .tries = 3,
                         .mixed = mixed,
                         .unit_count = 2,
                         .unit = {128, 129},
                         .payload_bytes =
                             saber ? 2 * SABERTOOTH_SETPOINT_BYTES : HOVERBOARD_SETPOINT_BYTES,
                         .feedback_bytes = saber ? 0 : HOVERBOARD_VALUE_BYTES,
                         .period_ns = 20 * MS,
                         .silence_ns = 150 * MS,
                         .setpoint_timeout_ns = 100 * MS,
                         .rest_velocity_rad_s = 0.1};
    for (uint32_t j = 0; j < 2; j++) {
        double most = saber ? 127.0 : 1000.0;
        table.setpoint[table.setpoint_count++] = (board_setpoint){
            .place = saber ? at(1 + 3 * j, 1, 1) : at(2 * j, 2, 1),
            .scale = {.joint = j, .raw_per_si = 10.0, .raw_min = -most, .raw_max = most}};
        if (!saber) {
            table.field[table.field_count++] =
                field_of(j, FIELD_VELOCITY, at(4 + 2 * j, 2, 1), 0.1);
        }
    }
    return table;
}

static board_table some_table(uint8_t choice)
{
    switch (choice % 6) {
    case 0:
    case 1: return frames_table();
    case 2: return choice < 128 ? text() : json();
    case 3: return packets(BOARD_SABERTOOTH, 0);
    default: return packets(BOARD_HOVERBOARD, choice % 2);
    }
}

/* Begins with an armed board, because most errors need one. */
static void begin_armed(void)
{
    set_points(1 + 8 + 32);
    w.machine.control.request = (mode_request){.count = 1, .mode = DRIVE_READY};
    look();
    w.machine.control.request = (mode_request){.count = 2, .mode = DRIVE_ARMED};
    look();
    CHECK(w.machine.state.mode == DRIVE_ARMED);
}

static void once(const uint8_t *data, size_t size)
{
    put_tape(data, size);
    board_table table = some_table(next_byte());
    uint32_t used = next_byte() % 2;
    table.imu = (board_imu){.used = used * (table.dialect <= BOARD_TEXT),
                            .axis = {2, 0, 1},
                            .backward = {0, 1, 0},
                            .rate_z = at(0, 6, 1)};
    begin_with(table);
    w.machine.send = judge;
    mode_before = w.machine.state.mode;
    if (next_byte() % 2 == 0) {
        begin_armed();
    }
    while (tape_left > 0) {
        uint8_t choice = next_byte();
        w.full = choice >= 240;
        if (choice & 1) {
            requests(next_byte());
        }
        if (choice & 2) {
            set_points(next_byte());
        }
        if (choice & 4) {
            say(next_byte());
        }
        uint32_t before = w.sent_count;
        look();
        CHECK(w.sent_count <= before + 1);
        w.now_ns = (choice & 8) != 0 ? w.wake_ns : w.now_ns + next_byte() * MS / 8;
    }
    w.machine.control.shut_down = 1;
    for (int64_t asked_ns = w.now_ns; w.machine.end.stage != END_SILENT; w.now_ns = w.wake_ns) {
        look();
        /* the last 500 are for a board that sends feedback and does not report that it has no
         * power */
        CHECK(w.now_ns <= asked_ns + 1100 * MS);
    }
    look();
}

#include "fuzz.h"
