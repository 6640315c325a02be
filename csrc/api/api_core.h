/* SPDX-License-Identifier: Apache-2.0
 *
 * api_core.h: the pure computations of the core, and their state from one tick to the next.
 * Read after api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

enum { AXIS_LINEAR = 0, AXIS_ANGULAR = 1, AXIS_LATERAL = 2, AXES = 3 };

typedef struct {
    double velocity_u_s;
    double acceleration_u_s2; /* acceleration of the previous step */
} limit_state;

/* Do one step of a twist, axis[AXES], along the straight line to goal_u_s[AXES]. Returns the REASON
 * bit of the limit that bound it, 0 at the goal. The goal is within the limits of velocity; a
 * component that is not finite counts as zero. `axes`: number of axes that move, in the order of
 * AXIS_*. `slewed`: the base whose duty slews bind, too, or NULL. `urgent`: leave out the jerk
 * limits (faults). dt_s > 0. */
uint32_t ramp_step(limit_state *axis, uint32_t axes, const base_limits *limits,
                   const core_config *slewed, const double *goal_u_s, double dt_s, bool urgent);

/* Return the common factor 0..1 that scales all wheels to within their limits. */
double saturate_factor(const double *want_rad_s, const joint_config *joint, uint32_t count);

/* Compute the wheel speeds of a twist, twist_u_s[AXES]. */
void kinematics_wheels(const core_config *config, const double *twist_u_s, double *wheel_rad_s);

/* The inverse, from wheel speeds to the twist, by least squares: each axis of the twist is the sum
 * over the joints of inverse times rim speed. */
typedef struct {
    double inverse[AXES][JOINTS_MAX]; /* 0 for joints that are not used */
    double shared;       /* number of joints for each axis of the twist: so many share one error */
    uint32_t joints;     /* bit n: joint n is used */
    uint32_t determined; /* 0: these joints do not determine the twist, and all of `inverse` is 0 */
    uint32_t strafes;    /* value of kinematics_strafes() */
    uint32_t reserved;
} twist_inverse;

/* Growth of the pose's uncertainty, from the motion of wheels and base since the last look. A look
 * is due by the rule of plausible_due(). */
typedef struct {
    int64_t stamp_ns;   /* time of the last look; 0: begin anew */
    double heading_rad; /* heading at the last look */
    double x_m;         /* motion since then, in the frame of the pose, as if straight on */
    double y_m;
    double gyro_rad2;         /* variance of the gyro's turn since then */
    double rim_m[JOINTS_MAX]; /* travel since then */
    uint32_t by_gyro;         /* 1: the turn since then is by the gyro */
    uint32_t reserved;
    /* smoothed part of each rim's speed that no motion of the base explains */
    double residual_m_s[JOINTS_MAX];
    double slip_m_s; /* root of their mean square */
} spread_state;

/* The twist at one moment, and the travel of the base up to it, along its own axes. */
typedef struct {
    int64_t stamp_ns;
    double travel_u[AXES];
    double by_travel_u_s[AXES]; /* measured by the travel over the window */
    double by_drives_u_s[AXES]; /* measured by the speeds that the drives report; 0 without */
    double twist_u_s[AXES];     /* what was published */
    uint32_t reported;          /* 1: by_drives_u_s is known */
    uint32_t reserved;
} speed_look;

enum { LOOKS = 64 };
/* The measured twist and its errors, as seen a moment later: see speed.c. */
typedef struct {
    speed_look look[LOOKS]; /* a ring */
    double travel_u[AXES];  /* travel of the base since the start */
    /* mean square errors of both measures */
    double travel2_u2_s2[AXES];
    double drives2_u2_s2[AXES];
    double twist2_u2_s2[6];        /* mean products of the published twist's errors */
    double reference2_u2_s2[AXES]; /* part of them that is the reference's own error */
    int64_t seen_ns;               /* stamp of the newest look whose error was seen */
    uint32_t newest;               /* index of the newest look */
    uint32_t looks;                /* number of looks */
    uint32_t seen;                 /* number of errors that were seen, up to 1000 */
    uint32_t reserved;
} speed_state;

/* Whether the base can move sideways: a wheel has rollers, or all are steered. */
bool kinematics_strafes(const core_config *config);
/* Whether the base can turn on the spot. */
bool kinematics_spins(const core_config *config);
/* Compute the inverse of these joints. A base with modules counts as if its steering joints were at
 * 0. */
void kinematics_invert(const core_config *config, uint32_t joints, twist_inverse *out);
/* Compute the inverse of a base with modules for these angles of the steering joints: each driven
 * wheel has a speed, and no wheel slides across its direction (Siegwart & Nourbakhsh, Autonomous
 * Mobile Robots, 3.2.3). */
void kinematics_modules(const core_config *config, const double *angle_rad, uint32_t joints,
                        twist_inverse *out);
/* Return the root mean square of what the twist leaves of these joints' equations, by travel of the
 * rims. */
double kinematics_residual(const core_config *config, const double *angle_rad, uint32_t joints,
                           const double *rim, const double *twist_u);

typedef struct {
    double duty;
    uint32_t reasons;
} pwm_output;

/* Convert velocity to duty by the configuration; last_duty is the duty of the previous step. NaN:
 * 0. */
pwm_output pwm_step(const pwm_config *config, double last_duty, double velocity_rad_s, double dt_s);

/* Take a sample. Returns a factor 0..1, and its cause in `by`. A value that is not a number is
 * ignored. */
double derating_factor(derating_state *state, const derating_config *config,
                       const joint_feedback *feedback, uint32_t *by);
/* Whether one of the ranges is in use. */
bool derating_used(const derating_config *config);

/* Return the signed difference of two raw counters of 8..64 bits, by the shorter of both
 * directions. */
int64_t counter_difference(uint64_t now, uint64_t before, uint32_t bits);

typedef struct {
    joint_odometry joint[JOINTS_MAX];
    int64_t stamp_ns; /* time of the last integration */
    uint32_t degraded;
    uint32_t epoch;
    uint32_t blind;   /* 1: the wheels that send feedback do not determine the motion, so nothing is
                         integrated */
    uint32_t by_gyro; /* 1: the last turn was by the gyro */
    uint32_t twist_known; /* 1: the twist was measured, and the motion not lost since */
    uint32_t distrusted;  /* bit n: FAULT_IMPLAUSIBLE_FEEDBACK says that the counter of joint n is
                             wrong: its travel is left out */
    double x_m;
    double y_m;
    double heading_rad;
    double distance_m;
    double turned_rad;
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
    double pose_covariance[6];
    double twist_covariance[3];
    double lateral_covariance[3];
    spread_state spread;
    speed_state speed;
    twist_inverse used;           /* for the joints that brought the last travel */
    double angle_rad[JOINTS_MAX]; /* angles of joints that take positions; NaN: not known */
    double arc_rad[JOINTS_MAX];   /* the same angles at the end of the last arc */
    gyro_state gyro;
} odometry_state;

void odometry_init(odometry_state *state, const core_config *config);
/* Set the pose to the origin. Pending travel is dropped; position_rad of the joints stays. */
void odometry_reset(odometry_state *state, const core_config *config);
/* Take in new feedback[]; stale[j] != 0 leaves joint j out. setpoint[] is for joints that measure
 * nothing. */
void odometry_step(odometry_state *state, const core_config *config, const joint_feedback *feedback,
                   const uint32_t *stale, const joint_setpoint *setpoint);

/* Results of a command under the limits in force. They are kept: commands are rarer than ticks. */
typedef struct {
    double command_u_s[AXES]; /* the command as it came in */
    double wanted_u_s[AXES];  /* the same, but 0 when not finite */
    double goal_u_s[AXES];    /* the part that limits and wheels allow */
    double saturation;
    uint32_t command_reasons;
    uint32_t reasons;
    uint32_t zero;  /* 1: a finite command of zero */
    uint32_t known; /* 0: goal_u_s, saturation and reasons are not up to date */
} core_goal;

/* The wheels' results of the last tick. They are valid as long as the twist is the same and no duty
 * is ramping. */
typedef struct {
    double twist_u_s[AXES]; /* twist of a base with modules; other bases have it in
                               core_state.axis */
    joint_setpoint joint[JOINTS_MAX];
    uint32_t reasons;
    uint32_t moving;
    uint32_t known;
    uint32_t reserved;
} core_wheels;

/* Steering of a base with modules. */
typedef struct {
    position_profile profile[JOINTS_MAX]; /* profiles by joint */
    double unsure_s[JOINTS_MAX]; /* ESTIMATED: time for which the joint may still be anywhere */
    double pace_rad_s; /* speed at which a wheel's direction may change while the base moves, so
                          that no profile lags much */
    double curvature_min_per_m; /* range that all steering joints allow: -INFINITY..0 */
    double curvature_max_per_m; /* 0..INFINITY */
    double misaligned_rad;
    position_following following[JOINTS_MAX];
    uint32_t turns_on_spot;
    uint32_t enabled; /* 1: enabled in the last tick */
    uint32_t unknown; /* bit n: the position of joint n is unknown */
    uint32_t reserved;
} steer_state;

typedef struct {
    core_config config;
    base_limits limits;         /* limits in force */
    uint64_t command_window_ns; /* timeouts, measured from the farthest valid stamp in the future */
    uint64_t feedback_window_ns;
    uint64_t heartbeat_window_ns;
    core_goal goal;
    core_wheels wheels;
    limit_state axis[AXES]; /* twist of the wheels */
    odometry_state odometry;
    speed_loop_state speed_loop[JOINTS_MAX];
    speed_loop_gains gains[JOINTS_MAX]; /* gains in force */
    plausible_state plausible[JOINTS_MAX];
    steer_state steer;
    joints_state joints;
    axis_limits joint_limits[JOINTS_MAX]; /* limits in force for joints without a base */
    derating_state derating[JOINTS_MAX];
    robot_state snapshot;       /* snapshot of the last tick */
    uint32_t stale[JOINTS_MAX]; /* 1: the joint has sent no feedback for feedback_timeout_s */
    uint64_t tick;
    uint32_t armed;
    uint32_t armed_seen; /* control.armed of the tick before: arming needs an edge */
    uint32_t reset_seen;
    uint32_t odometry_reset_seen;
    uint32_t gains_seen;
    uint32_t joint_limits_seen;
    uint32_t faults;
    uint32_t holding;     /* after a fault the drives stay enabled until rest; STOP_HOLD: until
                             control.release or a reset */
    uint32_t commanded;   /* a fresh command has come since arming */
    uint32_t silent;      /* a joint is stale */
    uint32_t doubted;     /* bit n: a fault says that the feedback of joint n is not trusted */
    uint32_t joints_rest; /* REST_*, by what the joints measure */
    uint32_t rest;        /* REST_* after the last tick */
    uint32_t slewed;      /* 1: a joint has a duty slew */
    uint32_t axes;        /* number of the base's axes: AXES, or without the last one, the lateral
                             axis */
    uint32_t steered;     /* 1: a base with modules */
    uint32_t positions;   /* 1: a joint takes positions */
    uint32_t extras;      /* not 0: the base has positions, a gyro or speed loops */
    /* bit n: joint n has a speed loop that its gains make do something */
    uint32_t loops;
    uint32_t derates;      /* 1: a joint may derate the base */
    int64_t armed_ns;      /* time of the tick that armed */
    int64_t zero_since_ns; /* tick since which the set-points are zero, at the earliest that of the
                              newest fault under power; 0: they are not */
} core_state;

/* Check a configuration. Returns NULL when it is good, else the name of the first bad field, such
 * as "joint[2].wheel_radius_m". The caller provides name[FIELD_NAME_BYTES]. */
const char *core_config_check(const core_config *config, char *name);
const char *base_limits_check(const base_limits *limits, char *name);
/* Set the core up: disarmed, at rest, with no fault. Returns 0 or -EINVAL. */
int core_init(core_state *state, const core_config *config);
/* Whether the power may go off as requested: the robot is at rest or, as that may never be seen,
 * its set-points have been zero for two seconds. */
bool core_may_power_off(const core_state *state, int64_t now_ns);
/* Do one tick. Pure and deterministic: the same state, input and dt give the same bytes. `snapshot`
 * receives a copy of state->snapshot; NULL: the caller reads that. */
void core_step(core_state *state, const core_input *input, double dt_s, setpoints *out,
               robot_state *snapshot);
