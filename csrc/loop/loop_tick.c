/* SPDX-License-Identifier: Apache-2.0
 * loop_tick.c: one tick: takes the newest inputs, runs the core, hands its results on. */
#include <errno.h>
#include <math.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "fresh.h"
#include "loop.h"
#include "schedule.h"

enum { PAGE_FAULT_EVERY_TICKS = 256, REHEARSAL_TICKS = 16 };

/* Longest time for which the clock may stand still; a longer one is a fault. */
static const int64_t STILL_MAX_NS = 100000000;

int loop_work_init(loop_work *work, const loop_config *loop, const core_config *core)
{
    int error = core_init(&work->core, core);
    if (error != 0) {
        return error;
    }
    error = page_init(work->page);
    if (error != 0) {
        return error;
    }
    exchange_init(&work->exchange);
    for (uint32_t kind = 0; kind < HISTOGRAM_KINDS; kind++) {
        histogram_clear(&work->histogram[kind]);
    }
    memset(&work->input, 0, sizeof work->input);
    memset(&work->out, 0, sizeof work->out);
    memset(&work->notified, 0, sizeof work->notified);
    work->event_fd = loop->event_fd;
    work->notify_every_ticks = loop->notify_every_ticks;
    work->period_ns = schedule_period_ns(loop->rate_hz);
    work->ingress = (ingress){.epoll_fd = loop->command_fd, .stop_fd = loop->stop_fd};
    memset(&work->stops, 0, sizeof work->stops);
    work->disarmed = false;
    work->stop_arrived = false;
    guard_init(&work->guard, &loop->guard);
    late_init(&work->late, loop->late_from_ns);
    arbiter_init(&work->arbiter, &work->core.config, &work->core.limits);
    work->used_stamp_ns = 0;
    work->stopping = true;
    work->armed = false;
    work->woken = false;
    work->last_ns = 0;
    work->still_ns = 0;
    work->resumed_ns = clock_resumed_ns();
    work->page_fault_base = 0;
    work->clear_histograms = false;
    work->ticks = 0;
    work->overruns = 0;
    work->page_faults = 0;
    work->tick_stamp_ns = 0;
    return 0;
}

void loop_rehearse(loop_work *work, core_state *scratch)
{
    const core_config *config = &work->core.config;
    core_input input;
    memset(&input, 0, sizeof input);
    (void)core_init(scratch, config);
    input.control.limits = config->limits;
    for (uint32_t i = 1; i <= REHEARSAL_TICKS; i++) {
        input.now_ns = (int64_t)i * work->period_ns;
        input.control.heartbeat_ns = input.now_ns;
        input.control.armed = i > 2;
        input.command.stamp_ns = input.now_ns;
        input.command.expires_ns = input.now_ns + work->period_ns;
        input.command.linear_m_s = i > 4 ? 0.1 : 0.0;
        input.command.angular_rad_s = i > 4 ? 0.1 : 0.0;
        input.command.lateral_m_s = i > 4 && kinematics_strafes(config) ? 0.1 : 0.0;
        input.joints = (joint_command){.named = i > 4 ? (1U << config->joint_count) - 1U : 0};
        for (uint32_t joint = 0; joint < config->joint_count; joint++) {
            input.feedback[joint] = (joint_feedback){.stamp_ns = input.now_ns,
                                                     .count = i,
                                                     .velocity_rad_s = 0.1,
                                                     .current_a = NAN,
                                                     .voltage_v = NAN,
                                                     .temperature_c = NAN,
                                                     .enabled = 1};
        }
        input.imu = (imu_sample){.stamp_ns = input.now_ns, .angular_rad_s = {0.0, 0.0, 0.1}};
        core_step(scratch, &input, (double)work->period_ns * 1e-9, &work->out, NULL);
    }
    memset(&work->out, 0, sizeof work->out);
}

/* Count the page faults since the first tick. This is a system call, so it is not made in every
 * tick. */
static void count_page_faults(loop_work *work)
{
    struct rusage usage;
    if (getrusage(RUSAGE_THREAD, &usage) != 0) {
        return;
    }
    long faults = usage.ru_minflt + usage.ru_majflt;
    if (work->ticks == 1) {
        work->page_fault_base = faults;
    }
    work->page_faults = (uint64_t)(faults - work->page_fault_base);
}

static void clear_histograms_on_request(loop_work *work)
{
    if (!work->clear_histograms) {
        return;
    }
    work->clear_histograms = false;
    for (uint32_t kind = 0; kind < HISTOGRAM_KINDS; kind++) {
        histogram_clear(&work->histogram[kind]);
    }
}

/* Whether sources may request motion. A source that does so before the core is armed, or during a
 * stop, must not move the robot when that changes. */
static bool may_move(const loop_work *work)
{
    const core_control *control = &work->input.control;
    return control->armed != 0 && work->core.armed != 0 && work->core.faults == 0 &&
           control->stop == 0 && control->estop == 0 && control->fault == 0;
}

static void take_commands(loop_work *work, int64_t now_ns)
{
    bool granted = exchange_take_permissions(&work->exchange, &work->permissions) == 1;
    if (granted) {
        arbiter_grant(&work->arbiter, &work->permissions);
    }
    uint32_t before = work->arbiter.report.commander;
    bool could_move = work->arbiter.report.may_move != 0;
    if (work->core.armed != 0 && !work->armed) {
        arbiter_arm(&work->arbiter, now_ns);
    }
    work->armed = work->core.armed != 0;
    uint32_t taken = ingress_take(&work->ingress, &work->arbiter, may_move(work));
    arbiter_command(&work->arbiter, now_ns, may_move(work), &work->input.command);
    if (work->core.config.independent) {
        arbiter_joints(&work->arbiter, &work->input.joints);
    }
    const command_report *report = &work->arbiter.report;
    work->input.control.owner = report->commander;
    if (granted || taken > 0 || report->commander != before ||
        (report->may_move != 0) != could_move) {
        exchange_put_commands(&work->exchange, report);
    }
    int64_t stamp_ns = work->input.command.stamp_ns;
    if (stamp_ns != work->used_stamp_ns && stamp_ns > 0) {
        work->used_stamp_ns = stamp_ns;
        histogram_add(&work->histogram[HISTOGRAM_COMMAND], now_ns - stamp_ns);
    }
}

/* Take the control, and add the stop requests that asyncio has not acknowledged to its levels. The
 * acknowledgements are read before the levels: asyncio puts levels that hold the request, then
 * acknowledges, so every tick between the two has the request. */
static void take_control(loop_work *work)
{
    core_control *control = &work->input.control;
    uint64_t acknowledged[STOP_REQUEST_KINDS];
    bool pending[STOP_REQUEST_KINDS];
    for (uint32_t kind = 0; kind < STOP_REQUEST_KINDS; kind++) {
        acknowledged[kind] = work->stops.acknowledged[kind];
    }
    exchange_take_control(&work->exchange, control);
    work->stop_arrived = ingress_take_stops(&work->ingress, &work->stops) > 0;
    for (uint32_t kind = 0; kind < STOP_REQUEST_KINDS; kind++) {
        pending[kind] = work->stops.count[kind] != acknowledged[kind];
    }
    control->estop |= pending[STOP_REQUEST_ESTOP];
    control->estop |= guard_read_estop(&work->guard);
    control->release |= pending[STOP_REQUEST_DISARM];
    control->stop |= pending[STOP_REQUEST_STOP] || pending[STOP_REQUEST_DISARM];
    work->disarmed = pending[STOP_REQUEST_DISARM] &&
                     (work->disarmed || core_may_power_off(&work->core, work->input.now_ns));
    control->armed = work->disarmed ? 0 : control->armed;
}

/* Look for a suspend of the computer, and return its end: earlier stamps are from before it. */
static int64_t look_for_suspend(loop_work *work)
{
    int64_t resumed_ns = clock_resumed_ns();
    work->input.suspended = resumed_ns != work->resumed_ns;
    if (work->input.suspended != 0) {
        work->resumed_ns = resumed_ns;
        arbiter_resume(&work->arbiter, resumed_ns);
    }
    return resumed_ns;
}

static void take_inputs(loop_work *work, int64_t now_ns)
{
    core_input *input = &work->input;
    int64_t resumed_ns = look_for_suspend(work);
    input->now_ns = now_ns;
    take_control(work);
    input->control.heartbeat_ns = stamp_since(input->control.heartbeat_ns, resumed_ns);
    take_commands(work, now_ns);
    for (uint32_t joint = 0; joint < work->core.config.joint_count; joint++) {
        joint_feedback *feedback = &input->feedback[joint];
        exchange_take_feedback(&work->exchange, joint, feedback);
        feedback->stamp_ns = stamp_since(feedback->stamp_ns, resumed_ns);
    }
    exchange_take_imu(&work->exchange, &input->imu);
    input->imu.stamp_ns = stamp_since(input->imu.stamp_ns, resumed_ns);
}

/* Whether asyncio is to be notified: the reasons to stand count, not the reasons for a lower speed,
 * which a ramp changes in every other tick. */
static bool worth_a_word(const robot_state *now, const robot_state *before)
{
    uint32_t other_reasons = (now->reasons ^ before->reasons) & REASONS_TO_STAND;
    return other_reasons != 0 || now->faults != before->faults || now->armed != before->armed ||
           now->rest.rest != before->rest.rest;
}

static void notify(loop_work *work, bool always)
{
    const robot_state *now = &work->core.snapshot;
    bool due = work->notify_every_ticks != 0 && work->ticks % work->notify_every_ticks == 0;
    if (work->event_fd < 0 || !(always || due || worth_a_word(now, &work->notified))) {
        return;
    }
    const uint64_t one = 1;
    work->notified = *now;
    /* Full means that the reader was woken 2^64 - 2 times and has not read yet: it will. */
    if (write(work->event_fd, &one, sizeof one) < 0) {
        return;
    }
}

static void hand_on(loop_work *work)
{
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        exchange_put_setpoints(&work->exchange, line, &work->out);
    }
    page_write(work->page, &work->core.snapshot);
    if (work->shared_page != NULL) {
        page_write(work->shared_page, &work->core.snapshot);
    }
}

static bool moves_nothing(const setpoints *out)
{
    bool moves = false;
    for (uint32_t joint = 0; joint < out->joint_count; joint++) {
        moves |= out->joint[joint].velocity_rad_s != 0.0 || out->joint[joint].duty != 0.0;
    }
    return out->enabled == 0 || !moves;
}

static void wake_lines(const loop_work *work)
{
    const uint64_t one = 1;
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        int fd = exchange_line_wake(&work->exchange, line);
        if (fd >= 0 && write(fd, &one, sizeof one) < 0) {
            continue; /* full: the thread is awake already */
        }
    }
}

static bool same_command(const twist_command *one, const twist_command *other)
{
    return one->stamp_ns == other->stamp_ns && one->expires_ns == other->expires_ns &&
           one->linear_m_s == other->linear_m_s && one->angular_rad_s == other->angular_rad_s &&
           one->lateral_m_s == other->lateral_m_s;
}

/* Whether to compute nothing until the clock moves: a coarse clock shows the same time twice. */
static bool clock_may_stand_still(loop_work *work, int64_t now_ns)
{
    bool still = work->last_ns != 0 && now_ns == work->last_ns;
    work->still_ns = still ? work->still_ns + work->period_ns : 0;
    return still && work->still_ns <= STILL_MAX_NS;
}

static void work_once(loop_work *work, int64_t now_ns)
{
    if (clock_may_stand_still(work, now_ns)) {
        return;
    }
    twist_command before = work->input.command;
    clear_histograms_on_request(work);
    take_inputs(work, now_ns);
    late_mark(&work->late, STAGE_INPUT);
    int64_t dt_ns = work->last_ns == 0 ? work->period_ns : now_ns - work->last_ns;
    double dt_s = (double)dt_ns * 1e-9;
    if (work->journal != NULL) {
        journal_before(work->journal, &work->core);
    }
    core_step(&work->core, &work->input, dt_s, &work->out, NULL);
    late_mark(&work->late, STAGE_CORE);
    hand_on(work);
    if (work->journal != NULL) {
        journal_after(work->journal, &work->input, dt_s, &work->out, &work->core.snapshot);
    }
    late_mark(&work->late, STAGE_OUTPUT);
    bool stopping = moves_nothing(&work->out);
    bool new_command = !same_command(&work->input.command, &before);
    /* A new command, or a stop, does not wait for a line's next turn. The first step of a ramp may
     * be too small for a drive's numbers, so the next tick wakes the lines again. A refused command
     * wakes no line. */
    if (new_command || work->woken || (stopping && !work->stopping)) {
        wake_lines(work);
    }
    work->woken = new_command;
    work->stopping = stopping;
    work->last_ns = now_ns;
    work->ticks++;
    work->tick_stamp_ns = now_ns;
    notify(work, work->ticks == 1 || work->stop_arrived);
}

/* Step the watchdog once a period, so that its pin changes at an even rate. */
static void drive_watchdog(loop_work *work, int64_t now_ns)
{
    watchdog_input input = {
        .now_ns = now_ns,
        .heartbeat_ns = work->input.control.heartbeat_ns,
        .enabled = work->out.enabled != 0,
    };
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        input.takes[line] = exchange_line_takes(&work->exchange, line);
    }
    guard_drive_watchdog(&work->guard, &input);
}

void loop_tick(loop_work *work, int64_t now_ns, int64_t deadline_ns)
{
    late_begin(&work->late, now_ns, deadline_ns);
    work_once(work, now_ns);
    drive_watchdog(work, now_ns);
    histogram_add(&work->histogram[HISTOGRAM_LATENESS], now_ns - deadline_ns);
    if (work->ticks == 1 || work->ticks % PAGE_FAULT_EVERY_TICKS == 0) {
        count_page_faults(work);
    }
    late_mark(&work->late, STAGE_NOTIFY);
    late_end(&work->late);
    histogram_add(&work->histogram[HISTOGRAM_STEP], clock_now_ns() - now_ns);
}

void loop_extra_tick(loop_work *work, int64_t now_ns)
{
    work_once(work, now_ns);
}

void loop_rest(loop_work *work, int64_t now_ns)
{
    robot_state *last = &work->core.snapshot;
    memset(&work->out, 0, sizeof work->out);
    work->out.stamp_ns = now_ns;
    work->out.tick = ++last->tick;
    work->out.joint_count = work->core.config.joint_count;
    last->stamp_ns = now_ns;
    last->armed = 0;
    last->enabled = 0;
    last->reasons |= REASON_NOT_ARMED;
    last->setpoint_linear_m_s = 0;
    last->setpoint_angular_rad_s = 0;
    last->lateral.setpoint_lateral_m_s = 0;
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        last->joint[joint].setpoint_rad_s = 0;
        last->joint[joint].duty = 0;
    }
    hand_on(work);
    guard_rest(&work->guard);
    notify(work, true);
    count_page_faults(work);
}
