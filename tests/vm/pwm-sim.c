/* SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-only
 * pwm-sim.c: a PWM chip of twelve channels that drives nothing, for the guest's kernel (6.1), which
 * has none like it. The PWM core and its files in sysfs are the kernel's own.
 * /sys/module/pwm_sim/parameters/fail: the errno with which it refuses. */
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/pwm.h>

static int fail;
module_param(fail, int, 0644);

static struct platform_device *device;

static int take(struct pwm_chip *chip, struct pwm_device *channel, const struct pwm_state *wanted)
{
    if (fail != 0) {
        return -fail;
    }
    return wanted->duty_cycle <= wanted->period ? 0 : -EINVAL;
}

static const struct pwm_ops operations = {.apply = take, .owner = THIS_MODULE};
static struct pwm_chip channels = {.npwm = 12, .ops = &operations};

static int __init begin(void)
{
    int error;
    device = platform_device_register_simple("pwm-sim", PLATFORM_DEVID_NONE, NULL, 0);
    if (IS_ERR(device)) {
        return PTR_ERR(device);
    }
    channels.dev = &device->dev;
    error = pwmchip_add(&channels);
    if (error != 0) {
        platform_device_unregister(device);
    }
    return error;
}

static void __exit end(void)
{
    pwmchip_remove(&channels);
    platform_device_unregister(device);
}

module_init(begin);
module_exit(end);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("PWM chip without pins, for the tests of motord");
