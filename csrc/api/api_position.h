/* SPDX-License-Identifier: Apache-2.0
 *
 * api_position.h: joints that take positions, and the wheels that they steer. Read before api.h,
 * and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

enum { JOINTS_MAX = 8 };

/* Source of a joint's angle. */
typedef enum {
    REFERENCE_ABSOLUTE = 0,
    REFERENCE_HOMED = 1,
    REFERENCE_ESTIMATED = 2
} position_reference;
/* ABSOLUTE  by the counter, always
 * HOMED     by the counter, while joint_feedback.referenced is 1
 * ESTIMATED not measured: by the set-point, after the time of the longest move at the joint's own
 *           speed */

/* Settings of a joint that takes positions. Its angle is (count - zero_count) rad_per_count, in its
 * own frame, after the gear. */
typedef struct {
    uint32_t used;              /* 0: the joint takes velocities, and the rest is unused */
    uint32_t reference;         /* position_reference */
    uint64_t zero_count;        /* the counter at an angle of 0; ESTIMATED: unused */
    double position_min_rad;    /* <= 0 */
    double position_max_rad;    /* >= 0, greater than position_min_rad */
    double velocity_rad_s;      /* > 0, of the profile */
    double acceleration_rad_s2; /* > 0, in both directions */
    double following_rad; /* >= 0: allowed distance from the set-point, in addition to the lag while
                             it moves */
    double following_s;   /* >= 0: a fault if it is farther for this time; 0: no check */
} position_config;

/* Contact of a wheel with the floor, and the joints that move it. A steered wheel rolls in the
 * direction angle_rad + the angle of its steering joint, another one in angle_rad, counterclockwise
 * from x. */
typedef struct {
    double x_m;
    double y_m;
    double angle_rad;
    uint32_t steering; /* 1 + number of the joint that steers the wheel; 0: fixed */
    uint32_t traction; /* 1 + number of the joint that drives the wheel; 0: it rolls freely */
} wheel_module;

typedef struct {
    double position_rad;
    double velocity_rad_s; /* velocity of the previous step */
} position_profile;

/* Command for joints without a base. */
typedef struct {
    double value_u[JOINTS_MAX]; /* rad for a joint that takes positions, rad/s for another one */
    uint32_t named; /* bit n: value_u[n] is used; else joint n comes to rest, or continues to its
                       target */
    uint32_t reserved;
} joint_command;

/* State of joints without a base. */
typedef struct {
    double target_rad[JOINTS_MAX];     /* targets of joints that take positions; NaN: no target */
    double velocity_rad_s[JOINTS_MAX]; /* velocities of the other joints in the last step */
    double acceleration_rad_s2[JOINTS_MAX];
    double braking_rad_s2[JOINTS_MAX]; /* present acceleration and deceleration of joints that take
                                          positions */
    uint32_t owner;                    /* the lease of the targets */
    uint32_t reserved;
} joints_state;

/* How long a joint has been far from its set-point. */
typedef struct {
    int64_t since_ns; /* 0: it is not far */
    double nearest_rad;
} position_following;

/* Whether a joint follows, apart_rad from its set-point that moves at velocity_rad_s. A joint that
 * comes nearer is only slow. NaN: not known, which is another fault. */
bool position_follows(position_following *following, const position_config *config,
                      double apart_rad, double velocity_rad_s, int64_t now_ns);

/* Do one step towards a goal, within velocity and acceleration, so that the joint ends at rest
 * there and does not pass it, whatever time this step and the next ones take. If the goal is nearer
 * than the braking distance, the joint passes it and returns. If the goal is not finite, it brakes.
 * dt_s > 0. */
void position_step(position_profile *profile, const position_config *config, double goal_rad,
                   double dt_s);
