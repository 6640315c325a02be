/* SPDX-License-Identifier: Apache-2.0
 *
 * pwm.c: the open-loop map from a wheel's speed to a duty.
 */
#include "wheel.h"

pwm_output pwm_step(const pwm_config *config, double last_duty, double velocity_rad_s, double dt_s)
{
    if (!isfinite(velocity_rad_s) || !(dt_s > 0.0)) {
        return (pwm_output){0};
    }
    return wheel_duty(config, last_duty, velocity_rad_s, dt_s);
}
