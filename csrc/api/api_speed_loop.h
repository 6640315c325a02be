/* SPDX-License-Identifier: Apache-2.0
 *
 * api_speed_loop.h: how the core holds the speed of a wheel whose drive does not. Read before
 * api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

/* Output that the drive takes. TORQUE: the loop alone computes it. DUTY: without gains, the
 * open-loop map alone computes it (pwm_config). */
typedef enum { SPEED_LOOP_NONE = 0, SPEED_LOOP_TORQUE = 1, SPEED_LOOP_DUTY = 2 } speed_loop_kind;

/* Gains at the wheel. u is the unit of the output: N m, or 1 for a duty. No gain is negative. */
typedef struct {
    double gain_u_s_per_rad;          /* for a speed error */
    double integral_u_per_rad;        /* for the sum of it, an angle */
    double derivative_u_s2_per_rad;   /* against the measured acceleration */
    double static_u;                  /* feed-forward: by the direction of the set-point, */
    double viscous_u_s_per_rad;       /* proportional to the set-point, */
    double acceleration_u_s2_per_rad; /* and to its rate of change */
} speed_loop_gains;

typedef struct {
    speed_loop_gains gains;  /* until the control sets others */
    double filter_s;         /* >= 0: time constant of the filter of the speed whose derivative is
                                used */
    double correction_max_u; /* >= 0: largest difference of the output from its feed-forward */
    double output_min_u;     /* <= 0 */
    double output_max_u;     /* >= 0 */
    uint32_t kind;           /* speed_loop_kind */
    uint32_t reserved;
} speed_loop_config;

typedef struct {
    double integral_u;
    double slow_rad_s;  /* the measured speed through the derivative's filter */
    double want_rad_s;  /* set-point of the previous step */
    double output_u;    /* output of the previous step, from the loop or not */
    uint32_t begun;     /* 0: the next step continues from output_u */
    uint32_t overspeed; /* 1: no more output until the power has been off */
} speed_loop_state;

/* Input of one step. */
typedef struct {
    double want_rad_s;
    double measured_rad_s;
    double rest_rad_s; /* a wheel slower than this is at rest */
    double low_u;      /* <= 0: least allowed output now */
    double high_u;     /* >= 0: greatest one */
} speed_loop_input;

/* Return the output that brings a wheel to a speed, within low_u..high_u. Not finite: 0. dt_s >
 * 0. */
double speed_loop_step(speed_loop_state *state, const speed_loop_config *config,
                       const speed_loop_gains *gains, const speed_loop_input *input, double dt_s);
/* Whether all gains are finite and in range. */
bool speed_loop_gains_good(const speed_loop_gains *gains);

/* For users. */
typedef struct {
    double output_u;   /* 0 without a loop */
    double integral_u; /* part of the output from the integral */
} speed_loop_shown;
