/* SPDX-License-Identifier: Apache-2.0
 *
 * api_speed_loop.h: how the core holds the speed of a wheel whose drive does not. Read before
 * api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

/* What the drive takes. TORQUE: the loop is the only path to it. DUTY: without gains the
 * open-loop map alone (pwm_config). */
typedef enum { SPEED_LOOP_NONE = 0, SPEED_LOOP_TORQUE = 1, SPEED_LOOP_DUTY = 2 } speed_loop_kind;

/* At the wheel. u is the unit of the output: N m, or 1 for a duty. None is negative. */
typedef struct {
    double gain_u_s_per_rad;          /* for a speed error */
    double integral_u_per_rad;        /* for the sum of it, an angle */
    double derivative_u_s2_per_rad;   /* against the measured acceleration */
    double static_u;                  /* feed-forward: in the direction of the set-point, */
    double viscous_u_s_per_rad;       /* by the set-point, */
    double acceleration_u_s2_per_rad; /* and by its rise */
} speed_loop_gains;

typedef struct {
    speed_loop_gains gains; /* until the control sets others */
    double filter_s;        /* >= 0: time constant of the measure that the derivative is taken of */
    double correction_max_u; /* >= 0: largest difference of the output from its feed-forward */
    double output_min_u;     /* <= 0 */
    double output_max_u;     /* >= 0 */
    uint32_t kind;           /* speed_loop_kind */
    uint32_t reserved;
} speed_loop_config;

typedef struct {
    double integral_u;
    double slow_rad_s;  /* the measure through the derivative's filter */
    double want_rad_s;  /* of the step before */
    double output_u;    /* output of the step before, of the loop or not */
    uint32_t begun;     /* 0: the next step goes on from output_u */
    uint32_t overspeed; /* 1: no output any more, until the power has been off */
} speed_loop_state;

/* What one step is to do. */
typedef struct {
    double want_rad_s;
    double measured_rad_s;
    double rest_rad_s; /* a wheel slower than this is at rest */
    double low_u;      /* <= 0: what may go out now */
    double high_u;     /* >= 0 */
} speed_loop_input;

/* The output that brings a wheel to a speed, within low_u..high_u. What is not finite: 0. dt_s >
 * 0. */
double speed_loop_step(speed_loop_state *state, const speed_loop_config *config,
                       const speed_loop_gains *gains, const speed_loop_input *input, double dt_s);
/* All of them finite and in range. */
bool speed_loop_gains_good(const speed_loop_gains *gains);

/* For a person. */
typedef struct {
    double output_u;   /* 0: without a loop */
    double integral_u; /* of it */
} speed_loop_shown;
