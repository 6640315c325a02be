/* SPDX-License-Identifier: Apache-2.0
 *
 * api_imu.h: the inertial measurement unit, and the turn of the base by its gyro. Read before
 * api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line. Axes are
 * those of the base: x forward, y left, z up (REP-103). */

/* A sensor's sample in the base's axes. NaN: not measured. */
typedef struct {
    int64_t stamp_ns; /* time of the measurement; 0: never received */
    double angular_rad_s[3];
    double acceleration_m_s2[3];
    uint32_t saturated; /* 1: a rate was at the end of its scale, and may have been greater */
    uint32_t epoch;     /* another number: the sensor was set up again */
} imu_sample;

typedef struct {
    uint32_t used; /* 0: no gyro, and the rest is unused */
    uint32_t reserved;
    double timeout_s;      /* > 0: older samples are not used */
    double bias_max_rad_s; /* > 0: a greater zero-rate offset is a turn, or a broken sensor */
    double still_variance_rad2_s2;      /* > 0: if the rate varies by more, the base does not stand
                                           still */
    double heading_variance_rad2_per_s; /* > 0: of the integrated noise */
    double turn_variance_rad2_per_rad;  /* > 0: of the scale's error */
} gyro_config;

/* imu_state.state */
enum {
    GYRO_NONE = 0,     /* no sensor, or nothing received yet */
    GYRO_UNBIASED = 1, /* received, but the base has not rested long enough to find the zero */
    GYRO_USED = 2,     /* the heading follows it */
    GYRO_STALE = 3,    /* the last good sample is too old: the heading follows the wheels */
    GYRO_REVERSED = 4, /* the gyro turned against the wheels, so its mounting differs from the
                          configured one: not used any more */
};

/* The core's report on the sensor. NaN: not measured, or not known yet. */
typedef struct {
    int64_t stamp_ns;        /* stamp of the newest sample; 0: no sample */
    double angular_rad_s[3]; /* about z without its zero-rate offset, once that is known */
    double acceleration_m_s2[3];
    double bias_rad_s; /* zero-rate offset about z */
    double bias_variance_rad2_s2;
    double rate_variance_rad2_s2; /* variance of a sample about z */
    uint32_t state;               /* GYRO_* */
    uint32_t heading_by_gyro;     /* 1: the newest turn in the pose is by the gyro, 0: by the
                                     wheels */
    uint32_t still;               /* 1: the base stands still, by wheels and gyro: the heading is
                                     held */
    uint32_t refused; /* samples so far that were no numbers, off the scale or out of order */
} imu_state;

typedef struct {
    int64_t stamp_ns;  /* stamp of the last good sample; 0: no sample */
    double rate_rad_s; /* about z, without its zero-rate offset */
    double yaw_rad;    /* the rate's integral since the start or the last gap; not wrapped */
    double bias_rad_s;
    double bias_variance_rad2_s2;
    double rate_variance_rad2_s2; /* variance of single samples while the base stood */
    int64_t bias_stamp_ns;        /* time of the newest estimate; 0: no estimate */
    uint32_t epoch; /* epoch of the integral: another number means that a part of the turn is
                       missing */
    uint32_t sensor_epoch;
    uint32_t refused;        /* samples that were no numbers, off the scale or out of order */
    uint32_t still;          /* 1: the base stands still, by wheels and gyro */
    int64_t seen_stamp_ns;   /* stamp of the last sample, good or not */
    int64_t still_since_ns;  /* time since which the wheels rest; 0: they do not rest */
    int64_t window_since_ns; /* start of the window for the next estimate */
    double window_mean_rad_s;
    double window_squares_rad2_s2; /* sum of squared distances from the mean */
    uint64_t window_samples;
    double used_rad; /* yaw_rad that the heading includes */
    int64_t used_ns;
    uint32_t used_epoch;
    uint32_t referenced; /* 1: the three fields above are up to date */
    double opposed_rad;  /* turn of wheels and gyro against each other, less their turn with each
                            other */
    uint32_t reversed;   /* latched: opposed_rad was too great */
    uint32_t reserved;
} gyro_state;

void gyro_init(gyro_state *state);
/* Break the integral: the turn from the last sample to the next one is unknown. */
void gyro_lose(gyro_state *state);
/* Take in a sample if it is a new one. wheels_rest: all wheels rest by their feedback. */
void gyro_take(gyro_state *state, const gyro_config *config, const imu_sample *sample,
               int64_t now_ns, bool wheels_rest);
/* Return the base's turn since the moment of the last call, and its variance. false: the gyro has
 * not measured all of it. */
bool gyro_turn(gyro_state *state, const gyro_config *config, int64_t moment_ns, double *turn_rad,
               double *variance_rad2);
/* Compare a turn by both. Returns true for ever once they have turned against each other too
 * far. */
bool gyro_reversed(gyro_state *state, double wheels_rad, double gyro_rad);
/* Return GYRO_*. */
uint32_t gyro_status(const gyro_state *state, const gyro_config *config, int64_t now_ns);
