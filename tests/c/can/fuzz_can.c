/* SPDX-License-Identifier: Apache-2.0
 * fuzz_can.c: the machine of a CAN bus with random drives, jobs, requests and set-points, on a bus
 * that takes frames at random. For any input, motion is sent only to an armed drive and only while
 * the core requests it, a stop is sent at once or in the first look in which the bus takes it, a
 * job that was overtaken by a stop is not sent, and the line ends. */
#include "can_wire.h"
#include "tape.h"

#define FUZZ_NAME "fuzz_can"
enum { FUZZ_MAX = 256, DRIVES = 3, SYNC = 0x80, SLOW = 0x600, STRANGER = 0x77 };

static const float REPORTED_RAD_S = 10.0F, GREAT_RAD_S = 3e38F;

static uint32_t modes[DRIVES];
static int16_t last_sent[DRIVES]; /* the newest speed that each drive was sent */
static uint8_t taking;            /* which frames the bus takes; 0: all, 1: no frame, n: all but
                                     each n-th */
static uint32_t offered, refused;

static bool may_move(uint32_t drive)
{
    const setpoints *from = &w.machine.newest;
    double wanted = drive < from->joint_count ? from->joint[drive].velocity_rad_s : 0.0;
    return w.machine.drive[drive].state.mode == DRIVE_ARMED && w.machine.end.stage == END_NOT &&
           from->enabled == 1 && from->stamp_ns > 0 &&
           w.now_ns - from->stamp_ns <= w.table.setpoint_timeout_ns && isfinite(wanted) &&
           wanted != 0.0;
}

/* ------------------------------------------------------------------------------ the bus */
static void judge_job(const can_packet *packet, uint32_t drive)
{
    uint32_t stops;
    memcpy(&stops, packet->data + 1, sizeof stops);
    CHECK(packet->data[0] == 0 || stops == w.machine.drive[drive].stops);
}

static void judge_packet(const can_packet *packet)
{
    uint32_t drive = packet->id & 0x0F;
    CHECK(w.machine.end.stage != END_SILENT && packet->bytes <= 8);
    switch (packet->id & ~0x0FU) {
    case SPEED:
        CHECK(drive < DRIVES);
        last_sent[drive] = speed_in(packet);
        CHECK(last_sent[drive] == 0 || may_move(drive));
        break;
    case CONTROL:
        CHECK(drive < DRIVES);
        judge_job(packet, drive);
        break;
    default:
        CHECK(packet->id == SYNC || packet->id == SLOW ||
              packet->id == (CAN_ID_REMOTE | (MOTION + 1)));
    }
}

static bool offer(void *sink, const can_packet *packet)
{
    (void)sink;
    offered++;
    if (taking == 1 || (taking > 1 && offered % taking == 0)) {
        refused++;
        return false;
    }
    judge_packet(packet);
    return true;
}

/* Three drives. The first is sent zero at rest. The second is not, and cannot report whether it has
 * power. The third has a watchdog and two frames in each stop, and is unresponsive until it
 * answers. */
static void begin(void)
{
    begin_with(DRIVES);
    can_drive *second = &w.table.drive[1], *third = &w.table.drive[2];
    second->idle_setpoints = second->reports_enabled = 0;
    second->input[0].field_count = 0;
    second->poll_count = second->slow_count = second->probe_count = 1;
    second->poll[0] = second->probe[0] = packet_of(CAN_ID_REMOTE | (MOTION + 1), 8);
    second->slow[0] = packet_of(SLOW, 1);
    third->watchdog_ns = 50 * MS;
    third->hello = 1;
    third->quick_stop_count = third->disarm_count = 2;
    third->quick_stop[1] = third->quick_stop[0];
    third->disarm[1] = third->disarm[0];
    w.table.sync_count = 1;
    w.table.sync[0] = packet_of(SYNC, 0);
    CHECK(can_machine_init(&w.machine, &w.table, &(can_before){.epoch = 7, .may_turn = 2}, offer,
                           NULL, w.now_ns) == 0);
    memset(modes, 0, sizeof modes);
    memset(last_sent, 0, sizeof last_sent);
    taking = 0;
}

/* ------------------------------------------------------------------------- what happens */
static void set_points(uint8_t choice)
{
    static const double values[] = {0.0,  1.0, -3.0, 1e300, (double)NAN, (double)INFINITY,
                                    -0.0, 2.0};
    setpoints *to = &w.machine.newest;
    if (choice % 4 != 0) {
        to->stamp_ns = choice % 16 == 1 ? w.now_ns + 5 * MS : choice % 16 == 2 ? -5 : w.now_ns;
    }
    to->enabled = choice >> 4 & 1;
    to->joint_count = choice % 8 == 7 ? 1 : DRIVES;
    for (uint32_t i = 0; i < DRIVES; i++) {
        to->joint[i].velocity_rad_s = values[((choice >> 5) + i) & 7];
    }
}

static void put_job(uint32_t drive, uint8_t choice)
{
    can_order order = {.write = {.packet = packet_of(CONTROL + drive, 8)},
                       .drive = drive,
                       .guarded = choice & 1,
                       .stops = w.machine.drive[drive].stops,
                       .expires_ns = w.now_ns + (choice & 6) * MS};
    if ((choice & 8) != 0) { /* changes the control word of the cyclic frame */
        order.write = w.table.drive[drive].disarm[0];
        order.write.packet.data[0] = ENABLE;
    } else {
        order.write.packet.data[0] = (uint8_t)order.guarded;
        memcpy(order.write.packet.data + 1, &order.stops, sizeof order.stops);
    }
    (void)can_machine_order(&w.machine, &order);
}

static void asyncio_side(uint8_t choice)
{
    static const uint32_t requests[] = {DRIVE_OFF,   DRIVE_READY, DRIVE_READY,
                                        DRIVE_ARMED, DRIVE_ARMED, DRIVE_STAND_DOWN};
    uint32_t drive = choice % DRIVES, what = choice / DRIVES;
    mode_request *to = &w.machine.control.drive[drive];
    if (what < 30) {
        to->count++;
        to->mode = requests[what % 6];
    } else if (what < 60) {
        put_job(drive, next_byte());
    } else if (what < 70) {
        w.machine.control.listen = what;
    } else if (what < 80) {
        to->arming_until_ns = w.now_ns + 20 * MS;
    } else if (what < 82) {
        w.machine.receives_own = !w.machine.receives_own;
    } else if (what < 84) {
        can_machine_left(&w.machine, SPEED + what % 2);
    } else if (what == 84) {
        w.machine.control.shut_down = 1;
    }
}

static void receive(const can_packet *packet, int64_t stamp_ns)
{
    uint32_t who = can_machine_receive(&w.machine, packet, stamp_ns, w.now_ns);
    bool listening = who < DRIVES && (w.machine.control.listen >> who & 1) != 0;
    CHECK(who == CAN_FOR_NOBODY || who == CAN_DRIVES_MAX || listening);
}

static void receive_motion(uint32_t drive, uint8_t choice)
{
    const float reported[] = {
        REPORTED_RAD_S + (float)drive, 0.0F, NAN, INFINITY, GREAT_RAD_S, -INFINITY, 0.0F, 0.0F};
    float both[2] = {reported[choice >> 3 & 7], reported[choice & 7]};
    can_packet packet = packet_of(MOTION + drive, 8);
    memcpy(packet.data, both, sizeof both);
    receive(&packet, w.now_ns - (choice >> 6) * MS);
}

static void receive_state(uint32_t drive, uint8_t choice)
{
    can_packet packet = packet_of(STATE + drive, 1);
    packet.data[0] = choice % 4 == 0 ? 8 : 1;
    receive(&packet, w.now_ns);
}

/* A frame that no drive of the table sends, or one of another form. */
static void receive_noise(uint8_t choice)
{
    static const uint32_t ids[] = {STRANGER,
                                   CAN_ID_ERROR | 0x40,
                                   CAN_ID_REMOTE | MOTION,
                                   CAN_ID_EXTENDED | MOTION,
                                   MOTION,
                                   STATE + 1,
                                   ANSWER,
                                   ANSWER + 2};
    can_packet packet = packet_of(ids[choice & 7], choice >> 3 & 7);
    for (uint32_t i = 0; i < packet.bytes; i++) {
        packet.data[i] = next_byte();
    }
    receive(&packet, w.now_ns);
}

static void drives_side(uint8_t choice)
{
    for (uint32_t i = 0; i < DRIVES; i++) {
        if ((choice >> i & 1) != 0) {
            receive_motion(i, (choice & 0x80) != 0 ? next_byte() : 0);
        }
        if ((choice >> (3 + i) & 1) != 0) {
            receive_state(i, next_byte());
        }
    }
    if ((choice & 0x40) != 0) {
        receive_noise(next_byte());
    }
}

/* ---------------------------------------------------------------------------- the judge */
static void judge_modes(void)
{
    for (uint32_t i = 0; i < DRIVES; i++) {
        uint32_t now = w.machine.drive[i].state.mode;
        judge_mode(modes[i], now, &w.machine.control.drive[i]);
        modes[i] = now;
        double velocity = w.machine.joint[i].feedback.velocity_rad_s;
        bool its_own = velocity == (double)(REPORTED_RAD_S + (float)i) ||
                       velocity == (double)GREAT_RAD_S || velocity == 0.0;
        CHECK(isnan(velocity) || its_own);
    }
    CHECK((w.machine.feedback_mask & ~7U) == 0);
}

/* A drive that was sent motion and may not move any more has been sent zero, if the bus takes
 * frames. An unresponsive drive gets it with the probe of its next cycle. */
static void judge_stops(bool cycled)
{
    for (uint32_t i = 0; i < DRIVES; i++) {
        bool waits = w.machine.drive[i].state.mode == DRIVE_UNRESPONSIVE && !cycled;
        CHECK(last_sent[i] == 0 || may_move(i) || waits);
    }
}

static void look(void)
{
    uint64_t cycles = w.machine.cycle.count;
    offered = refused = 0;
    w.wake_ns = can_machine_step(&w.machine, w.now_ns);
    CHECK(w.wake_ns > w.now_ns && w.wake_ns <= w.now_ns + 20 * MS);
    judge_modes();
    /* at the end, a bus that refuses frames has had enough time */
    if (refused == 0 && w.machine.end.stage < END_SILENT) {
        judge_stops(w.machine.cycle.count != cycles);
    }
}

static void request_all(uint32_t mode)
{
    for (uint32_t i = 0; i < DRIVES; i++) {
        receive_motion(i, 0);
        receive_state(i, w.machine.drive[i].state.mode == DRIVE_ARMED ? 0 : 1);
        w.machine.control.drive[i].count++;
        w.machine.control.drive[i].mode = mode;
    }
    set_points(0x33); /* enabled, with motion for all drives */
    look();
    w.now_ns = w.wake_ns;
}

/* Begins with moving drives, because most errors need them. */
static void get_going(uint8_t how_far)
{
    if (how_far % 4 > 0) {
        request_all(DRIVE_READY);
    }
    if (how_far % 4 > 1) {
        request_all(DRIVE_ARMED);
        request_all(DRIVE_ARMED);
        CHECK(last_sent[0] != 0 && last_sent[1] != 0 && last_sent[2] != 0);
    }
}

static void once(const uint8_t *data, size_t size)
{
    put_tape(data, size);
    begin();
    get_going(next_byte());
    while (tape_left > 4) {
        uint8_t choice = next_byte();
        if ((choice & 1) != 0) {
            asyncio_side(next_byte());
        }
        if ((choice & 2) != 0) {
            set_points(next_byte());
        }
        if ((choice & 4) != 0) {
            drives_side(next_byte());
        }
        taking = (choice & 0x38) == 0x38 ? next_byte() % 4 : (choice & 0x38) == 0x30 ? 0 : taking;
        look();
        w.now_ns = (choice & 0xC0) == 0xC0 ? w.now_ns + (int64_t)next_byte() * MS / 4 : w.wake_ns;
    }
    w.machine.control.shut_down = 1;
    int64_t asked_ns = w.now_ns;
    while (w.machine.end.stage != END_SILENT) {
        look();
        w.now_ns = w.wake_ns;
        /* the last 500 are for a drive that sends frames and does not report that it has no
         * power */
        CHECK(w.now_ns <= asked_ns + 1100 * MS);
    }
    look();
    CHECK(offered == 0);
}

#include "fuzz.h"
