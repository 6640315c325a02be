/* SPDX-License-Identifier: Apache-2.0
 *
 * api_imu.h: the inertial measurement unit, and the turn of the base by its gyro. Read before
 * api.h, and like it: typedefs, enums, comments and prototypes, no preprocessor line. Axes are
 * those of the base: x forward, y left, z up (REP-103).
 */

/* A sensor's sample in the base's axes. NaN: it does not measure that. */
typedef struct {
    int64_t stamp_ns; /* when it was true; 0: never received */
    double angular_rad_s[3];
    double acceleration_m_s2[3];
    uint32_t saturated; /* 1: a rate was at the end of its scale, so it may have been more */
    uint32_t epoch;     /* another number: the sensor was set up again */
} imu_sample;

typedef struct {
    uint32_t used; /* 0: there is no gyro, the rest is not looked at */
    uint32_t reserved;
    double timeout_s;      /* > 0: an older sample does not count */
    double bias_max_rad_s; /* > 0: a zero-rate offset beyond it is a turn, or a broken sensor */
    double still_variance_rad2_s2; /* > 0: a rate that varies by more is not that of a base that
                                      stands */
    double heading_variance_rad2_per_s; /* > 0: of the integrated noise */
    double turn_variance_rad2_per_rad;  /* > 0: of the scale's error */
} gyro_config;

/* imu_state.state */
enum {
    GYRO_NONE = 0,     /* there is none, or it was never received */
    GYRO_UNBIASED = 1, /* received, but the base has not rested long enough to find its zero */
    GYRO_USED = 2,     /* the heading follows it */
    GYRO_STALE = 3,    /* its last good sample is too old: the heading follows the wheels */
    GYRO_REVERSED = 4, /* it turned against the wheels, so it is mounted in another position than
                          configured: not used any more */
};

/* What the core reports of it. NaN: not measured, or not known yet. */
typedef struct {
    int64_t stamp_ns;        /* of the newest sample; 0: none */
    double angular_rad_s[3]; /* about z without its zero-rate offset, once that is known */
    double acceleration_m_s2[3];
    double bias_rad_s; /* zero-rate offset about z */
    double bias_variance_rad2_s2;
    double rate_variance_rad2_s2; /* of a sample about z */
    uint32_t state;               /* GYRO_* */
    uint32_t heading_by_gyro;     /* 1: the newest turn in the pose is the gyro's, 0: the wheels' */
    uint32_t still;               /* 1: the base stands, by wheels and gyro: the heading is held */
    uint32_t refused; /* samples so far that were no numbers, off the scale or out of order */
} imu_state;

typedef struct {
    int64_t stamp_ns;  /* of the last good sample; 0: none */
    double rate_rad_s; /* about z, without its zero-rate offset */
    double yaw_rad;    /* the rate's integral since the start or the last gap; not wrapped */
    double bias_rad_s;
    double bias_variance_rad2_s2;
    double rate_variance_rad2_s2; /* of single samples while the base stood */
    int64_t bias_stamp_ns;        /* of the newest estimate; 0: none */
    uint32_t epoch; /* of the integral: another number means that a part of the turn is missing */
    uint32_t sensor_epoch;
    uint32_t refused;        /* samples that were no numbers, off the scale or out of order */
    uint32_t still;          /* 1: the base stands, by wheels and gyro */
    int64_t seen_stamp_ns;   /* of the last sample, good or not */
    int64_t still_since_ns;  /* the wheels rest since; 0: they do not */
    int64_t window_since_ns; /* of the samples that make the next estimate */
    double window_mean_rad_s;
    double window_squares_rad2_s2; /* sum of squared distances from the mean */
    uint64_t window_samples;
    double used_rad; /* yaw_rad where the heading has it */
    int64_t used_ns;
    uint32_t used_epoch;
    uint32_t referenced; /* 1: the last three are up to date */
    double opposed_rad; /* how far wheels and gyro have turned against each other, less how far with
                           each other */
    uint32_t reversed;  /* latched: it was too far */
    uint32_t reserved;
} gyro_state;

void gyro_init(gyro_state *state);
/* The turn from its last sample to the next one is unknown. */
void gyro_lose(gyro_state *state);
/* Takes in a sample if it is a new one. wheels_rest: by feedback, of all wheels. */
void gyro_take(gyro_state *state, const gyro_config *config, const imu_sample *sample,
               int64_t now_ns, bool wheels_rest);
/* How far the base has turned since the moment of the last call, and with which variance. false:
 * the gyro has not measured all of it. */
bool gyro_turn(gyro_state *state, const gyro_config *config, int64_t moment_ns, double *turn_rad,
               double *variance_rad2);
/* Compares a turn of both; true for good once they have turned against each other for too long. */
bool gyro_reversed(gyro_state *state, double wheels_rad, double gyro_rad);
/* GYRO_* */
uint32_t gyro_status(const gyro_state *state, const gyro_config *config, int64_t now_ns);
