/* SPDX-License-Identifier: Apache-2.0
 *
 * api_derating.h: how measured values of drives slow the base down, and start times of the reasons.
 * Read before api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

enum {
    DERATED_BY_TEMPERATURE = 0,
    DERATED_BY_CURRENT = 1,
    DERATED_BY_VOLTAGE = 2,
    DERATINGS = 3,
    REASONS_MAX = 32
};

/* Range in which the base's speed limits fall linearly, from all of them at `full` to zero at
 * `none`. `full` == `none`: no such range. */
typedef struct {
    double full;
    double none;
} derating_range;

/* Ranges of one joint, by DERATED_BY_*: °C, A and V. For a voltage, `none` is below `full`. */
typedef struct {
    derating_range range[DERATINGS];
} derating_config;

typedef struct {
    int64_t stamp_ns;           /* stamp of the last sample; 0: no sample yet */
    double measured[DERATINGS]; /* smoothed; NaN: never measured */
} derating_state;

/* For users: the joint that derates the base most. */
typedef struct {
    int64_t since_ns; /* 0: no joint derates the base */
    double factor;    /* factor of the base's speed limits */
    uint32_t joint;
    uint32_t by; /* DERATED_BY_* */
} derating_shown;

/* Start time of each reason, and the joints that cause it: bit n is joint n. The joints of a reason
 * are valid only while it holds. */
typedef struct {
    int64_t since_ns[REASONS_MAX]; /* start times by bit; 0: the reason does not hold */
    uint32_t saturated_joint;      /* REASON_WHEEL_SATURATED: the joint that has to be slowed down
                                      most */
    uint32_t duty_clamped;         /* joints that cause REASON_DUTY_CLAMPED */
    uint32_t duty_slew;            /* REASON_DUTY_SLEW: the joint whose slew rate bounds the ramp */
    uint32_t joint_velocity; /* joints that cause REASON_JOINT_VELOCITY; likewise the next two */
    uint32_t joint_acceleration;
    uint32_t joint_position;
} reasons_shown;
