/* SPDX-License-Identifier: Apache-2.0
 *
 * api.h: the border between Python and C. The data of the computations are in api_core.h, the gyro
 * in api_imu.h, the evaluation of a joint's feedback in api_feedback.h, joints that take positions
 * in api_position.h, speed loops in api_speed_loop.h, derating in api_derating.h, the loop and its
 * exchange in api_loop.h, commands in api_command.h, serial lines in api_line.h. The C compiler
 * (through rt.h) and cffi (through build_ffi.py) read them. So they hold typedefs, enums, comments
 * and prototypes, and no preprocessor line.
 *
 * The name of a physical number ends in its unit. Time is CLOCK_MONOTONIC in nanoseconds; a stamp
 * of 0 means "never". Angles and wheel speeds are at the wheel (after the gear), positive when the
 * robot drives forward. The base's frame is that of REP 103: x forward, y to the left, turns
 * counterclockwise. A twist is (linear, lateral, angular): along x, along y, about z. `u` in a name
 * stands for the axis's own unit: m on the first two, rad on the angular one. */

enum { LINES_MAX = 4, COMMAND_SOCKETS = 19, FIELD_NAME_BYTES = 64 };

/* ------------------------------------------------------------------------------------- reasons
 * Why the set-point differs from the request. Bits of robot_state.reasons, valid for this tick
 * only. */
enum {
    REASON_LINEAR_VELOCITY = 1 << 0,     /* [limits] linear_m_s */
    REASON_LINEAR_ACCELERATION = 1 << 1, /* [limits] linear_m_s2 */
    REASON_LINEAR_DECELERATION = 1 << 2, /* [limits] linear_deceleration_m_s2 */
    REASON_LINEAR_JERK = 1 << 3,         /* [limits] linear_m_s3 */
    REASON_ANGULAR_VELOCITY = 1 << 4,    /* for angular motion, like the next three */
    REASON_ANGULAR_ACCELERATION = 1 << 5,
    REASON_ANGULAR_DECELERATION = 1 << 6,
    REASON_ANGULAR_JERK = 1 << 7,
    REASON_WHEEL_SATURATED = 1 << 8,   /* a wheel's limit scaled the whole twist: curvature kept */
    REASON_DUTY_CLAMPED = 1 << 9,      /* [joint] duty_min / duty_max */
    REASON_DUTY_SLEW = 1 << 10,        /* [joint] duty_slew_per_s */
    REASON_LATERAL_VELOCITY = 1 << 11, /* for lateral motion, like the next three */
    REASON_LATERAL_ACCELERATION = 1 << 12,
    REASON_LATERAL_DECELERATION = 1 << 13,
    REASON_LATERAL_JERK = 1 << 14,
    REASON_LATERAL_IMPOSSIBLE = 1 << 15, /* this base cannot move sideways: the lateral part of the
                                            command is left out */
    REASON_NOT_ARMED = 1 << 16,      /* not armed by the state machine, or disarmed by the core */
    REASON_STOP_REQUESTED = 1 << 17, /* control.stop */
    /* no command, or older than its lifetime or command_timeout_s */
    REASON_COMMAND_STALE = 1 << 18,
    REASON_COMMAND_NOT_FINITE = 1 << 19, /* NaN or infinity in the command: it counts as zero */
    REASON_FAULT = 1 << 20,              /* a latched fault: see robot_state.faults */
    REASON_STEERING = 1 << 21,  /* a wheel does not point in its direction yet: the base drives
                                   slower, or waits */
    REASON_CURVATURE = 1 << 22, /* the steering cannot reach so tight a curve: the base drives a
                                   wider one */
    REASON_TURN_IMPOSSIBLE = 1 << 23,  /* this base cannot turn on the spot: the angular part of the
                                          command is left out */
    REASON_POSITION_UNKNOWN = 1 << 24, /* a joint's position is unknown: see
                                          robot_state.steering.position_unknown */
    REASON_DERATED = 1 << 25,          /* [joint] derating: see robot_state.derating */
    REASON_JOINT_VELOCITY = 1 << 26,   /* for joints without a base, like the next two:
                                          velocity_max_rad_s of a joint */
    REASON_JOINT_ACCELERATION = 1 << 27, /* acceleration, deceleration or jerk of a joint */
    REASON_JOINT_POSITION = 1 << 28, /* position_min_rad or position_max_rad: the joint goes to that
                                        end */
};
/* Bits of the reasons for which the base has to rest, whatever was requested. */
enum { REASONS_TO_STAND = 0x11F0000 };

/* Faults are latched: only a rising reset_count clears them, with every cause gone and a command of
 * zero. */
enum {
    FAULT_ESTOP = 1 << 0,          /* control.estop was seen */
    FAULT_HEARTBEAT_LOST = 1 << 1, /* no heartbeat from asyncio for heartbeat_timeout_s while
                                      armed */
    FAULT_FEEDBACK_STALE = 1 << 2, /* a joint has sent no feedback for feedback_timeout_s while
                                      armed */
    FAULT_DRIVE = 1 << 3, /* a drive reports a fault (joint_feedback.drive_faults) while armed */
    FAULT_DRIVE_DISABLED = 1 << 4, /* a drive reports that it is not enabled while armed, without a
                                      request */
    FAULT_TIME_STEP = 1 << 5,      /* dt was NaN, infinite, zero or negative */
    FAULT_EXTERNAL = 1 << 6, /* control.fault: raised by the daemon (a line lost, a check failed) */
    FAULT_STATE = 1 << 7,    /* a value inside the core was not finite, which must not happen: the
                                base rests */
    FAULT_OVERSPEED = 1 << 8, /* a wheel driven by torque is far beyond its limit: a wrong sign, a
                                 slope */
    FAULT_DIRECTION = 1 << 9, /* a wheel turns against its set-point */
    FAULT_STALL = 1 << 10,    /* a wheel does not turn */
    FAULT_FOLLOWING_ERROR = 1 << 11, /* a wheel is much slower than its set-point and comes no
                                        nearer */
    FAULT_RUNAWAY = 1 << 12, /* a wheel is much faster than its set-point: the power goes off at
                                once */
    FAULT_IMPLAUSIBLE_FEEDBACK = 1 << 13, /* a counter jumps, or its speed differs from the one that
                                             the drive reports */
    FAULT_SUSPENDED = 1 << 14,        /* the computer was suspended: set-points are zero at once */
    FAULT_POSITION_UNKNOWN = 1 << 15, /* the position of a joint that takes positions became unknown
                                         while armed */
};
/* DIRECTION to IMPLAUSIBLE_FEEDBACK: the measured values are not trusted; see robot_state.doubt */
enum { FAULTS_OF_FEEDBACK = 0x3E00 };

/* ------------------------------------------------------------------------ configuration */
typedef enum { STOP_RAMP = 0, STOP_BRAKE = 1, STOP_HOLD = 2, STOP_COAST = 3 } stop_action;
/* RAMP  through the deceleration limit (no jerk limit on faults), drives off when at rest after a
 *       fault
 * BRAKE set-points zero at once; the drive does the stopping; drives off when at rest after a fault
 * HOLD  as RAMP, but the drives stay enabled at zero speed, also in a fault until it is disarmed (a
 *       robot on a slope)
 * COAST drives off at once; the core disarms */

typedef struct {
    double velocity_u_s;      /* > 0, finite */
    double acceleration_u_s2; /* > 0, finite: away from zero */
    double deceleration_u_s2; /* > 0, finite: towards zero */
    double jerk_u_s3;         /* > 0; INFINITY: no limit */
} axis_limits;

typedef struct {
    axis_limits linear;  /* u = m */
    axis_limits angular; /* u = rad */
    axis_limits lateral; /* u = m; unused for a base that cannot move sideways */
} base_limits;

/* Rolling of a wheel of a base without modules: the rim's speed is x linear + y lateral + lever_m
 * angular. For a wheel of two sides: (1, 0, -+ track / 2). Lynch & Park, Modern Robotics, 2017,
 * 13.2: any wheel at any place, with or without rollers. */
typedef struct {
    double x;
    double y;
    double lever_m;
} wheel_row;

typedef struct {
    double dead_band;       /* 0..1: duty at which the motor just turns; the output jumps over it */
    double duty_min;        /* -1..0: 0 for an output that cannot reverse */
    double duty_max;        /*  0..1 */
    double slew_per_s;      /* > 0; limits only growth away from zero; INFINITY: no limit */
    double full_duty_rad_s; /* > 0: wheel speed at duty 1 (open-loop map) */
} pwm_config;

typedef struct {
    wheel_row row;
    double wheel_radius_m;     /* > 0 */
    double velocity_min_rad_s; /* <= 0: 0 for a joint that cannot reverse */
    double velocity_max_rad_s; /* > 0 */
    /* signed, not 0: includes gear and inversion. Unused without a counter */
    double rad_per_count;
    uint32_t counter_bits; /* 8, 12, 15, 16, 24, 32, 64; 0: no counter: odometry from measured
                              velocity or set-point */
    uint32_t line;         /* 0..LINES_MAX-1: the line of this joint */
    uint32_t unmeasured;   /* 1: nothing measures whether this joint turns, so its set-point counts
                              for its rest */
    uint32_t counter_mantissa_bits; /* 24: the counter is made of a 32-bit floating-point number,
                                       whose steps grow with it; 0: it has steps of one count */
    pwm_config pwm;
    speed_loop_config speed_loop;
    plausible_config plausible;
    position_config position;
    derating_config derating;
    axis_limits own; /* for a joint without a base that takes velocities: u = rad; velocity_*_rad_s
                        bound its velocity, too */
} joint_config;

typedef struct {
    uint32_t joint_count; /* 2..JOINTS_MAX, or 1 without a base; the joints' rows define how the
                             base moves: forward, about, sideways */
    base_limits limits;
    double command_timeout_s;   /* > 0 */
    double feedback_timeout_s;  /* > 0 */
    double heartbeat_timeout_s; /* > 0 */
    double rest_velocity_rad_s; /* > 0: a wheel slower than this is at rest */
    stop_action on_timeout;     /* command stale, stop requested */
    stop_action on_fault;       /* for every latched fault but the e-stop */
    stop_action on_estop;
    /* odometry error model, Siegwart & Nourbakhsh, Autonomous Mobile Robots, 5.2.4 */
    double distance_variance_m2_per_m;  /* > 0: variance of a wheel's travel per metre of it; wheels
                                           with the same row share it */
    double turn_variance_rad2_per_rad;  /* > 0: heading variance per radian turned (scrub, track
                                           error) */
    double pose_variance_floor_m2;      /* > 0: initial and least variance of x and y */
    double heading_variance_floor_rad2; /* > 0 */
    double twist_variance_floor_m2_s2;  /* > 0 */
    double twist_variance_floor_rad2_s2; /* > 0 */
    gyro_config gyro;
    uint32_t module_count; /* 0: a base without steering, which uses the joints' rows; else
                              1..JOINTS_MAX */
    uint32_t independent;  /* 1: no base: each joint, also a single one, moves for itself; rows and
                              modules are unused */
    wheel_module module[JOINTS_MAX]; /* each joint appears once: as a traction joint, or as a
                                        steering joint that takes positions */
    joint_config joint[JOINTS_MAX];
} core_config;

/* ------------------------------------------------------------------------------- inputs */
typedef struct {
    int64_t stamp_ns;   /* time when the command was given; older than the timeout: rest */
    int64_t expires_ns; /* end of the lease of the command; later than this: rest */
    uint64_t sequence;  /* grows with each command of the arbiter */
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
} twist_command;

typedef struct {
    int64_t heartbeat_ns; /* time of asyncio's newest heartbeat */
    uint32_t armed;       /* level; the core arms on its rising edge and only when all is well */
    uint32_t stop;        /* level: come to rest, stay armed */
    uint32_t estop;       /* level; latched by the core */
    uint32_t fault;       /* level: raise FAULT_EXTERNAL */
    uint32_t reset_count; /* a change requests to clear latched faults */
    uint32_t odometry_reset_count; /* a change sets the pose to the origin */
    uint32_t machine_state; /* the daemon's state, copied to the state page; the core does not read
                               it */
    uint32_t owner;         /* the lease in command (its number), copied likewise */
    uint32_t release; /* level: a disarm is requested, so a hold after a fault (STOP_HOLD) ends at
                         rest as well */
    uint32_t reserved;
    base_limits limits;   /* replace the configured ones as a group; if base_limits_check refuses
                             them, the old ones stay */
    uint32_t gains_count; /* a change puts `gains` in force for all joints or, if one is out of
                             range, for no joint */
    uint32_t joint_limits_count; /* the same for `joint_limits` */
    speed_loop_gains gains[JOINTS_MAX];
    axis_limits joint_limits[JOINTS_MAX]; /* for joints without a base; those that take positions
                                             brake with their acceleration */
} core_control;

/* The report of a drive on one joint. A value that it does not report is NaN. */
typedef struct {
    int64_t stamp_ns; /* middle of the exchange that brought it; 0: never received */
    uint64_t count;   /* raw position counter, lowest counter_bits valid */
    double velocity_rad_s;
    double current_a;
    double voltage_v;
    double temperature_c;
    uint32_t epoch;        /* another number: the counter's origin may have moved, so counting
                              begins anew */
    uint32_t enabled;      /* 1: the drive reports enabled; 0: not enabled; 2: it cannot report
                              it */
    uint32_t drive_faults; /* the drive's fault word; 0: no fault */
    uint32_t referenced;   /* 1: the drive reports that its counter has a reference (homed); 0: that
                              it has no reference; 2: it cannot report it */
} joint_feedback;

typedef struct {
    int64_t now_ns; /* time of this tick */
    twist_command command;
    core_control control;
    joint_feedback feedback[JOINTS_MAX];
    imu_sample imu;
    /* in place of the twist if there is no base; `command` has the stamps */
    joint_command joints;
    uint32_t suspended; /* 1: the computer was suspended since the last tick */
    uint32_t reserved;
} core_input;

/* ------------------------------------------------------------------------------ outputs */
typedef struct {
    double velocity_rad_s; /* 0 unless armed */
    double duty;           /* -1..1, the same set-point through the PWM map; 0 unless armed */
    double torque_n_m; /* at the wheel: the same set-point through the speed loop; 0 unless armed */
} joint_setpoint;

typedef struct {
    int64_t stamp_ns; /* time of its tick; when this is old, a line sends zero */
    uint64_t tick;
    uint32_t enabled; /* 0: the line switches its drives' power off now */
    uint32_t joint_count;
    joint_setpoint joint[JOINTS_MAX];
    /* for joints that take positions, in their own frame, within all limits;
     * joint[n].velocity_rad_s is the speed of this motion */
    double position_rad[JOINTS_MAX];
    uint32_t positioned; /* bit n: position_rad[n] is valid; 0, as at the start: joint n stays at
                            its place, held if it has power */
    uint32_t reserved;
} setpoints;

/* What was measured is NaN, and `enabled` is 2, while the joint is stale. */
typedef struct {
    double position_rad;   /* sum of all counted turns since start, never jumps */
    double velocity_rad_s; /* measured, NaN before the first measure */
    double setpoint_rad_s;
    double duty;
    double current_a;
    double voltage_v;
    double temperature_c;
    double feedback_age_s; /* INFINITY: never received */
    uint32_t drive_faults; /* as received last */
    uint32_t enabled;      /* 1, 0, or 2: the drive cannot say */
    uint32_t stale;        /* 1: older than feedback_timeout_s */
    uint32_t jumps;        /* counter jumps refused so far */
} joint_state;

/* Further values of a base that moves sideways; zero for other bases, except the slip. */
typedef struct {
    double wanted_lateral_m_s; /* the command as it came in, to the left; 0 when stale or not
                                  finite */
    double setpoint_lateral_m_s;
    double lateral_m_s; /* measured, positive to the left */
    double slip_m_s; /* root mean square of the rims' speeds that no motion of the base explains */
    double lateral_covariance[3]; /* of the measured twist: vx vy, vy vy, vy w in m2/s2, m2/s2,
                                     m rad/s2; NaN: as linear_m_s */
} lateral_state;

/* State of joints that take positions; zero if there are no such joints. */
typedef struct {
    double position_setpoints_rad[JOINTS_MAX]; /* NaN: no set-point */
    double misaligned_rad; /* greatest angle between a wheel and its wanted direction; INFINITY: not
                              known yet */
    uint32_t position_joints;  /* bit n: joint n takes positions, and its position_rad is its
                                  angle */
    uint32_t position_unknown; /* bit n: the position of joint n is unknown */
} steering_state;

/* Whether the robot rests. TURNING: a set-point is not zero, or a wheel was measured to turn.
 * UNKNOWN: neither, but a joint was not seen at rest: it is stale, measures no number, or its
 * feedback is not trusted (FAULTS_OF_FEEDBACK). */
enum { REST_UNKNOWN = 0, REST_TURNING = 1, REST_AT_REST = 2 };

typedef struct {
    int64_t rest_unknown_since_ns[JOINTS_MAX]; /* tick since which it is unknown whether joint n
                                                  turns; 0: it is known */
    uint32_t rest;                             /* REST_* */
    uint32_t rest_unmeasured; /* bit n: nothing measures joint n: its set-point counts */
} rest_shown;

/* What is wrong with the joints' counters. */
typedef struct {
    uint32_t counter_coarse;     /* bit n: joint n's counter is made of a floating-point number, and
                                    has gone so far that one of its steps is more than a wheel at
                                    rest may turn in 0.2 s: its drive has to be restarted */
    uint32_t counter_distrusted; /* bit n: the odometry leaves joint n's counter out until the
                                    reset: see FAULT_IMPLAUSIBLE_FEEDBACK */
} counters_shown;

enum { PAGE_LAYOUT_VERSION = 1 };
/* The snapshot: the state of the core after a tick, and the payload of the state page. A new layout
 * version only adds fields at the end. */
typedef struct {
    int64_t stamp_ns; /* this tick */
    uint64_t tick;
    uint32_t machine_state; /* as in core_control */
    uint32_t owner;
    uint32_t reasons; /* REASON_* */
    uint32_t faults;  /* FAULT_*, latched */
    uint32_t armed;   /* 1: the core itself is armed */
    uint32_t enabled; /* 1: the drives are to have power */
    uint32_t at_rest; /* 1: set-points are zero and every wheel was seen slower than
                         rest_velocity_rad_s; 0: it turns, or that is unknown: see rest_shown */
    uint32_t joint_count;
    uint32_t odometry_degraded; /* 1: a wheel is stale, or has no counter */
    uint32_t odometry_epoch;    /* odometry resets so far */
    double dt_s;
    double command_age_s;     /* INFINITY: never */
    double wanted_linear_m_s; /* the command as it came in, 0 when stale or not finite */
    double wanted_angular_rad_s;
    double setpoint_linear_m_s; /* after limits and saturation */
    double setpoint_angular_rad_s;
    double saturation;         /* common factor of all wheels; 1: no saturation */
    int64_t odometry_stamp_ns; /* stamp of the newest feedback that is in the pose */
    double x_m;
    double y_m;
    double heading_rad; /* -pi..pi */
    double distance_m;  /* travelled, in any direction; never falls */
    double turned_rad;  /* sum of |turn|, never falls */
    double linear_m_s;  /* measured; NaN: the wheels with fresh feedback do not determine it */
    double angular_rad_s;
    double pose_covariance[6];  /* xx, xy, xh, yy, yh, hh in m2, m rad, rad2 */
    double twist_covariance[3]; /* vv, vw, ww; NaN: as linear_m_s */
    joint_state joint[JOINTS_MAX];
    imu_state imu;
    feedback_doubt doubt; /* the first of FAULTS_OF_FEEDBACK, until the reset */
    lateral_state lateral;
    steering_state steering;
    speed_loop_shown speed_loop[JOINTS_MAX];
    derating_shown derating;
    reasons_shown reason; /* start time of each of `reasons` */
    rest_shown rest;
    counters_shown counters;
} robot_state;
