/* SPDX-License-Identifier: Apache-2.0
 *
 * api_feedback.h: how the core evaluates one joint's feedback, and when it does not trust it. Read
 * before api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

/* What follows from a joint's configuration alone. counter_*: 0 without a counter. */
typedef struct {
    double wheel_radius_m;
    double reach_rad_s;            /* the wheel turns no faster */
    double counter_rad;            /* per count, signed */
    double counter_slack_rad;      /* travel by the counter may be beyond reach by this */
    double counter_round_rad;      /* the angle after which the counter repeats */
    double counter_unused_max_rad; /* so much unused reach is carried over */
    uint32_t counter_bits_unused;  /* of a 64 bit word */
    uint32_t reserved;
} joint_constants;

typedef struct {
    uint64_t count;   /* travel counts from here: the last accepted sample */
    uint64_t refused; /* of the last sample, if it was refused */
    int64_t stamp_ns; /* last sample's */
    uint32_t epoch;
    uint32_t last;  /* the last sample: none, accepted or refused */
    uint32_t fresh; /* a sample came since the last integration */
    uint32_t jumps;
    double pending_rad; /* travelled since the last integration */
    double position_rad;
    double velocity_rad_s;
    double since_rad;         /* how far the wheel may have turned since `count` */
    double unused_rad;        /* and unused reach from before */
    double credited_rad;      /* estimated since `count` */
    joint_constants constant; /* as odometry_init() found them */
} joint_odometry;

/* Of one joint. All at the wheel. A time of 0 switches a check off. */
typedef struct {
    double setpoint_min_rad_s; /* >= 0: below it direction and stall are not checked */
    double slow_rad_s;         /* >= 0: a wheel slower than this does not turn */
    double short_rad_s;        /* >= 0: a wheel that lacks more than this does not follow */
    double beyond_rad_s;       /* >= 0: a wheel that is faster by more than this runs away */
    double apart_rad_s; /* >= 0: counter and reported velocity may differ by this, and by half of
                           the larger one */
    /* >= 0: a wheel that comes nearer to its set-point by this is only slow */
    double progress_rad_s;
    double direction_s;
    double stall_s;
    double following_s;
    double runaway_s;
    double apart_s;
    uint32_t jumps_max; /* so many refused samples within a second; 0: any number */
    uint32_t reserved;
} plausible_config;

/* Why the feedback is not trusted, or the drive does not follow its set-points: for users. */
typedef struct {
    int64_t since_ns;
    double setpoint_rad_s;
    double measured_rad_s; /* by its counter where it has one, smoothed */
    double reported_rad_s; /* the drive's own measure, as it came; NaN: none */
    uint32_t fault;        /* FAULT_*; 0: there is none */
    uint32_t joint;
} feedback_doubt;

typedef struct {
    int64_t stamp_ns; /* last sample's; 0: begin anew */
    double position_rad;
    double measured_rad_s; /* smoothed */
    double reported_rad_s; /* the drive's own measure, smoothed; without one as above */
    double rough_rad_s;    /* mean distance of what it reports from that */
    double nearest_rad_s;  /* the speed that was nearest to the set-point since a check began */
    int64_t since_ns[5];   /* by check; 0: all is well */
    int64_t jumped_ns;     /* the first of the jumps that are counted */
    uint32_t jumps;        /* seen so far */
    uint32_t jumps_before; /* before those that are counted */
    uint32_t suspicious;   /* bit n: since_ns[n] counts */
    uint32_t faster;       /* 1: the set-point was above the wheel's speed */
    uint32_t doubted;      /* 1: a fault was found; until it begins anew */
    uint32_t reserved;
} plausible_state;
