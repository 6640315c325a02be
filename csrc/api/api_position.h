/* SPDX-License-Identifier: Apache-2.0
 *
 * api_position.h: joints that take positions, and the wheels that they steer. Read before api.h,
 * and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

enum { JOINTS_MAX = 8 };

/* How the angle of a joint is known. */
typedef enum {
    REFERENCE_ABSOLUTE = 0,
    REFERENCE_HOMED = 1,
    REFERENCE_ESTIMATED = 2
} position_reference;
/* ABSOLUTE  its counter always is
 * HOMED     its counter is while joint_feedback.referenced is 1
 * ESTIMATED nothing is measured: it is where its set-point was, after the longest move at its
 * own speed */

/* Of a joint that takes positions. Its angle is (count - zero_count) rad_per_count, in its own
 * frame, after the gear. */
typedef struct {
    uint32_t used;              /* 0: the joint takes velocities, and the rest is not read */
    uint32_t reference;         /* position_reference */
    uint64_t zero_count;        /* the counter where the angle is 0; ESTIMATED: not read */
    double position_min_rad;    /* <= 0 */
    double position_max_rad;    /* >= 0, greater than the least */
    double velocity_rad_s;      /* > 0, of the profile */
    double acceleration_rad_s2; /* > 0, in both directions */
    double following_rad; /* >= 0: so far it may be from its set-point, beside what it lags while it
                             moves */
    double following_s;   /* >= 0: a fault if it is farther for this long; 0: no check */
} position_config;

/* Where a wheel meets the floor, and which joints move it. A steered wheel rolls to angle_rad + the
 * angle of its steering joint, another one to angle_rad, counterclockwise from x. */
typedef struct {
    double x_m;
    double y_m;
    double angle_rad;
    uint32_t steering; /* 1 + number of the joint that turns it about the vertical; 0: fixed */
    uint32_t traction; /* 1 + number of the joint that rolls it; 0: it rolls freely */
} wheel_module;

typedef struct {
    double position_rad;
    double velocity_rad_s; /* of the last step */
} position_profile;

/* What is requested of joints without a base. */
typedef struct {
    double value_u[JOINTS_MAX]; /* an angle in rad of a joint that takes positions, rad/s of another
                                   one */
    uint32_t named; /* bit n: value_u[n] counts; else joint n comes to rest, or goes on to its
                       target */
    uint32_t reserved;
} joint_command;

/* Of joints without a base. */
typedef struct {
    double target_rad[JOINTS_MAX];     /* of those that take positions; NaN: none */
    double velocity_rad_s[JOINTS_MAX]; /* of the others, in the last step */
    double acceleration_rad_s2[JOINTS_MAX];
    double braking_rad_s2[JOINTS_MAX]; /* of those that take positions: what they accelerate and
                                          brake with */
    uint32_t owner;                    /* the lease that gave the targets */
    uint32_t reserved;
} joints_state;

/* Since when a joint has been far from its set-point. */
typedef struct {
    int64_t since_ns; /* 0: it is not */
    double nearest_rad;
} position_following;

/* Whether it follows, apart_rad from its set-point that moves at velocity_rad_s. One that comes
 * nearer is only slow. NaN: not known, which is another fault. */
bool position_follows(position_following *following, const position_config *config,
                      double apart_rad, double velocity_rad_s, int64_t now_ns);

/* One step towards a goal, within velocity and acceleration, so that it ends at rest there and does
 * not pass it, whatever time this step and the next ones take. A goal that comes nearer than it can
 * brake is passed, and returned to. A goal that is not finite: it brakes. dt_s > 0. */
void position_step(position_profile *profile, const position_config *config, double goal_rad,
                   double dt_s);
