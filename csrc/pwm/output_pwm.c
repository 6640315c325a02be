/* SPDX-License-Identifier: Apache-2.0
 * output_pwm.c: the thread of a line of motor bridges: descriptors, deadlines, order of writes.
 * bridge.c computes the levels. Sources: kernel, Documentation/driver-api/pwm.rst (sysfs) and
 * include/uapi/linux/gpio.h (v2). */
#include <errno.h>
#include <linux/gpio.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

#include "fresh.h"
#include "loop.h"

enum { EPOCH_BITS = 16 }; /* for the encoder's own epochs, below those of openings */
static const int64_t NS_PER_S = 1000000000;
static const int64_t REPORT_EVERY_NS = 40 * 1000000, GAP_NS = 1000000;
static const int32_t AT_GPIO = -1, AT_ENCODER = -2;

typedef struct {
    mailbox mailbox;
    bridge_control slot[MAILBOX_SLOTS];
} pwm_control_mailbox;

typedef struct {
    mailbox mailbox;
    bridge_report slot[MAILBOX_SLOTS];
} pwm_report_mailbox;

typedef struct {
    mailbox mailbox;
    encoder_sample slot[MAILBOX_SLOTS];
} sample_mailbox;

typedef struct {
    bridge_config config;
    loop_grant grant;
    pthread_t thread;
    exchange *exchange;
    pwm_control_mailbox control;
    pwm_report_mailbox report;
    sample_mailbox reported[JOINTS_MAX];
    bridge_control request;
    bridge_state state;
    setpoints newest;
    bridge_report out;
    encoder_state encoder[JOINTS_MAX];
    uint64_t duty_ns[PWM_OUTPUTS_MAX];
    bool known[PWM_OUTPUTS_MAX]; /* the file contains duty_ns */
    uint64_t bits;
    bool bits_known;
    int64_t reported_ns;
    uint32_t number;
    int wake_fd; /* static: the loop may write to it at any time, so it is never closed */
    bool has_wake_fd, made, joinable;
    _Atomic bool stop_requested;
} pwm_thread;

static pwm_thread threads[LINES_MAX];

static void wake(const pwm_thread *t)
{
    const uint64_t one = 1;
    if (write(t->wake_fd, &one, sizeof one) < 0) {
        return; /* full: the thread is woken already */
    }
}

/* ----------------------------------------------------------------------------- the pins */
static int write_number(int fd, uint64_t value)
{
    char text[24];
    size_t at = sizeof text;
    text[--at] = '\n';
    do {
        text[--at] = (char)('0' + value % 10);
        value /= 10;
    } while (value != 0);
    ssize_t size = (ssize_t)(sizeof text - at);
    ssize_t wrote = pwrite(fd, text + at, (size_t)size, 0);
    return wrote == size ? 0 : wrote < 0 ? -errno : -EIO;
}

static int write_duty(pwm_thread *t, uint32_t i, uint64_t duty_ns)
{
    if (t->known[i] && t->duty_ns[i] == duty_ns) {
        return 0;
    }
    int error = write_number(t->config.output[i].fd, duty_ns);
    t->known[i] = error == 0;
    t->duty_ns[i] = duty_ns;
    t->out.writes++;
    t->out.error_output = error != 0 ? (int32_t)i : t->out.error_output;
    return error;
}

static int write_bits(pwm_thread *t, uint64_t bits, uint64_t mask)
{
    if (mask == 0 || (t->bits_known && bits == t->bits)) {
        return 0;
    }
    struct gpio_v2_line_values values = {.bits = bits, .mask = mask};
    int error =
        ioctl(t->config.outputs_fd, GPIO_V2_LINE_SET_VALUES_IOCTL, &values) == 0 ? 0 : -errno;
    t->bits_known = error == 0;
    t->bits = bits;
    t->out.writes++;
    t->out.error_output = error != 0 ? AT_GPIO : t->out.error_output;
    return error;
}

static void wanted_bits(const pwm_thread *t, const double *level, uint64_t *bits, uint64_t *mask)
{
    *bits = *mask = 0;
    for (uint32_t i = 0; i < t->config.output_count; i++) {
        const bridge_pin *output = &t->config.output[i];
        if (output->fd < 0) {
            bool high = (level[i] >= 0.5) != (output->inverted != 0);
            *mask |= 1ull << output->bit;
            *bits |= (uint64_t)high << output->bit;
        }
    }
}

/* Whether a joint's GPIO lines change: then its channels rest, or the old duty would act in the new
 * direction. */
static bool turns(const pwm_thread *t, uint32_t joint, uint64_t bits)
{
    for (uint32_t i = 0; i < t->config.output_count; i++) {
        const bridge_pin *output = &t->config.output[i];
        bool is_direction = output->joint == joint && output->fd < 0 && output->pumps == 0;
        if (is_direction && ((bits ^ t->bits) >> output->bit & 1) != 0) {
            return true;
        }
    }
    return false;
}

/* Bring to rest the channels that rest in this cycle, or whose joint's lines are about to change.
 * All are tried. Returns the first error. */
static int bring_down(pwm_thread *t, const double *level, uint64_t bits, uint64_t mask)
{
    int first = 0;
    for (uint32_t i = 0; i < t->config.output_count; i++) {
        const bridge_pin *output = &t->config.output[i];
        if (output->fd >= 0) {
            double low = output->base[BRIDGE_COAST];
            bool resting = mask != 0 && (!t->bits_known || turns(t, output->joint, bits));
            int error =
                resting || level[i] == low ? write_duty(t, i, bridge_duty_ns(output, low)) : 0;
            first = first != 0 ? first : error;
        }
    }
    return first;
}

/* Write falling duties first, then the lines, then rising duties. No step follows a failed one: a
 * duty that could not be lowered would act in the new direction. */
static int apply(pwm_thread *t, const double *level)
{
    uint64_t bits, mask;
    wanted_bits(t, level, &bits, &mask);
    int error = bring_down(t, level, bits, mask);
    error = error != 0 ? error : write_bits(t, bits, mask);
    for (uint32_t i = 0; i < t->config.output_count && error == 0; i++) {
        if (t->config.output[i].fd >= 0) {
            error = write_duty(t, i, bridge_duty_ns(&t->config.output[i], level[i]));
        }
    }
    return error;
}

static bool is_high(const bridge_pin *output, uint32_t mode)
{
    return output->base[mode] >= 0.5;
}

/* Return the GPIO lines of a joint whose levels at COAST are those of a direction (PWM and DIR):
 * they do not remove power; only the duty does. */
static uint64_t lines_without_power(const pwm_thread *t, uint32_t joint)
{
    uint64_t bits = 0;
    bool as_forward = true, as_reverse = true;
    for (uint32_t i = 0; i < t->config.output_count; i++) {
        const bridge_pin *output = &t->config.output[i];
        if (output->joint == joint && output->fd < 0 && output->pumps == 0) {
            bool coasts = is_high(output, BRIDGE_COAST);
            as_forward = as_forward && coasts == is_high(output, BRIDGE_FORWARD);
            as_reverse = as_reverse && coasts == is_high(output, BRIDGE_REVERSE);
            bits |= 1ull << output->bit;
        }
    }
    return as_forward || as_reverse ? bits : 0;
}

/* Set COAST everywhere, even if a write fails. If a duty cannot be lowered, lines that only set the
 * direction stay as they are. */
static int rest(pwm_thread *t)
{
    double level[PWM_OUTPUTS_MAX] = {0};
    uint64_t bits, mask;
    for (uint32_t i = 0; i < t->config.output_count; i++) {
        level[i] = t->config.output[i].base[BRIDGE_COAST];
        t->known[i] = false;
    }
    t->bits_known = false;
    wanted_bits(t, level, &bits, &mask);
    int error = bring_down(t, level, bits, mask);
    for (uint32_t i = 0; i < t->config.output_count; i++) {
        const bridge_pin *output = &t->config.output[i];
        mask &=
            output->fd >= 0 && !t->known[i] ? ~lines_without_power(t, output->joint) : UINT64_MAX;
    }
    int lines_error = write_bits(t, bits, mask);
    int left = bring_down(t, level, bits, mask); /* repeats the failed writes */
    t->out.rest_output = left != 0 ? t->out.error_output : AT_GPIO;
    t->out.rest_error = left != 0 ? -left : -lines_error;
    return error != 0 ? error : lines_error;
}

static int read_inputs(pwm_thread *t)
{
    struct gpio_v2_line_values values = {.mask = 0};
    if (t->config.inputs_fd < 0) {
        return 0;
    }
    for (uint32_t i = 0; i < t->config.joint_count; i++) {
        values.mask |= t->config.joint[i].fault_mask;
    }
    if (ioctl(t->config.inputs_fd, GPIO_V2_LINE_GET_VALUES_IOCTL, &values) != 0) {
        t->out.error_output = AT_GPIO;
        return -errno;
    }
    t->out.active_inputs = (values.bits ^ t->config.low_inputs) & values.mask;
    return 0;
}

static int read_encoders(pwm_thread *t, int64_t now_ns)
{
    uint64_t illegal = 0, lost = 0;
    for (uint32_t i = 0; i < t->config.joint_count; i++) {
        encoder_sample sample;
        if (mailbox_take(&t->reported[i].mailbox, t->reported[i].slot, &sample, sizeof sample) !=
            0) {
            encoder_reported(&t->encoder[i], &t->config.joint[i].encoder, &sample);
        }
        int error = encoder_read(&t->encoder[i], &t->config.joint[i].encoder, now_ns);
        if (error != 0) {
            t->out.error_output = AT_ENCODER - (int32_t)i;
            return error;
        }
        illegal += t->encoder[i].illegal;
        lost += t->encoder[i].lost;
    }
    t->out.encoder_illegal = illegal;
    t->out.encoder_lost = lost;
    return 0;
}

/* ------------------------------------------------------------------------ the hand-over */
static void feed_back(pwm_thread *t, int64_t now_ns)
{
    for (uint32_t i = 0; i < t->config.joint_count; i++) {
        const encoder_config *encoder = &t->config.joint[i].encoder;
        bool counts = encoder->kind != ENCODER_NONE, reported = encoder->kind == ENCODER_REPORTED;
        /* the feedback of a silent board gets old */
        const int64_t at_ns = reported ? t->encoder[i].reported_ns : now_ns;
        joint_feedback feedback = {
            .stamp_ns = at_ns,
            .count = (uint64_t)t->encoder[i].count,
            .velocity_rad_s =
                counts ? encoder_velocity_rad_s(&t->encoder[i], encoder, at_ns) : (double)NAN,
            .current_a = NAN,
            .voltage_v = NAN,
            .temperature_c = NAN,
            .epoch = (t->config.epoch << EPOCH_BITS) + t->encoder[i].epoch,
            .enabled = 2,
            .drive_faults = (t->out.active_inputs & t->config.joint[i].fault_mask) != 0,
        };
        if (at_ns != 0) {
            (void)exchange_put_feedback(t->exchange, t->config.joint[i].index, &feedback);
        }
    }
}

static void put_report(pwm_thread *t, bool running, int error, int64_t now_ns,
                       uint64_t inputs_before)
{
    bool armed = t->state.drive.mode == DRIVE_ARMED, stopping = t->state.drive.stopping;
    bool notify = armed != (t->out.armed != 0) || stopping != (t->out.stopping != 0) || !running ||
                  t->out.number != t->state.drive.request_seen ||
                  t->out.active_inputs != inputs_before;
    t->out.running = running;
    t->out.error = -error;
    t->out.armed = armed;
    t->out.stopping = stopping;
    t->out.fault_reasons = t->state.drive.fault_reasons;
    t->out.number = t->state.drive.request_seen;
    t->out.policy = t->grant.policy;
    t->out.scheduler_errno = t->grant.scheduler_errno;
    if (notify || now_ns - t->reported_ns >= REPORT_EVERY_NS) {
        t->reported_ns = now_ns;
        mailbox_put(&t->report.mailbox, t->report.slot, &t->out, sizeof t->out);
    }
    const uint64_t one = 1;
    if (notify && t->config.event_fd >= 0 && write(t->config.event_fd, &one, sizeof one) < 0) {
        return; /* full: the reader is woken already */
    }
}

/* --------------------------------------------------------------------------- the thread */
/* Do a cycle. Not `is_due`: the loop has woken the thread early. A pump does not change then, to
 * keep its frequency. */
static int cycle(pwm_thread *t, int64_t now_ns, bool is_due)
{
    double level[PWM_OUTPUTS_MAX];
    uint64_t inputs_before = t->out.active_inputs;
    int error = read_inputs(t);
    error = error != 0 ? error : read_encoders(t, now_ns);
    t->state.enabled_count = exchange_enabled_count(t->exchange, t->number);
    (void)exchange_take_setpoints(t->exchange, t->number, &t->newest);
    t->newest.stamp_ns = stamp_since(t->newest.stamp_ns, clock_resumed_ns());
    (void)mailbox_take(&t->control.mailbox, t->control.slot, &t->request, sizeof t->request);
    t->state.phase ^= !is_due; /* the step changes it back */
    bridge_step(&t->state, &t->config, &t->request, &t->newest, now_ns, level);
    int wrote = error == 0 ? apply(t, level) : 0;
    error = error != 0 ? error : wrote;
    t->out.cycles++;
    if (error == 0) {
        feed_back(t, now_ns);
        put_report(t, true, 0, now_ns, inputs_before);
    }
    return error;
}

static void sleep_until(int64_t time_ns)
{
    struct timespec until = {.tv_sec = time_ns / NS_PER_S, .tv_nsec = time_ns % NS_PER_S};
    (void)clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

/* Wait until the cycle is due, or the loop wakes the thread for a new command or a stop, which
 * leaves at once, but GAP_NS after the previous cycle. Returns 0 or -errno. */
static int wait_for_turn(const pwm_thread *t, int64_t due_ns, int64_t begun_ns)
{
    int64_t left_ns = due_ns - clock_now_ns();
    if (left_ns <= 0) {
        return 0;
    }
    struct timespec left = {.tv_sec = left_ns / NS_PER_S, .tv_nsec = left_ns % NS_PER_S};
    struct pollfd wake = {.fd = t->wake_fd, .events = POLLIN};
    int ready = ppoll(&wake, 1, &left, NULL);
    if (ready < 0 && errno != EINTR) {
        return -errno;
    }
    uint64_t wakes;
    if (ready > 0 && read(t->wake_fd, &wakes, sizeof wakes) > 0) {
        sleep_until(begun_ns + GAP_NS < due_ns ? begun_ns + GAP_NS : due_ns);
    }
    return 0;
}

static void *run(void *arg)
{
    pwm_thread *t = arg;
    loop_thread_prepare(&(loop_config){.cpu_mask = t->config.cpu_mask}, &t->grant);
    (void)pthread_setname_np(pthread_self(), "motord-pwm");
    int error = rest(t);
    int64_t due_ns = clock_now_ns(), begun_ns = due_ns;
    (void)exchange_set_line_wake(t->exchange, t->number, t->wake_fd);
    while (!t->stop_requested && error == 0) {
        error = wait_for_turn(t, due_ns, begun_ns);
        begun_ns = clock_now_ns();
        error = error == 0 ? cycle(t, begun_ns, begun_ns >= due_ns) : error;
        if (begun_ns >= due_ns) {
            int64_t missed = (begun_ns - due_ns) / t->config.period_ns;
            t->out.late_cycles += (uint64_t)missed;
            due_ns += (missed + 1) * t->config.period_ns;
        }
    }
    (void)exchange_set_line_wake(t->exchange, t->number, -1);
    int32_t where = t->out.error_output;
    int rested = rest(t);
    t->out.error_output = error != 0 ? where : t->out.error_output;
    drive_take_back(&t->state.drive, 0, DRIVE_READY);
    (void)drive_power_off(&t->state.drive);
    put_report(t, false, error != 0 ? error : rested, clock_now_ns(), t->out.active_inputs);
    return NULL;
}

int pwm_line_start(uint32_t line, const bridge_config *config)
{
    if (line >= LINES_MAX || bridge_config_check(config) != 0) {
        return -EINVAL;
    }
    pwm_thread *t = &threads[line];
    if (t->joinable) {
        return -EBUSY;
    }
    int wake_fd = t->has_wake_fd ? t->wake_fd : eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (wake_fd < 0) {
        return -errno;
    }
    memset(t, 0, sizeof *t);
    t->wake_fd = wake_fd;
    t->has_wake_fd = true;
    t->config = *config;
    t->number = line;
    t->exchange = config->exchange != NULL ? config->exchange : loop_exchange();
    mailbox_init(&t->control.mailbox);
    mailbox_init(&t->report.mailbox);
    for (uint32_t i = 0; i < JOINTS_MAX; i++) {
        mailbox_init(&t->reported[i].mailbox);
    }
    t->out.running = 1;
    t->out.error_output = AT_GPIO;
    for (uint32_t i = 0; i < config->joint_count; i++) {
        encoder_init(&t->encoder[i], &config->joint[i].encoder);
    }
    mailbox_put(&t->report.mailbox, t->report.slot, &t->out, sizeof t->out);
    int error = loop_thread_create(&t->thread, &(loop_config){.priority = config->priority},
                                   &t->grant, run, t);
    t->made = t->joinable = error == 0;
    return error;
}

int pwm_line_stop(uint32_t line)
{
    if (line >= LINES_MAX || !threads[line].joinable) {
        return -ESRCH;
    }
    threads[line].stop_requested = true;
    wake(&threads[line]);
    int error = pthread_join(threads[line].thread, NULL);
    threads[line].joinable = false;
    return -error;
}

void pwm_line_put_control(uint32_t line, const bridge_control *control)
{
    if (line < LINES_MAX && threads[line].made) {
        mailbox_put(&threads[line].control.mailbox, threads[line].control.slot, control,
                    sizeof *control);
        wake(&threads[line]);
    }
}

void pwm_line_put_sample(uint32_t line, uint32_t joint, const encoder_sample *sample)
{
    if (line < LINES_MAX && threads[line].made && joint < threads[line].config.joint_count &&
        threads[line].config.joint[joint].encoder.kind == ENCODER_REPORTED) {
        mailbox_put(&threads[line].reported[joint].mailbox, threads[line].reported[joint].slot,
                    sample, sizeof *sample);
    }
}

int pwm_line_read_report(uint32_t line, bridge_report *out)
{
    if (line >= LINES_MAX || !threads[line].made) {
        return -ESRCH;
    }
    (void)mailbox_take(&threads[line].report.mailbox, threads[line].report.slot, out, sizeof *out);
    return 0;
}
