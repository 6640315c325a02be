/* SPDX-License-Identifier: Apache-2.0
 *
 * api_loop.h: the part of the border for the loop: histograms, mailboxes, the state page, the
 * thread. Read after api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor
 * line. */

/* ----------------------------------------------------------------------------------- histogram
 * Log-linear: 16 buckets an octave (at most 6.25 % wide), 1 ns .. 2^40 ns (18 min); the last one is
 * for greater values. */
enum { HISTOGRAM_SUB_BUCKETS = 16, HISTOGRAM_BUCKETS = 608 };
typedef struct {
    uint64_t samples;
    int64_t max_ns;
    int64_t min_ns;
    uint64_t bucket[HISTOGRAM_BUCKETS];
} histogram;

uint32_t histogram_bucket(int64_t value_ns);        /* negative: 0 */
int64_t histogram_bucket_floor_ns(uint32_t bucket); /* smallest value that falls into it */
void histogram_clear(histogram *h);
/* One writer; relaxed atomics, so any thread may read. */
void histogram_add(histogram *h, int64_t value_ns);
void histogram_copy(histogram *to, const histogram *from);
/* fraction: 0..1. Returns 0 when empty, and never more than max_ns. */
int64_t histogram_percentile_ns(const histogram *h, double fraction);

/* ------------------------------------------------------------------------------------ exchange
 * All mailboxes between asyncio, the line engines and the loop: newest wins, triple buffers, one
 * writer and one reader each, the writer never waits. */
typedef struct exchange exchange;
size_t exchange_bytes(void);
void exchange_init(exchange *x); /* memory aligned to 64 bytes */
/* asyncio → loop */
void exchange_put_control(exchange *x, const core_control *control);
/* line → loop */
int exchange_put_feedback(exchange *x, uint32_t joint, const joint_feedback *feedback);
/* the sensor's reader → loop */
void exchange_put_imu(exchange *x, const imu_sample *sample);
/* loop → line */
int exchange_take_setpoints(exchange *x, uint32_t line, setpoints *out);
/* The loop's side. Each take copies the newest value, and returns 1 if it is new, 0 if not, -EINVAL
 * for a bad index. A value that was never written is all zero. */
int exchange_take_control(exchange *x, core_control *out);
int exchange_take_feedback(exchange *x, uint32_t joint, joint_feedback *out);
int exchange_take_imu(exchange *x, imu_sample *out);
int exchange_put_setpoints(exchange *x, uint32_t line, const setpoints *value);
/* Return the number of times that a line's set-points have become enabled. A mailbox keeps the
 * newest value only, so a line may miss a short time. Read it before the take: the taken value is
 * at least as new. */
uint64_t exchange_enabled_count(const exchange *x, uint32_t line);
/* Set an eventfd that wakes a line's thread before its time; -1: none. It stays open as long as the
 * process lives. */
int exchange_set_line_wake(exchange *x, uint32_t line, int fd);
int exchange_line_wake(const exchange *x, uint32_t line);

/* ---------------------------------------------------------------------------------- state page
 * Shared memory, one writer, any number of readers, which need no lock and cannot disturb it.
 * docs/state-page.md */
enum { PAGE_BYTES = 16384 };
int page_init(void *page); /* PAGE_BYTES, aligned to 64 */
void page_write(void *page, const robot_state *state);
/* Returns 0; -EAGAIN: overtaken in every try; -EPROTO: not a page of this layout; -ENODATA:
 * empty */
int page_read(const void *page, robot_state *out);

/* ------------------------------------------------------------------------------ pins of safety
 * Descriptors of GPIO v2 line requests of one line each. The caller keeps them. */
/* State of the input. LOST stops like ACTIVE. */
enum { ESTOP_NONE = 0, ESTOP_CLEAR = 1, ESTOP_ACTIVE = 2, ESTOP_LOST = 3 };
typedef struct {
    uint32_t estop; /* 1: estop_fd is an input, not blocking, with edges to the stopping level */
    int32_t estop_fd;
    uint32_t estop_high; /* the stopping level */
    uint32_t watchdog;   /* 1: watchdog_fd is an output that changes while all threads live */
    int32_t watchdog_fd;
    uint32_t watchdog_every_ticks;
    int64_t heartbeat_timeout_ns;
    int64_t line_timeout_ns[LINES_MAX]; /* longest time between two takes of set-points while drives
                                           are enabled; 0: no such line */
} guard_config;

/* ---------------------------------------------------------------------------------- late ticks
 * Data of each late tick, to find the cause of the delay. Each value is a difference to the
 * previous tick. */
enum {
    STAGE_WAKE = 0,   /* time from the deadline to the thread's wake-up */
    STAGE_INPUT = 1,  /* commands, control and feedback are taken */
    STAGE_CORE = 2,   /* core_step */
    STAGE_OUTPUT = 3, /* set-points for the lines, state page, journal */
    STAGE_NOTIFY = 4, /* lines and asyncio are woken, the watchdog's pin moves */
    TICK_STAGES = 5
};
enum { LATE_TICKS_MAX = 1024 }; /* a power of two */
typedef struct {
    int64_t deadline_ns;
    int64_t stage_ns[TICK_STAGES];
    /* time for which the thread was ready but had no CPU; -1: the kernel does not count it */
    int64_t ready_ns;
    uint32_t page_faults; /* minor and major */
    uint32_t preemptions; /* involuntary context switches */
    int32_t cpu;          /* at the end of the tick */
    int32_t cpu_before;   /* at the end of the previous tick */
} late_tick;

/* ---------------------------------------------------------------------------------------- loop
 * One loop in a process: its state is static, so that the thread allocates no memory. */
typedef struct {
    double rate_hz;              /* 10..20000 */
    int32_t priority;            /* SCHED_FIFO 1..99; 0: SCHED_OTHER on request */
    uint32_t notify_every_ticks; /* eventfd is written at this interval, and when a reason to stand,
                                    faults, armed or rest change */
    uint64_t cpu_mask;           /* bit n: CPU n; 0: no affinity */
    /* shared memory of PAGE_BYTES, or -1 for a private page; the loop maps its own */
    int32_t page_fd;
    int32_t journal_fd; /* shared memory of journal_bytes(), or -1: no journal; the loop maps its
                           own */
    int32_t event_fd;   /* an eventfd, or -1 */
    int32_t command_fd; /* an epoll of the datagram sockets for commands, COMMAND_SOCKETS of them at
                           most, each with itself as data.fd. One for each lease, or a flood on one
                           would block the others; -1: none */
    int32_t stop_fd;    /* a datagram socket for stop requests, with SO_PASSCRED; in that epoll,
                           too; -1: none */
    uint32_t lock_memory;      /* 1: mlockall(MCL_CURRENT | MCL_FUTURE) */
    uint32_t hold_dma_latency; /* 1: /dev/cpu_dma_latency open and 0 while the loop runs */
    guard_config guard;
    int64_t late_from_ns; /* ticks whose wake-up or end is this late are recorded; 0: no tick, at no
                             cost */
} loop_config;

typedef struct {
    uint32_t running;
    int32_t policy; /* SCHED_FIFO (1) or SCHED_OTHER (0), as set by the kernel */
    int32_t priority;
    int32_t scheduler_errno; /* 0, or the errno of a refusal */
    int32_t affinity_errno;
    int32_t memory_lock_errno;
    int32_t dma_latency_errno;
    uint32_t reserved;
    uint64_t ticks;
    uint64_t overruns;      /* periods skipped because the previous one was still running or the CPU
                               was away */
    uint64_t page_faults;   /* page faults of the thread since its first tick, minor and major */
    int64_t tick_stamp_ns;  /* last tick */
    uint32_t estop_input;   /* ESTOP_* */
    uint32_t watchdog_well; /* 1: the watchdog's pin changes */
    uint64_t watchdog_edges;
    int32_t watchdog_errno; /* error of the last write; 0: no error */
    uint32_t reserved_too;
    uint64_t late_lost; /* late ticks for which there was no room */
} loop_status;

enum {
    HISTOGRAM_LATENESS = 0, /* wake-up after its deadline */
    HISTOGRAM_STEP = 1,     /* the tick's own work */
    HISTOGRAM_COMMAND = 2,  /* command.stamp_ns to the first tick that used it */
    HISTOGRAM_KINDS = 3
};

exchange *loop_exchange(void); /* Static and ready at once. loop_start empties it, so no thread may
                                  be using it then. */
/* Returns 0; -EINVAL; -EBUSY; -errno of a step that is indispensable */
int loop_start(const loop_config *loop, const core_config *core);
int loop_stop(void); /* last set-points zero and not enabled; 0 or -ESRCH */
void loop_status_read(loop_status *out);
int loop_histogram_read(uint32_t kind, histogram *out);
int loop_histogram_clear(void);        /* a request; the loop does it at its next tick */
int loop_late_take(late_tick *out);    /* 1: the oldest late tick; 0: no more ticks. One reader */
int loop_state_read(robot_state *out); /* like page_read, on the loop's own page */
