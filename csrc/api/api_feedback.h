/* SPDX-License-Identifier: Apache-2.0
 *
 * api_feedback.h: how the core evaluates one joint's feedback, and when it does not trust it. Read
 * before api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

/* Constants that follow from a joint's configuration. counter_*: 0 without a counter. */
typedef struct {
    double wheel_radius_m;
    double reach_rad_s;            /* greatest speed of the wheel */
    double counter_rad;            /* angle for a count, signed */
    double counter_slack_rad;      /* travel by the counter may exceed the reach by this */
    double counter_round_rad;      /* angle after which the counter repeats */
    double counter_unused_max_rad; /* greatest unused reach that is carried over */
    uint32_t counter_bits_unused;  /* unused bits of a 64-bit word */
    uint32_t reserved;
} joint_constants;

typedef struct {
    uint64_t count;   /* count of the last accepted sample, from which travel counts */
    uint64_t refused; /* count of the last sample, if that was refused */
    int64_t stamp_ns; /* stamp of the last sample */
    uint32_t epoch;
    uint32_t last;  /* state of the last sample: none, accepted or refused */
    uint32_t fresh; /* a sample came since the last integration */
    uint32_t jumps;
    double pending_rad; /* travel since the last integration */
    double position_rad;
    double left_out_rad; /* the part of it that came while the counter was not trusted */
    double velocity_rad_s;
    double since_rad;         /* greatest turn of the wheel since `count` */
    double unused_rad;        /* unused reach from before */
    double credited_rad;      /* estimated travel since `count` */
    joint_constants constant; /* set by odometry_init() */
} joint_odometry;

/* Limits of the checks of one joint, at the wheel. A time of 0 switches a check off. */
typedef struct {
    double setpoint_min_rad_s; /* >= 0: below this, direction and stall are not checked */
    double slow_rad_s;         /* >= 0: a slower wheel counts as not turning */
    double short_rad_s;        /* >= 0: a wheel slower than its set-point by more than this does not
                                  follow */
    double beyond_rad_s;       /* >= 0: a wheel faster than its set-point by more than this runs
                                  away */
    double apart_rad_s; /* >= 0: counter and reported velocity may differ by this, and by half of
                           the larger one */
    /* >= 0: a wheel that comes nearer to its set-point by this is only slow */
    double progress_rad_s;
    double direction_s;
    double stall_s;
    double following_s;
    double runaway_s;
    double apart_s;
    uint32_t jumps_max; /* greatest number of refused samples within a second; 0: any number */
    uint32_t reserved;
} plausible_config;

/* For users: why the feedback is not trusted, or the drive does not follow its set-points. */
typedef struct {
    int64_t since_ns;
    double setpoint_rad_s;
    double measured_rad_s; /* measured by the counter if the joint has one, smoothed */
    double reported_rad_s; /* the drive's own measured value, as it came; NaN: none */
    uint32_t fault;        /* FAULT_*; 0: there is none */
    uint32_t joint;
} feedback_doubt;

typedef struct {
    int64_t stamp_ns; /* stamp of the last sample; 0: begin anew */
    double position_rad;
    double measured_rad_s; /* smoothed */
    double reported_rad_s; /* the drive's own measured value, smoothed; without one the value
                              above */
    double rough_rad_s;    /* mean distance of reported values from that mean */
    double nearest_rad_s;  /* speed that was nearest to the set-point since a check began */
    int64_t since_ns[5];   /* start time by check; 0: the check holds */
    int64_t jumped_ns;     /* time of the first counted jump */
    uint32_t jumps;        /* number of jumps so far */
    uint32_t jumps_before; /* number of jumps before the counted ones */
    uint32_t suspicious;   /* bit n: since_ns[n] is valid */
    uint32_t faster;       /* 1: the set-point was above the wheel's speed */
    uint32_t doubted;      /* 1: a fault was found; reset when the checks begin anew */
    uint32_t reserved;
} plausible_state;
