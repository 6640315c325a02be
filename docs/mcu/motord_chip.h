/* SPDX-License-Identifier: Apache-2.0
 *
 * What differs between the chips of the sketch: PWM, a read that no interrupt tears, and the
 * watchdog that resets the chip. Written for Arduino core 3 of the ESP32, the AVR core (Mega 2560),
 * and the Pico core of Earle Philhower (RP2040, RP2350).
 */
#ifndef MOTORD_CHIP_H
#define MOTORD_CHIP_H

#include <stdint.h>

#define CHIP_WATCHDOG_MS 250 /* one that the AVR has */

#if defined(ARDUINO_ARCH_ESP32)

#include <esp_task_wdt.h>
#define CHIP_ISR IRAM_ATTR
#define CHIP_SERIAL_ROOM 127 /* its transmitter takes so many bytes at once */

static bool chip_pwm_begin(uint8_t pin)
{
    return ledcAttach(pin, 20000, 10) && ledcWrite(pin, 0);
}

static void chip_pwm(uint8_t pin, float part)
{
    ledcWrite(pin, (uint32_t)(part * 1023.0f));
}

static bool chip_watchdog_begin()
{
    esp_task_wdt_config_t config = {};
    config.timeout_ms = CHIP_WATCHDOG_MS;
    config.trigger_panic = true; /* which ends in a reset */
    if (esp_task_wdt_reconfigure(&config) != ESP_OK && esp_task_wdt_init(&config) != ESP_OK) {
        return false;
    }
    return esp_task_wdt_add(NULL) == ESP_OK;
}

static void chip_watchdog_feed()
{
    esp_task_wdt_reset();
}

#elif defined(ARDUINO_ARCH_AVR)

#include <avr/wdt.h>
#define CHIP_ISR
#define CHIP_SERIAL_ROOM 63

static bool chip_pwm_begin(uint8_t pin)
{
    pinMode(pin, OUTPUT); /* about 490 Hz, or 980, by the timer of the pin */
    analogWrite(pin, 0);
    return true;
}

static void chip_pwm(uint8_t pin, float part)
{
    analogWrite(pin, (int)(part * 255.0f));
}

static bool chip_watchdog_begin()
{
    wdt_enable(WDTO_250MS);
    return true;
}

static void chip_watchdog_feed()
{
    wdt_reset();
}

#elif defined(ARDUINO_ARCH_RP2040)

#define CHIP_ISR
#define CHIP_SERIAL_ROOM 63 /* over USB */

static bool chip_pwm_begin(uint8_t pin)
{
    pinMode(pin, OUTPUT);
    analogWriteFreq(20000);
    analogWriteResolution(10);
    analogWrite(pin, 0);
    return true;
}

static void chip_pwm(uint8_t pin, float part)
{
    analogWrite(pin, (int)(part * 1023.0f));
}

static bool chip_watchdog_begin()
{
    rp2040.wdt_begin(CHIP_WATCHDOG_MS);
    return true;
}

static void chip_watchdog_feed()
{
    rp2040.wdt_reset();
}

#else
#error "No PWM and no watchdog for this chip: add them here"
#endif

/* An AVR reads a byte at a time, and an edge may come between two of them. */
static int32_t chip_read(const volatile int32_t *value)
{
#if defined(ARDUINO_ARCH_AVR)
    noInterrupts();
    const int32_t now = *value;
    interrupts();
    return now;
#else
    return *value;
#endif
}

#endif
