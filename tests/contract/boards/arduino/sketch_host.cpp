/* SPDX-License-Identifier: Apache-2.0
 *
 * Runs docs/mcu/motord_mcu.ino on this machine. Each line on stdin is an order: setup, loop,
 * time US, level PIN 0|1, in HEX, room BYTES, broken (no watchdog is available). Each access of
 * the sketch to the chip prints a line, and the end of an order prints "done".
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <deque>

#include "Arduino.h"

/* In a struct of its own, because the sketch may use the same names. */
static struct {
    uint32_t now_us, watchdog_ms;
    int levels[64], room = 127;
    bool broken;
    void (*handlers[64])();
    std::deque<uint8_t> received;
} host;
Port Serial;

void pinMode(uint8_t pin, uint8_t mode)
{
    printf("mode %d %d\n", pin, mode);
}

void digitalWrite(uint8_t pin, uint8_t level)
{
    printf("level %d %d\n", pin, level);
}

int digitalRead(uint8_t pin)
{
    return host.levels[pin];
}

void attachInterrupt(uint8_t pin, void (*handler)(), int)
{
    host.handlers[pin] = handler;
}

uint32_t micros()
{
    return host.now_us;
}

void Port::begin(unsigned long baudrate)
{
    printf("baudrate %lu\n", baudrate);
}

int Port::available()
{
    return (int)host.received.size();
}

int Port::read()
{
    const int byte = host.received.front();
    host.received.pop_front();
    return byte;
}

int Port::availableForWrite()
{
    return host.room;
}

size_t Port::write(const uint8_t *data, size_t size)
{
    printf("sent ");
    for (size_t i = 0; i < size; i++)
        printf("%02x", data[i]);
    printf("\n");
    return size;
}

static void watch_within(uint32_t milliseconds)
{
    host.watchdog_ms = milliseconds;
    printf("watchdog %u\n", (unsigned)milliseconds);
}

#if defined(ARDUINO_ARCH_ESP32)
#include "esp_task_wdt.h"

bool ledcAttach(uint8_t pin, uint32_t, uint8_t resolution)
{
    printf("pwm %d %g\n", pin, resolution == 10 ? 0.0 : NAN);
    return true;
}

bool ledcWrite(uint8_t pin, uint32_t duty)
{
    printf("pwm %d %.4f\n", pin, duty / 1023.0);
    return true;
}

esp_err_t esp_task_wdt_init(const esp_task_wdt_config_t *)
{
    return ESP_ERR_INVALID_STATE;
}

esp_err_t esp_task_wdt_reconfigure(const esp_task_wdt_config_t *config)
{
    if (host.broken || !config->trigger_panic || config->idle_core_mask != 0)
        return ESP_ERR_INVALID_STATE;
    host.watchdog_ms = config->timeout_ms;
    return ESP_OK;
}

esp_err_t esp_task_wdt_add(void *task)
{
    if (task != NULL || host.watchdog_ms == 0)
        return ESP_ERR_INVALID_STATE;
    watch_within(host.watchdog_ms);
    return ESP_OK;
}

esp_err_t esp_task_wdt_reset()
{
    printf("fed\n");
    return ESP_OK;
}
#elif defined(ARDUINO_ARCH_AVR)
#include "avr/wdt.h"

void noInterrupts()
{
    printf("masked\n");
}

void interrupts()
{
    printf("unmasked\n");
}

void analogWrite(uint8_t pin, int value)
{
    printf("pwm %d %.4f\n", pin, value / 255.0);
}

void wdt_enable(int value)
{
    watch_within(value == WDTO_250MS ? 250 : 0);
}

void wdt_reset()
{
    printf("fed\n");
}
#elif defined(ARDUINO_ARCH_RP2040)
static int bits;
Chip rp2040;

void analogWriteFreq(uint32_t) {}

void analogWriteResolution(int wanted)
{
    bits = wanted;
}

void analogWrite(uint8_t pin, int value)
{
    printf("pwm %d %.4f\n", pin, value / ((1 << bits) - 1.0));
}

void Chip::wdt_begin(uint32_t milliseconds)
{
    watch_within(milliseconds);
}

void Chip::wdt_reset()
{
    printf("fed\n");
}
#endif

#include "motord_mcu.ino"

static void level(char *text)
{
    const int pin = atoi(strtok(text, " ")), to = atoi(strtok(NULL, " "));
    const bool edge_comes = host.levels[pin] != to;
    host.levels[pin] = to;
    if (edge_comes && host.handlers[pin] != NULL)
        host.handlers[pin]();
}

static void hear(const char *hex)
{
    unsigned byte = 0;
    for (; sscanf(hex, "%2x", &byte) == 1; hex += 2)
        host.received.push_back((uint8_t)byte);
}

int main()
{
    char line[2048];
    while (fgets(line, sizeof line, stdin) != NULL) {
        line[strcspn(line, "\n")] = '\0';
        char *text = strchr(line, ' ') != NULL ? strchr(line, ' ') + 1 : line;
        if (strcmp(line, "setup") == 0)
            setup();
        else if (strcmp(line, "loop") == 0)
            loop();
        else if (strcmp(line, "broken") == 0)
            host.broken = true;
        else if (strncmp(line, "time ", 5) == 0)
            host.now_us = (uint32_t)strtoul(text, NULL, 10);
        else if (strncmp(line, "level ", 6) == 0)
            level(text);
        else if (strncmp(line, "room ", 5) == 0)
            host.room = atoi(text);
        else if (strncmp(line, "in ", 3) == 0)
            hear(text);
        printf("done\n");
        fflush(stdout);
    }
    return 0;
}
