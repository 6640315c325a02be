/* SPDX-License-Identifier: Apache-2.0
 * api_bridge.h: motor bridges on PWM channels and GPIO lines, in a separate thread. cffi reads it,
 * too. */

enum { PWM_OUTPUTS_MAX = 32, BRIDGE_MODES = 4 };

/* Modes of a bridge. COAST: no power; a bridge always ends in it. */
enum { BRIDGE_COAST, BRIDGE_BRAKE, BRIDGE_FORWARD, BRIDGE_REVERSE };

/* Requests to the line. OFF: no power, at once. STOP: an armed bridge brakes for stopping_ns, then
 * has no power. ARMED: follow the set-points, but not while it still brakes. */
enum { PWM_OFF, PWM_STOP, PWM_ARMED };

/* One pin. Its level, 0 to 1, is base + slope × |duty| of the mode; a GPIO line is high from one
 * half on. */
typedef struct {
    uint32_t joint;    /* index in bridge_config.joint */
    int32_t fd;        /* descriptor of a duty_cycle file; -1: a GPIO line */
    uint32_t bit;      /* GPIO: bit of the line in the request */
    uint32_t inverted; /* the pin is active low */
    uint32_t pumps; /* 1: the pin changes with every cycle of the period while the motor may move,
                       else it is low; base and slope are unused. A charge pump or watchdog behind
                       it drops out when any thread hangs */
    uint32_t reserved;
    uint64_t period_ns; /* period of the channel */
    double base[4];     /* values by mode */
    double slope[4];
} bridge_pin;

typedef struct {
    uint32_t index;     /* the core's joint */
    uint32_t rest_mode; /* mode while armed at a duty of zero: BRIDGE_COAST or BRIDGE_BRAKE */
    double sign;        /* -1: the motor turns backward when the robot drives forward */
    double full_rad; /* 0: the bridge takes duties. Else a servo, which takes positions: its angle
                        at a duty of 1 */
    uint64_t fault_mask; /* lines of the input request that signal a fault when active */
    encoder_config encoder;
} bridge_joint;

typedef struct {
    exchange *exchange;  /* NULL: the loop's */
    int32_t outputs_fd;  /* request of all GPIO outputs; -1: no request */
    int32_t inputs_fd;   /* request of all GPIO inputs; -1: no request */
    uint64_t low_inputs; /* bits of inputs that are active when they are low */
    int32_t event_fd;    /* written when the report has changed; -1: no descriptor */
    int32_t priority;    /* SCHED_FIFO; 0: SCHED_OTHER */
    uint64_t cpu_mask;   /* 0: all CPUs */
    int64_t period_ns;
    int64_t setpoint_timeout_ns;
    int64_t stopping_ns; /* at most DRIVE_STOPPING_NS */
    uint32_t epoch;
    uint32_t joint_count;
    uint32_t output_count;
    bridge_joint joint[8];
    bridge_pin output[32];
} bridge_config;

typedef struct {
    uint32_t mode;   /* PWM_OFF, PWM_STOP, PWM_ARMED */
    uint32_t number; /* a new number is a new request. ARMED takes effect once for each number. A
                        skipped number may have been a stop: then the power goes off */
} bridge_control;

typedef struct {
    uint32_t running;
    uint32_t armed;
    uint32_t stopping;
    uint32_t fault_reasons; /* DRIVE_FAULT_* since the last arming */
    uint32_t number;        /* number of the newest request in force */
    int32_t error;          /* errno that ended the thread */
    /* output of the error; -1: the GPIO request; -2 - n: the encoder of joint n */
    int32_t error_output;
    int32_t policy;
    int32_t scheduler_errno;
    int32_t rest_error;  /* errno that kept a pin from COAST at its newest write; 0: all pins
                            rest */
    int32_t rest_output; /* output of rest_error, like error_output */
    uint32_t reserved;
    uint64_t active_inputs; /* bits of the input request */
    uint64_t cycles;
    uint64_t late_cycles; /* number of missed periods */
    uint64_t writes;
    uint64_t encoder_illegal; /* sum over all encoders, as in encoder_state */
    uint64_t encoder_lost;
} bridge_report;

/* --------------------------------------------------------- pure: the levels of the pins */
typedef struct {
    drive_state drive;      /* state of all joints. Without a set-up it is READY from the first step
                               on */
    int64_t brake_until_ns; /* end of the braking, while it is stopping */
    int64_t last_ns;        /* time of the previous step */
    uint64_t enabled_count; /* number of times that the set-points became enabled: the caller writes
                               it before the step */
    uint32_t phase;         /* phase of pins that pump */
    uint32_t holds;         /* bit n: joint n, a servo, gets its pulses */
    double held_duty[8];    /* target angle of a servo, as a duty */
} bridge_state;

/* Compute level[i] of output i, 0 to 1. Set-points that are old, not enabled or not finite move
 * nothing. */
void bridge_step(bridge_state *state, const bridge_config *config, const bridge_control *control,
                 const setpoints *newest, int64_t now_ns, double *level);
/* Return the part of the period that is high for a level, with the pin's polarity. */
uint64_t bridge_duty_ns(const bridge_pin *output, double level);
int bridge_config_check(const bridge_config *config); /* 0 or -EINVAL */

/* ---------------------------------------------------------------------------------- the thread
 * The caller keeps the descriptors, and closes them after pwm_line_stop. Whatever ends the thread,
 * the last levels are COAST. */
int pwm_line_start(uint32_t line, const bridge_config *config);
int pwm_line_stop(uint32_t line);
void pwm_line_put_control(uint32_t line, const bridge_control *control);
/* Hand over a board's count of a joint with ENCODER_REPORTED, by its index on the line. Only one
 * thread may call this. */
void pwm_line_put_sample(uint32_t line, uint32_t joint, const encoder_sample *sample);
int pwm_line_read_report(uint32_t line, bridge_report *out);
