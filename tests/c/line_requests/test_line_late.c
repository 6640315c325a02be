/* SPDX-License-Identifier: Apache-2.0
 * Drives that answer late, on a wire in virtual time: which request a reply belongs to, and how old
 * its values are. A drive answers in the order of its requests. Its counter is the time, in tenths
 * of a millisecond. */
#include <math.h>

#include "line_wire.h"

enum { LOST = 1, DAMAGED, LATE };
enum { QUEUE_MAX = 64, UNITS_MAX = 2, BOTH = 4 };

static const int64_t TICK_NS = 100000;

typedef struct {
    int64_t at_ns;
    uint32_t bytes;
    uint8_t reply[8];
} queued;

static queued queue[QUEUE_MAX];
static uint32_t queue_count;
static int64_t busy_until_ns[UNITS_MAX]; /* a drive answers one request after the other */
static int64_t late_ns;
static uint32_t late_every; /* 1: each reply is late; n: one of n; 0: never */
static uint32_t lose_every;
static uint32_t harm_every; /* of n replies of a drive, the last one is harmed */
static uint32_t harm;       /* how */
static bool samples_late;   /* the drive is busy first, and then takes the value */
static bool turns_around_slowly;
static bool first_only; /* only the first drive has late or lost replies */
static uint32_t asked[UNITS_MAX];
static uint32_t published; /* samples of the first drive */
static int64_t last_sample_ns, last_stamp_ns, longest_pause_ns;

static uint32_t random_state;

static uint32_t random_below(uint32_t limit)
{
    random_state = random_state * 1664525U + 1013904223U;
    return (random_state >> 8) % limit;
}

static void begin_late(uint32_t drives, bool one_look, uint32_t seed)
{
    begin_with(drives, 0);
    for (uint32_t i = 0; i < drives; i++) {
        line_drive *drive = &w.table.drive[i];
        uint8_t unit = (uint8_t)(i + 1);
        drive->cyclic[1].field[0] = (line_field){
            .joint = i, .kind = FIELD_COUNT, .byte = 3, .form = FORM_U16, .si_per_raw = 1.0};
        if (one_look) {
            drive->cyclic[1].setpoint[0] = drive->cyclic[0].setpoint[0];
            drive->cyclic[1].setpoint_count = 1;
            drive->cyclic[0] = drive->cyclic[1];
            drive->cyclic[0].frame = frame_of(unit, READ, BOTH, 0);
            drive->cyclic_count = 1;
            drive->probe = 0;
        }
    }
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    memset(busy_until_ns, 0, sizeof busy_until_ns);
    queue_count = 0;
    random_state = seed;
    late_ns = 0;
    late_every = lose_every = harm_every = 0;
    samples_late = turns_around_slowly = first_only = false;
    published = 0;
    last_sample_ns = last_stamp_ns = longest_pause_ns = 0;
}

static void serve(const uint8_t *request)
{
    uint32_t number = request[0] - 1U;
    bool good = first_only && number > 0;
    bool late = !good && late_every > 0 && random_below(late_every) == 0;
    bool lost = !good && lose_every > 0 && random_below(lose_every) == 0;
    asked[number]++;
    bool harmed = harm_every > 0 && asked[number] % harm_every == 0;
    lost |= harmed && harm == LOST;
    late |= harmed && harm == LATE;
    int64_t begin_ns =
        w.machine.end_ns > busy_until_ns[number] ? w.machine.end_ns : busy_until_ns[number];
    int64_t ready_ns = begin_ns + (turns_around_slowly ? 4 * MS : DEVICE_NS) + (late ? late_ns : 0);
    uint32_t count = (uint32_t)((samples_late ? ready_ns : w.machine.end_ns) / TICK_NS);
    queued *to = &queue[queue_count];
    *to = (queued){.bytes = request[1] == READ ? 7 : 8};
    memcpy(to->reply, request, 8);
    if (request[1] == READ) {
        memcpy(to->reply,
               (const uint8_t[]){request[0], READ, 2, (uint8_t)(count >> 8), (uint8_t)count}, 5);
        rtu_seal(to->reply, 7, SEAL_CRC16);
    }
    to->reply[4] ^= harmed && harm == DAMAGED ? 0x10 : 0;
    to->at_ns = ready_ns + to->bytes * CHARACTER_NS;
    busy_until_ns[number] = to->at_ns;
    CHECK(queue_count < QUEUE_MAX - 1);
    queue_count += !lost;
}

/* Hands over the first reply of the queue that has arrived by now. */
static void receive(void)
{
    uint32_t first = 0;
    for (uint32_t i = 1; i < queue_count; i++) {
        first = queue[i].at_ns < queue[first].at_ns ? i : first;
    }
    if (queue_count > 0 && queue[first].at_ns <= w.now_ns) {
        memcpy(w.bytes, queue[first].reply, queue[first].bytes);
        w.count = queue[first].bytes;
        queue[first] = queue[--queue_count];
    }
}

static int64_t next_event_ns(int64_t wake_ns)
{
    for (uint32_t i = 0; i < queue_count; i++) {
        wake_ns = queue[i].at_ns < wake_ns ? queue[i].at_ns : wake_ns;
    }
    return wake_ns > w.now_ns ? wake_ns : w.now_ns + 1;
}

/* A value is older than its stamp by at most one cycle. If the drive takes it at once, the speed
 * between two samples is the true one. */
static void judge(void)
{
    if ((w.out.feedback_mask & 1) == 0 || w.machine.joint[0].feedback.stamp_ns == 0) {
        return;
    }
    const joint_feedback *now = &w.machine.joint[0].feedback;
    if (now->stamp_ns == last_stamp_ns) {
        return;
    }
    int64_t behind =
        (int16_t)(uint16_t)((uint32_t)(now->stamp_ns / TICK_NS) - (uint32_t)now->count);
    int64_t sample_ns = now->stamp_ns - behind * TICK_NS;
    CHECK(behind * TICK_NS <= 2 * MS);
    if (last_stamp_ns > 0) {
        int64_t pause_ns = now->stamp_ns - last_stamp_ns;
        double seen = (double)(sample_ns - last_sample_ns) / (double)pause_ns;
        CHECK(pause_ns > 0);
        CHECK(samples_late || turns_around_slowly || fabs(seen - 1.0) < 0.2);
        longest_pause_ns = pause_ns > longest_pause_ns ? pause_ns : longest_pause_ns;
    }
    last_stamp_ns = now->stamp_ns;
    last_sample_ns = sample_ns;
    published++;
}

static void look(void)
{
    w.machine.newest =
        (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = w.table.drive_count};
    for (uint32_t i = 0; i < w.table.drive_count; i++) {
        w.machine.newest.joint[i].velocity_rad_s = 1.0;
    }
    w.count = 0;
    receive();
    line_machine_step(&w.machine, w.now_ns, w.bytes, w.count, &w.out);
    judge();
    if (w.out.send != NULL) {
        line_machine_sent(&w.machine, w.now_ns);
        serve(w.out.send);
        w.now_ns = next_event_ns(w.machine.until_ns);
    } else {
        w.now_ns = next_event_ns(w.out.wake_ns);
    }
}

static void look_for(int64_t length_ns)
{
    for (int64_t end_ns = w.now_ns + length_ns; w.now_ns < end_ns;) {
        look();
    }
}

static void set_up_again_when_it_is_back(uint32_t number)
{
    uint32_t mode = w.machine.drive[number].state.mode;
    if (mode == DRIVE_OFF || mode == DRIVE_BACK) {
        last_stamp_ns = 0;
        request(number, DRIVE_READY);
    } else if (mode == DRIVE_READY && w.machine.drive[number].state.stop == STOP_NOTHING) {
        request(number, DRIVE_ARMED);
    }
}

static void run(uint32_t drives, int64_t length_ns)
{
    for (int64_t end_ns = w.now_ns + length_ns; w.now_ns < end_ns;) {
        look_for(20 * MS);
        for (uint32_t i = 0; i < drives; i++) {
            set_up_again_when_it_is_back(i);
        }
    }
}

static void no_value_is_older_than_its_stamp(bool one_look)
{
    for (uint32_t every = 1; every <= 40; every += every < 4 ? 1 : 12) {
        for (int64_t ms = 5; ms <= 100; ms += 5) {
            for (uint32_t busy = 0; busy < 2; busy++) {
                begin_late(2, one_look, (uint32_t)ms * every);
                run(2, 200 * MS);
                late_ns = ms * MS;
                late_every = every;
                samples_late = busy != 0;
                run(2, 3000 * MS);
                late_every = 0;
                published = 0;
                run(2, 4000 * MS);     /* an unresponsive drive is probed every two seconds */
                CHECK(published > 90); /* after that it works again */
            }
        }
    }
}

static void a_late_reply_is_distinguished_from_noise(void)
{
    begin_late(1, false, 1);
    run(1, 500 * MS);
    late_ns = 40 * MS;
    late_every = 20;
    run(1, 4000 * MS);
    CHECK(w.machine.drive[0].count.late > 0 && w.machine.noise_bytes == 0);
}

/* Other drives continue while a late reply of one drive may still arrive. */
static void a_late_drive_does_not_keep_its_neighbour_waiting(bool one_look)
{
    begin_late(2, one_look, 3);
    run(2, 500 * MS);
    uint64_t before = w.machine.drive[1].count.cycles;
    run(2, 2000 * MS);
    uint64_t healthy = w.machine.drive[1].count.cycles - before;
    w.machine.table.drive[0].tries = 1000;
    first_only = true;
    for (uint32_t i = 0; i < 2; i++) {
        lose_every = i == 0 ? 0 : 10;
        late_every = i == 0 ? 10 : 0;
        late_ns = 60 * MS;
        before = w.machine.drive[1].count.cycles;
        run(2, 2000 * MS);
        CHECK(w.machine.drive[1].count.cycles - before >= healthy * 9 / 10);
    }
}

/* A drive that is written in one frame and read in another loses only the reply, without a
 * pause. */
static void a_lost_reply_costs_a_drive_with_two_frames_no_pause(void)
{
    begin_late(1, false, 5);
    run(1, 500 * MS);
    lose_every = 50;
    longest_pause_ns = 0;
    run(1, 10000 * MS);
    CHECK(published > 400 && longest_pause_ns <= 90 * MS);
}

static void a_lost_reply_costs_a_drive_with_one_frame_a_short_pause(void)
{
    begin_late(1, true, 5);
    run(1, 500 * MS);
    lose_every = 50;
    longest_pause_ns = 0;
    run(1, 10000 * MS);
    CHECK(published > 200 && longest_pause_ns <= 400 * MS);
}

/* The default age at which feedback is stale is 250 ms: one harmed reply of fifty is far from it.
 * `late_after_ns`: by how much replies may be late on the medium: less on a UART than where a
 * program passes the bytes on. */
static void one_harmed_reply_of_fifty_leaves_feedback_fresh(int64_t late_after_ns,
                                                            int64_t pause_max_ns)
{
    for (uint32_t drives = 1; drives <= 2; drives++) {
        for (uint32_t how = LOST; how <= LATE; how++) {
            for (uint32_t one_look = 0; one_look < 2; one_look++) {
                begin_late(drives, one_look != 0, 5);
                w.machine.table.late_ns = late_after_ns;
                run(drives, 500 * MS);
                harm = how;
                harm_every = 50;
                late_ns = 15 * MS;
                longest_pause_ns = 0;
                run(drives, 10000 * MS);
                CHECK(published > 300 && longest_pause_ns <= pause_max_ns);
                CHECK(w.machine.drive[0].count.unresponsive == 0);
            }
        }
    }
}

/* The reply is so late that it is not awaited any more: it arrives right after the next request,
 * sooner than the drive can answer. */
static void a_reply_that_comes_sooner_than_the_drive_can_answer_is_not_its_answer(void)
{
    begin_late(1, true, 7);
    turns_around_slowly = true;
    run(1, 1000 * MS);
    for (uint32_t seed = 0; seed < 40; seed++) {
        lose_every = 1;
        while (w.machine.drive[0].failures == 0) {
            look();
        }
        lose_every = 0;
        int64_t failed_ns = w.now_ns;
        uint32_t before = asked[0];
        /* until the pause is over and a request is on the wire */
        while (asked[0] < before + 2 || w.machine.work == WORK_NONE) {
            look();
        }
        CHECK(w.now_ns > failed_ns);
        uint8_t old[7] = {1, READ, 2, 0x12, 0x34};
        rtu_seal(old, 7, SEAL_CRC16);
        last_stamp_ns = 0;
        line_machine_step(&w.machine, w.machine.end_ns + 7 * CHARACTER_NS, old, 7, &w.out);
        CHECK(w.machine.joint[0].feedback.count != 0x1234);
        run(1, 1000 * MS);
        CHECK(w.machine.drive[0].state.mode == DRIVE_ARMED);
    }
}

static void a_drive_that_is_always_too_late_is_unresponsive(void)
{
    for (int64_t ms = 30; ms <= 100; ms += 10) {
        begin_late(1, false, 1);
        run(1, 500 * MS);
        late_ns = ms * MS;
        late_every = 1;
        run(1, 2000 * MS);
        CHECK(w.machine.drive[0].count.unresponsive > 0);
    }
}

/* On a pseudo-terminal, bytes take no time. */
static void replies_quicker_than_the_wire_count_also_after_a_lost_one(void)
{
    begin_late(1, false, 1);
    w.table.character_ns = (double)MS;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    for (uint32_t i = 0; i < 200; i++) {
        set_up_again_when_it_is_back(0);
        w.machine.newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = 1};
        line_machine_step(&w.machine, w.now_ns, w.bytes, w.count, &w.out);
        w.count = 0;
        w.now_ns = w.out.wake_ns > w.now_ns ? w.out.wake_ns : w.now_ns;
        if (w.out.send == NULL) {
            continue;
        }
        line_machine_sent(&w.machine, w.now_ns);
        if (i == 60 || i == 61) {
            w.now_ns = w.machine.until_ns;
            continue;
        }
        memcpy(w.bytes, w.out.send, 8);
        w.count = 8;
        if (w.bytes[1] == READ) {
            memcpy(w.bytes, (const uint8_t[]){1, READ, 2, 0, 7}, 5);
            rtu_seal(w.bytes, 7, SEAL_CRC16);
            w.count = 7;
        }
        w.now_ns += MS / 10;
    }
    CHECK(w.machine.drive[0].count.unresponsive == 0 && w.machine.drive[0].failures == 0);
    CHECK(w.machine.drive[0].count.no_reply >= 1 && w.machine.drive[0].count.cycles > 40);
}

static line_request read_of(uint64_t id, uint8_t address)
{
    return (line_request){.id = id,
                          .expires_ns = w.now_ns + 1000 * MS,
                          .turnaround_ns = 5 * MS,
                          .frame = frame_of(1, READ, address, 1)};
}

/* Replies to reads of two registers look alike. A late one to the first read is not taken as the
 * answer to the second. */
static void a_late_reply_to_one_read_is_not_the_answer_to_another(void)
{
    for (int64_t ms = 30; ms <= 100; ms += 5) {
        begin_late(1, false, 1);
        line_request first = read_of(1, STATUS), second = read_of(2, BOTH);
        late_ns = ms * MS;
        late_every = 1;
        CHECK(line_machine_request(&w.machine, &first) &&
              line_machine_request(&w.machine, &second));
        while (!w.machine.answered) {
            look();
        }
        CHECK(w.machine.answer.id == 1 && w.machine.answer.kind == ANSWER_NO_REPLY);
        late_every = 0;
        int64_t asked_ns = w.now_ns;
        do {
            look();
        } while (!w.machine.answered);
        CHECK(w.machine.answer.id == 2 && w.machine.answer.kind == ANSWER_OK && asked[0] > 0);
        uint32_t count = (uint32_t)rtu_read(w.machine.answer.reply + 3, FORM_U16);
        CHECK((uint16_t)((uint32_t)(asked_ns / TICK_NS) - 1U - count) > 0x8000);
    }
}

/* A late acknowledgement of an older stop does not prove that the newer one was received. */
static void the_late_acknowledgement_of_an_older_stop_does_not_stand_for_a_newer_one(void)
{
    begin_late(1, false, 1);
    line_request off = {.id = 1,
                        .expires_ns = INT64_MAX,
                        .turnaround_ns = 5 * MS,
                        .urgent = 1,
                        .frame = frame_of(1, WRITE, CONTROL, DISABLE)};
    line_request on = off;
    on.id = 2;
    on.frame = frame_of(1, WRITE, CONTROL, 8);
    lose_every = 1;
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(line_machine_request(&w.machine, i == 0 ? &off : &on));
        do {
            look();
        } while (!w.machine.answered);
    }
    off.id = 3;
    CHECK(line_machine_request(&w.machine, &off));
    while (w.machine.work != WORK_REQUEST) {
        look();
    }
    line_machine_step(&w.machine, w.machine.end_ns + 2 * MS, off.frame.request, 8, &w.out);
    CHECK(!w.machine.answered || w.machine.answer.kind != ANSWER_OK);
}

/* The time of the first reply after a set-up may be unknown. Then no value has been read. */
static void a_value_that_was_never_read_has_no_stamp(void)
{
    line_joint_state *joint = &w.machine.joint[0];
    for (uint32_t reads = 0; reads < 3; reads++) { /* the drive has a count, a velocity, or
                                                      neither */
        begin_late(1, false, 1);
        joint->counts = reads == 0;
        joint->measures = reads == 1;
        line_forget(&w.machine, 0);
        w.machine.drive[0].answered_ns = w.now_ns;
        line_publish(&w.machine, 0);
        CHECK(joint->feedback.stamp_ns == (reads == 2 ? w.now_ns : 0));
    }
}

static void a_stuffed_reply_is_read_without_what_stuffing_has_added(void)
{
    static const uint8_t VALUE[] = {0xFF, 0xFF, 0xFD, 1};
    line_frame status = {.request_seal = SEAL_STUFFED,
                         .request_bytes = 15,
                         .request = {0xFF, 0xFF, 0xFD, 0, 7, 8, 0, 0x55, 0, 0xFF, 0xFF, 0xFD, 1}};
    rtu_finish(&status);
    CHECK(status.request_bytes == 16);
    line_machine *machine = &w.machine;
    begin_with(1, 0);
    memcpy(machine->transaction.received + 3, status.request, status.request_bytes);
    const received whole = {.kind = RECEIVED_ANSWER, .offset = 3, .bytes = status.request_bytes},
                   none = {.offset = 3};
    machine->transaction.frame.reply_seal = SEAL_STUFFED;
    CHECK(line_reply(machine, &whole) == machine->transaction.plain);
    CHECK(memcmp(machine->transaction.plain + 9, VALUE, sizeof VALUE) == 0);
    CHECK(line_reply(machine, &none) == machine->transaction.received + 3);
    machine->transaction.frame.reply_seal = SEAL_CRC16;
    CHECK(line_reply(machine, &whole) == machine->transaction.received + 3);
}

int main(void)
{
    a_stuffed_reply_is_read_without_what_stuffing_has_added();
    no_value_is_older_than_its_stamp(false);
    no_value_is_older_than_its_stamp(true);
    a_late_reply_is_distinguished_from_noise();
    a_late_drive_does_not_keep_its_neighbour_waiting(false);
    a_late_drive_does_not_keep_its_neighbour_waiting(true);
    a_lost_reply_costs_a_drive_with_two_frames_no_pause();
    one_harmed_reply_of_fifty_leaves_feedback_fresh(120 * MS, 200 * MS);
    one_harmed_reply_of_fifty_leaves_feedback_fresh(20 * MS, 130 * MS);
    a_lost_reply_costs_a_drive_with_one_frame_a_short_pause();
    a_reply_that_comes_sooner_than_the_drive_can_answer_is_not_its_answer();
    a_drive_that_is_always_too_late_is_unresponsive();
    replies_quicker_than_the_wire_count_also_after_a_lost_one();
    a_late_reply_to_one_read_is_not_the_answer_to_another();
    the_late_acknowledgement_of_an_older_stop_does_not_stand_for_a_newer_one();
    a_value_that_was_never_read_has_no_stamp();
    return checks_report("line late");
}
